"""Pictures of channels: each channel is rendered as a scene of its own, and their pictures are blended.

So every method, filter, projection and kind of light renders channels, each exactly as it renders one volume; channels
that show nothing cost nothing. What is not per picture but per place ("mix") is one scene (cl/fields.h).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clvol.device.view import EVERY_PIXEL, PixelList, Pixels
from clvol.errors import SceneError
from clvol.features.analysis import effects
from clvol.integrators.base import (
    FrameData,
    PartOfPicture,
    PictureArrays,
    Prepared,
    Progress,
    RendersParts,
    TiledPictureParts,
)
from clvol.scene.camera import Camera
from clvol.scene.channel_scenes import channel_scenes
from clvol.scene.resolve import ResolvedScene

_REFUSED = {
    "isosurfaces": "an iso-value of one channel alone",
    "density field": "a medium that would be added to each channel",
    "environment background": "a background that would be added for each channel",
    "two-dimensional transfer function": "layers of one channel's function",
    "joint transfer function": "layers of one channel's function",
}


def check_channels(resolved: ResolvedScene) -> None:
    """SceneError for what cannot be rendered once for every channel."""
    if not resolved.channels:
        return
    for effect in effects(resolved):
        if effect.called_for and effect.name in _REFUSED:
            blend, why = resolved.integration.blend, _REFUSED[effect.name]
            what = f"got {blend!r} in a scene that calls for {effect.name}: {why}"
            raise SceneError(f"{resolved.origin}: integration.blend", what, "'mix', or channels without that")


def prepared_channels(resolved: ResolvedScene, prepare: Callable[[ResolvedScene], Prepared]) -> Prepared:
    """The channels of ``resolved`` that show anything, each made by ``prepare``; one alone is that channel itself."""
    scenes = shown_channels(resolved)
    prepared = [prepare(scene) for scene in scenes]
    return prepared[0] if len(prepared) == 1 else ChannelPictures(resolved, scenes, prepared)


def shown_channels(resolved: ResolvedScene) -> tuple[ResolvedScene, ...]:
    """The scenes of the channels that show anything; of none, the first."""
    scenes = channel_scenes(resolved)
    shown = tuple(scene for scene in scenes if any(effect.called_for for effect in effects(scene)))
    return shown or scenes[:1]


def blended(pictures: Sequence[np.ndarray], blend: str) -> np.ndarray:
    """float32 [..., 4] of pictures of channels, each float32 [..., 4], premultiplied linear light.

    "additive": colours add up, "screen": 1 - (1 - a)(1 - b); opacities are screened in both. "maximum": of each
    component.
    """
    total = np.array(pictures[0], np.float32)
    for picture in pictures[1:]:
        if blend == "maximum":
            np.maximum(total, picture, out=total)
        elif blend == "screen":
            np.clip(total, 0.0, 1.0, out=total)
            total += np.clip(picture, 0.0, 1.0) * (1.0 - total)
        else:
            total[..., :3] += picture[..., :3]
            total[..., 3] += picture[..., 3] * (1.0 - total[..., 3])
    return total


def nearest(depths: Sequence[np.ndarray | None]) -> np.ndarray | None:
    """The nearest of the channels' depths; None where there are none."""
    known = [depth for depth in depths if depth is not None]
    return np.minimum.reduce(known) if known else None


