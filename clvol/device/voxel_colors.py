"""Colours of voxels as cl/fields.h reads them: square roots of linear light, 11, 11 and 10 bits in a word."""

from __future__ import annotations

import numpy as np

from clvol.transfer.color import srgb_to_linear
from clvol.volume.colored import Colors
from clvol.volume.volume import Volume

RED_GREEN, BLUE = 2047, 1023  # the largest numbers of the components
_TABLE_TYPES = ("uint8", "uint16")


def linear_light(volume: Volume) -> np.ndarray:
    """float32 [z, y, x] in 0 .. 1: the component that ``volume`` holds; 0 where it is no number."""
    data = volume.data
    if data.dtype.kind == "f":
        return np.clip(np.nan_to_num(data, posinf=1.0, neginf=0.0), 0.0, 1.0).astype(np.float32)
    highest = np.iinfo(data.dtype).max
    if data.dtype.name in _TABLE_TYPES:
        return srgb_to_linear(np.arange(highest + 1) / highest).astype(np.float32)[data]
    return srgb_to_linear(np.clip(data, 0, None) / highest).astype(np.float32)


def packed_colors(colors: Colors) -> np.ndarray:
    """uint32 [z, y, x]. Each component is right to 2.5e-4 (blue: 5e-4) of its square root, a quarter of what 8 encoded
    bits tell apart.

    Voxels of alpha 0 have no colour of their own: they get the mean of those around them that have one, so that
    interpolation does not darken what is beside them.
    """
    light = [linear_light(each) for each in (colors.red, colors.green, colors.blue)]
    if colors.alpha is not None and colors.alpha.stored_range[0] <= 0:
        light = _spread(light, colors.alpha.data > 0)
    words = np.zeros(light[0].shape, np.uint32)
    for component, levels, shift in zip(light, (RED_GREEN, RED_GREEN, BLUE), (0, 11, 22)):
        words |= np.rint(np.sqrt(component) * levels).astype(np.uint32) << np.uint32(shift)
    return words


def _spread(light: list[np.ndarray], known: np.ndarray) -> list[np.ndarray]:
    from scipy import ndimage

    share = ndimage.uniform_filter(known.astype(np.float32), 3, mode="constant")
    near = ~known & (share > 1e-3)
    found = []
    for component in light:
        mean = ndimage.uniform_filter(np.where(known, component, 0).astype(np.float32), 3, mode="constant")
        found.append(np.where(near, np.clip(mean / np.where(near, share, 1.0), 0.0, 1.0), component))
    return found
