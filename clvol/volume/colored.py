"""Volumes of colours: RGB and RGBA voxels, and the one value of each by which they are classified."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clvol.errors import VolumeError

if TYPE_CHECKING:
    from clvol.volume.volume import Volume

ColorValue = Literal["luminance", "brightness", "alpha"]
VALUES: tuple[ColorValue, ...] = ("luminance", "brightness", "alpha")
NAMES = ("red", "green", "blue", "alpha")
_LUMA = (0.2126, 0.7152, 0.0722)  # Rec. ITU-R BT.709


@dataclass(frozen=True, eq=False)
class Colors:
    """The colours of voxels: ``red``, ``green``, ``blue`` and perhaps ``alpha``, volumes on one grid. Integers are
    sRGB-encoded over the range of their type (alpha: linear), floating-point numbers are linear light from 0 to 1."""

    red: Volume
    green: Volume
    blue: Volume
    alpha: Volume | None = None

    @property
    def channels(self) -> tuple[Volume, ...]:
        named = (self.red, self.green, self.blue, self.alpha)
        return tuple(each for each in named if each is not None)


def is_color(names: Sequence[str | None]) -> bool:
    """Whether channels of these names are those of colours."""
    return tuple(names) in (NAMES[:3], NAMES)


def colored_volume(
    channels: Sequence[Volume], value: ColorValue, make: type[Volume], where: str = "volume"
) -> Volume:
    """The volume of one value per voxel, with the colours of all as its ``colors``; ``channels``: red, green, blue and
    perhaps alpha; ``make``: the class of volumes.

    "luminance" (Rec. 709, of encoded colours) and "brightness" (the largest component) keep the channels' type;
    "alpha" is that channel. VolumeError, beginning with ``where``, if there are not three or four alike, or no alpha.
    """
    first = channels[0]
    if len(channels) not in (3, 4):
        raise VolumeError(where, f"{len(channels)} channels", "red, green and blue, and perhaps alpha")
    if any(each.shape != first.shape or each.dtype != first.dtype for each in channels):
        raise VolumeError(where, "channels of different sizes or types", "colours of one size and type")
    if value == "alpha" and len(channels) < 4:
        raise VolumeError(where, "colours without alpha", "'luminance' or 'brightness'")
    if value == "alpha":
        data = channels[3].data
    else:
        data = np.empty(first.shape, first.dtype)
        for z in range(len(data)):  # slice by slice, which takes less memory
            parts = [each.data[z] for each in channels[:3]]
            data[z] = np.maximum.reduce(parts) if value == "brightness" else _luma(parts, first.dtype)
    grid = first.grid
    made = make(
        data, grid.spacing, grid.origin, grid.direction, first.name, frame=first.frame, path=first.path,
        format=first.format, unit=first.unit,
    )  # fmt: skip
    made.files = first.files
    made.colors = Colors(*channels)
    return made


def components(array: Any, value: str) -> list[np.ndarray]:
    """The components [z, y, x] of colours [z, y, x, 3 or 4]. VolumeError for another shape, or an unknown ``value``."""
    array = np.asarray(array)
    if array.ndim != 4 or array.shape[3] not in (3, 4):
        raise VolumeError("volume", f"colours of shape {array.shape}", "an array [z, y, x, 3], or 4 with alpha")
    if value not in VALUES:
        raise VolumeError("volume", f"value = {value!r}", " or ".join(map(repr, VALUES)))
    return [array[..., k] for k in range(array.shape[3])]


def _luma(parts: Sequence[np.ndarray], dtype: np.dtype) -> np.ndarray:
    total = sum(share * part.astype(np.float64) for share, part in zip(_LUMA, parts))
    return np.rint(total).astype(dtype) if dtype.kind in "iu" else np.asarray(total, dtype)
