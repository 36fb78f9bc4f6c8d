"""Spot lights and projected images: what cl/aimed_lights.h needs of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clvol.errors import SceneError, UsageError
from clvol.image.files import load_image
from clvol.scene.light import Light
from clvol.volume.memory import DEFAULT_SHARE, available_memory

EXTRA_ROWS = 4  # items beyond the two that every light has: LIGHT_ROWS of cl/effects.h less 2
MOST_TEXELS = 2**24  # of all images: a float32 counts no further
_STEP = 1e30  # 1 / what the light of a cone with a hard edge fades over
Row = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class LightImages:
    """The pictures of a scene's image lights. ``texels`` float32 [n, 4] (r, g, b, 0), linear; ``places``: by file, the
    first texel, width and height."""

    texels: np.ndarray
    places: dict[str, tuple[int, int, int]]

    def rows(self, light: Light) -> np.ndarray:
        """float32 [height, width, 3]: the picture of ``light``."""
        first, width, height = self.places[str(light.file)]
        return self.texels[first : first + width * height, :3].reshape(height, width, 3)


def has_aimed(lights: Sequence[Light]) -> bool:
    return any(light.is_aimed for light in lights)


def load_images(lights: Sequence[Light], first: int = 0) -> LightImages:
    """The pictures that ``lights`` project, each once, after ``first`` texels of others. SceneError for one that cannot
    be read, is too large, or has negative texels or some that are not finite."""
    found: list[np.ndarray] = []
    places: dict[str, tuple[int, int, int]] = {}
    count = first
    for file in dict.fromkeys(light.file for light in lights if light.type == "image" and light.file is not None):
        rgb = _read(file)
        height, width = rgb.shape[:2]
        places[file] = count, width, height
        count += width * height
        found.append(np.concatenate([rgb, np.zeros((height, width, 1), np.float32)], axis=2).reshape(-1, 4))
        if count > MOST_TEXELS:
            what = f"is {width} x {height} texels, {count} with the environment and what other lights project"
            raise SceneError(file, what, f"at most {MOST_TEXELS} in all")
    texels = np.concatenate(found) if found else np.zeros((0, 4), np.float32)
    return LightImages(texels, places)


def _read(file: str) -> np.ndarray:
    """float32 [height, width, 3], linear; where the picture is transparent there is no light."""
    try:
        rgb = load_image(file, int(DEFAULT_SHARE * available_memory()))["rgba"][..., :3]
    except UsageError as error:
        raise SceneError(error.where, error.what, error.expected) from None
    bad = int(np.count_nonzero(~np.all(np.isfinite(rgb) & (rgb >= 0.0), axis=-1)))
    if bad:
        raise SceneError(file, f"{bad} of {rgb[..., 0].size} texels are negative or not finite", "light of 0 or more")
    return np.ascontiguousarray(rgb, np.float32)


def aimed_rows(light: Light, images: LightImages) -> list[Row]:
    """The EXTRA_ROWS items of ``light`` beyond its first two."""
    if not light.is_aimed:
        return [(0.0, 0.0, 0.0, 0.0)] * EXTRA_ROWS
    right, up, forward = light.axes()
    none = np.zeros(3)
    if light.type == "spot":
        edge, fade = cone_chords(light)
        return [(*forward, edge), (*none, min(1.0 / max(fade, 1e-37), _STEP)), (*none, 0.0), (*none, 0.0)]
    first, width, height = images.places[str(light.file)]
    tangent = float(np.tan(np.radians(0.5 * light.fov_degrees)))
    across = right / (tangent * width / height)
    return [(*forward, 0.0), (*across, 0.0), (*(-up / tangent), float(first)), (float(width), float(height), 0.0, 0.0)]


def cone_chords(light: Light) -> tuple[float, float]:
    """The squares of the chords of a unit sphere to the edge of a spot's cone, and what of it the light fades over."""
    outer = np.radians(light.cone_degrees)
    edge, inner = (4.0 * np.sin(0.5 * angle) ** 2 for angle in (outer, outer * (1.0 - light.penumbra)))
    return float(edge), float(edge - inner)


def share_towards(light: Light, images: LightImages, direction: np.ndarray) -> np.ndarray:
    """float64 [3]: what of ``light``'s colour goes along the unit vector ``direction``: as cl/aimed_lights.h, for light
    from so far away that it has one direction."""
    right, up, forward = light.axes()
    if light.type == "spot":
        edge, fade = cone_chords(light)
        t = float(np.clip((edge - np.sum((direction - forward) ** 2)) / max(fade, 1e-30), 0.0, 1.0))
        return np.full(3, t * t * (3.0 - 2.0 * t))
    ahead = float(direction @ forward)
    if light.type != "image" or ahead <= 0:
        return np.ones(3) if light.type != "image" else np.zeros(3)
    texels = images.rows(light)
    height, width = texels.shape[:2]
    tangent = float(np.tan(np.radians(0.5 * light.fov_degrees)))
    u = float(direction @ right) / (ahead * tangent * width / height)
    v = -float(direction @ up) / (ahead * tangent)
    if max(abs(u), abs(v)) > 1:
        return np.zeros(3)
    row, column = (int(np.clip((w + 1) / 2 * n, 0, n - 1)) for w, n in ((v, height), (u, width)))
    return texels[row, column].astype(np.float64)