class ChannelPictures:
    """A scene of several channels that are prepared on one device (a ``Prepared``, and ``RendersParts``)."""

    def __init__(
        self, resolved: ResolvedScene, scenes: Sequence[ResolvedScene], prepared: Sequence[Prepared]
    ) -> None:
        self.resolved = resolved
        self._scenes, self._prepared = tuple(scenes), tuple(prepared)
        self._blend = resolved.integration.blend

    @property
    def renders_all_pixels(self) -> bool:
        return any(each.renders_all_pixels for each in self._prepared)

    @property
    def held(self) -> Sequence[object]:
        return [part for each in self._prepared for part in each.held]

    @property
    def visible_share(self) -> float:
        return max(each.visible_share for each in self._prepared)

    @property
    def visible_cells(self) -> tuple[np.ndarray, int] | None:
        """Those of all channels, where all are on the same cells."""
        known = [each.visible_cells for each in self._prepared]
        found = [each for each in known if each is not None]
        alike = len({(cells.shape, shift) for cells, shift in found}) == 1
        grids = {scene.volume.grid for scene in self._scenes}
        if len(found) < len(known) or not alike or len(grids) > 1:
            return None
        return np.logical_or.reduce([cells for cells, _ in found]), found[0][1]

    def for_scene(self, resolved: ResolvedScene) -> Prepared:
        scenes = shown_channels(resolved)
        return ChannelPictures(resolved, scenes, [p.for_scene(s) for p, s in zip(self._prepared, scenes)])

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        for each in self._prepared:
            each.warm_up(width, height, depth)

    def render(
        self, camera: Camera, width: int, height: int, progress: Progress | None = None, depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:  # fmt: skip
        """As ``Prepared.render``. ``notes["channels"]``: how they are blended, and the samples of each."""
        count = len(self._prepared)
        made = [
            each.render(camera, width, height, _part(progress, number, count), depth, lattice)
            for number, each in enumerate(self._prepared)
        ]
        counters: dict[str, int] = {}
        for data in made:
            for name, number in data.counters.items():
                counters[name] = counters.get(name, 0) + number
        notes = {**made[0].notes, "channels": self._notes([data.samples for data in made])}
        return FrameData(
            blended([data.rgba for data in made], self._blend), nearest([data.depth for data in made]),
            sum(data.samples for data in made), sum(data.rays for data in made), counters, notes=notes,
        )  # fmt: skip

    def _notes(self, samples: list[int] | None = None) -> dict[str, Any]:
        notes: dict[str, Any] = {"count": len(self._prepared), "blend": self._blend}
        return notes if samples is None else {**notes, "samples": samples}

    def warm_up_parts(self, width: int, height: int, depth: bool = True) -> None:
        for each in self._prepared:
            if isinstance(each, RendersParts):
                each.warm_up_parts(width, height, depth)
            else:
                each.warm_up(width, height, depth)

    def parts(
        self, camera: Camera, width: int, height: int, depth: bool = True, lattice: Pixels = EVERY_PIXEL
    ) -> TiledPictureParts | None:
        """The stages of each channel's picture one after another, and one more that blends them. None where a channel
        cannot be divided."""
        if isinstance(lattice, PixelList) or not all(isinstance(each, RendersParts) for each in self._prepared):
            return None
        divided = [each for each in self._prepared if isinstance(each, RendersParts)]
        made = [each.parts(camera, width, height, depth, lattice) for each in divided]
        found = [each for each in made if each is not None]
        if len(found) < len(made) or len({each.tile for each in found}) > 1:
            return None
        return _ChannelParts(found, self._blend, self._notes())


def _part(progress: Progress | None, number: int, count: int) -> Progress | None:
    if progress is None:
        return None
    return lambda done, total: progress(number * total + done, count * total)


class _ChannelParts:
    """The parts of a picture of channels (``TiledPictureParts``)."""

    coherent = False

    def __init__(self, channels: list[TiledPictureParts], blend: str, notes: dict[str, Any]) -> None:
        self._channels, self._blend = channels, blend
        self.notes = {**channels[0].notes, "channels": notes}
        if "coherence" in self.notes:
            self.notes["coherence"] = {"mode": "cells", "reason": "channels"}
        self._where = [(k, stage) for k, each in enumerate(channels) for stage in range(len(each.stages))]
        ends = np.cumsum([len(each.stages) for each in channels])
        self._first, self._last = [0, *ends[:-1].tolist()], (ends - 1).tolist()
        self._arrays: list[PictureArrays] = []

    @property
    def tile(self) -> tuple[int, int]:
        return self._channels[0].tile

    @property
    def sizes(self) -> list[tuple[int, int]]:
        return [size for each in self._channels for size in each.sizes] + [self._channels[0].sizes[-1]]

    @property
    def stages(self) -> list[int]:
        return [tiles for each in self._channels for tiles in each.stages] + [self._channels[0].stages[-1]]

    def expected_costs(self, stage: int) -> np.ndarray:
        if stage == len(self._where):
            return np.ones(self.stages[-1])
        channel, own = self._where[stage]
        return self._channels[channel].expected_costs(own)

    def begin(self, stage: int, arrays: list[PictureArrays]) -> None:
        self._arrays = arrays
        if stage < len(self._where):
            channel, own = self._where[stage]
            self._channels[channel].begin(own, arrays[self._first[channel] : self._last[channel] + 1])

    def render(self, stage: int, tiles: np.ndarray) -> PartOfPicture:
        if stage < len(self._where):
            channel, own = self._where[stage]
            return self._channels[channel].render(own, tiles)
        for tile in tiles.tolist():
            self._blend_tile(tile)
        return PartOfPicture(np.ones(len(tiles)), 0, 0, {})

    def _blend_tile(self, tile: int) -> None:
        across, down = self.tile
        width, _ = self.sizes[-1]
        columns = max(1, -(-width // across))
        left, top = tile % columns * across, tile // columns * down
        where = np.s_[top : top + down, left : left + across]
        made = [self._arrays[k] for k in self._last]
        self._arrays[-1].rgba[where] = blended([each.rgba[where] for each in made], self._blend)
        depth = nearest([None if each.depth is None else each.depth[where] for each in made])
        into = self._arrays[-1].depth
        if depth is not None and into is not None:
            into[where] = depth

    def end(self, stage: int, tiles: np.ndarray) -> None:
        if stage < len(self._where):
            channel, own = self._where[stage]
            self._channels[channel].end(own, tiles)
