"""Some tiles of a picture at a time, for pictures that processes of several machines share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clvol.errors import SceneError
from clvol.integrators.base import PictureArrays, RendersParts, TiledPictureParts
from clvol.integrators.registry import check_scene
from clvol.render.member import LocalMember
from clvol.render.renderer import open_context
from clvol.scene import load_scene

Rectangle = tuple[int, int, int, int]  # left, top, right, bottom in pixels


@dataclass(frozen=True)
class TilesPart:
    """A rectangle of a picture: ``rgba`` float32 [height, width, 4], ``depth`` float32 [height, width] or None, and
    counts as in ``FrameData``."""

    rgba: np.ndarray
    depth: np.ndarray | None
    samples: int
    rays: int
    counters: dict[str, int]


class TilesRun:
    """Renders rectangles of one picture in this process; the scene is loaded and prepared once, on one device.
    ``overrides`` as for ``load_scene``. SceneError for a scene whose pictures cannot be divided."""

    def __init__(
        self, path: str, overrides: Sequence[str], devices: Sequence[str] | None, memory_cap: int | None, depth: bool
    ) -> None:
        scene = load_scene(path, overrides)
        scene.load(memory_cap)
        self._resolved = scene.resolve(memory_cap)
        check_scene(self._resolved)
        self._member = LocalMember(open_context(devices))
        self._member.prepare(self._resolved)
        self._parts = self._divided(depth)
        size = self._resolved.image.height, self._resolved.image.width
        distances = np.full(size, np.inf, np.float32) if depth else None
        # Each rectangle replaces what is there of the one before.
        self._arrays = PictureArrays(np.zeros((*size, 4), np.float32), distances)

    def close(self) -> None:
        self._member.close()

    def make(self, rectangle: Rectangle) -> TilesPart:
        left, top, right, bottom = rectangle
        parts, arrays = self._parts, self._arrays
        here = np.s_[top:bottom, left:right]
        if parts is None:  # nothing is visible
            pixels = (right - left) * (bottom - top)
            return TilesPart(arrays.rgba[here], None if arrays.depth is None else arrays.depth[here], 0, pixels, {})
        tiles = _tiles_in(rectangle, parts.tile, self._resolved.image.width)
        parts.begin(0, [arrays])
        made = parts.render(0, tiles)
        parts.end(0, tiles)
        depth = None if arrays.depth is None else np.array(arrays.depth[here])
        return TilesPart(np.array(arrays.rgba[here]), depth, made.samples, made.rays, made.counters)

    def _divided(self, depth: bool) -> TiledPictureParts | None:
        """The picture in tiles; None if nothing is visible."""
        prepared, resolved = self._member.prepared, self._resolved
        if not isinstance(prepared, RendersParts):
            raise SceneError(f"{resolved.origin}: integration.method", f"got {resolved.integration.method!r}",
                             "'raycast', for a picture that workers share")  # fmt: skip
        if resolved.image.samples > 1:
            where, got = f"{resolved.origin}: image.samples", f"got {resolved.image.samples}"
            raise SceneError(where, got, "1, for a picture that workers share")
        parts = prepared.parts(resolved.camera, resolved.image.width, resolved.image.height, depth)
        if parts is not None and len(parts.stages) > 1:
            where = f"{resolved.origin}: image"
            raise SceneError(where, "pixels depend on rays elsewhere in the picture (ray_spacing)",
                             "a ray for each pixel, for a picture that workers share")  # fmt: skip
        return parts


def _tiles_in(rectangle: Rectangle, tile: tuple[int, int], width: int) -> np.ndarray:
    """int64: the numbers of the tiles of a rectangle that ends between tiles."""
    (left, top, right, bottom), (across, down) = rectangle, tile
    columns = -(-width // across)
    x = np.arange(left // across, -(-right // across))
    y = np.arange(top // down, -(-bottom // down))
    return (y[:, None] * columns + x).ravel().astype(np.int64)


def rectangles(width: int, height: int, count: int, tile: int) -> list[Rectangle]:
    """About ``count`` rectangles that make up a picture, whole tiles of ``tile`` by ``tile`` pixels; those in the
    middle, where most is to be seen, first: then what is left at the end is little."""
    columns, rows = -(-width // tile), -(-height // tile)
    bands = min(rows, max(count, 1))
    across = min(columns, max(round(count / bands), 1))
    x = [round(k * columns / across) * tile for k in range(across + 1)]
    y = [round(k * rows / bands) * tile for k in range(bands + 1)]
    found = [
        (a, b, min(c, width), min(d, height)) for b, d in zip(y, y[1:]) for a, c in zip(x, x[1:]) if a < c and b < d
    ]
    return sorted(found, key=lambda r: abs(r[0] + r[2] - width) / width + abs(r[1] + r[3] - height) / height)
