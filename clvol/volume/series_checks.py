"""What is checked of the steps of a series: that they go together, and what their voxels hold."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.series_steps import Step
from clvol.volume.volume import Volume

_ALIKE = 1e-5  # tolerance of grids, as a share of a voxel: headers hold few digits
CONVERTIBLE = {  # types that hold every value of another type
    "uint8": ("uint16", "int16", "float32", "float64"), "int8": ("int16", "float32", "float64"),
    "uint16": ("float32", "float64"), "int16": ("float32", "float64"), "float32": ("float64",),
}  # fmt: skip


@dataclass(frozen=True)
class StepRange:
    """What one step holds, in stored numbers: the smallest and the largest finite one (None: no voxel is finite), and
    how many voxels are NaN, or infinite. ``dtype``: their type as it was read."""

    span: tuple[float, float] | None
    nans: int
    infs: int
    dtype: str


class StepDiffers(VolumeError):
    """A step whose shape, grid, type or axis is not that of the steps before it."""


def check_alike(volume: Volume, like: Volume, step: Step, first: str) -> None:
    """StepDiffers, naming ``step``, unless shape, type, grid and axis of ``volume`` are those of ``like``; ``first`` is
    the name of that."""
    if volume.shape != like.shape:
        sizes = (" x ".join(map(str, each.grid.size)) for each in (volume, like))
        raise StepDiffers(step.name, f"{next(sizes)} voxels", f"{next(sizes)}, as {first} has")
    if volume.dtype != like.dtype and not (step.may_convert or (volume.narrowed and like.narrowed)):
        raise StepDiffers(step.name, f"voxels of type {volume.dtype}", f"{like.dtype}, as {first} has")
    for what in ("spacing", "origin", "direction"):
        if not _alike(volume.grid, like.grid, what):
            said, wanted = (np.round(getattr(each.grid, what), 6).tolist() for each in (volume, like))
            raise StepDiffers(step.name, f"{what} {said}", f"{wanted}, as {first} has")
    if volume.axis != like.axis:
        said, wanted = (f"slope {each.slope:g}, offset {each.offset:g}" for each in (volume, like))
        raise StepDiffers(step.name, said, f"{wanted}, as {first} has")


def without_voxels(volume: Volume) -> Volume:
    """What is stated about ``volume``, to compare others with."""
    shell = copy.copy(volume)
    for key in ("data", "_census", "_plain"):
        vars(shell).pop(key, None)
    vars(shell)["data"] = np.broadcast_to(np.zeros((), volume.dtype), volume.shape)
    return shell


def range_of(volume: Volume) -> StepRange:
    nans, infs = volume.nan_count, volume.inf_count
    span = None if nans + infs == math.prod(volume.shape) else volume.stored_range
    return StepRange(span, nans, infs, volume.dtype.name)


def checked_range(value_range: Sequence[float]) -> tuple[float, float]:
    try:
        low, high = (float(x) for x in value_range)
    except (TypeError, ValueError):
        low, high = math.nan, math.nan
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise VolumeError("value_range", f"got {value_range!r}", "two finite numbers [lowest, highest]")
    return low, high


def check_within(found: StepRange, volume: Volume, given: tuple[float, float], name: str) -> None:
    if found.span is None:
        return
    low, high = volume.axis.span(found.span)
    unsure = 1e-9 * max(abs(given[0]), abs(given[1]), abs(low), abs(high))
    if low < given[0] - unsure or high > given[1] + unsure:
        what = f"values from {low:.9g} to {high:.9g}, beyond volume.value_range"
        raise VolumeError(name, what, f"a range that holds those of all steps, here {given[0]:.9g} to {given[1]:.9g}")


def converted(volume: Volume, dtype: np.dtype, name: str) -> Volume:
    """``volume`` in the type of all steps, which holds its values exactly."""
    if dtype.name not in CONVERTIBLE.get(volume.dtype.name, ()):
        what = f"voxels that need the type {volume.dtype}"
        raise StepDiffers(name, what, f"{dtype}, as the other steps have")
    other = copy.copy(volume)
    for key in ("_census", "_plain"):
        vars(other).pop(key, None)
    other.data = volume.data.astype(dtype)
    other.data.flags.writeable = False
    return other


def holds_whole(dtype: np.dtype, low: float, high: float) -> bool:
    """Whether ``dtype`` holds all whole numbers from ``low`` to ``high``."""
    if dtype.kind == "f":
        return max(-low, high) <= 2**24
    limits = np.iinfo(dtype)
    return bool(limits.min <= low and high <= limits.max)


def _alike(one: Grid, other: Grid, what: str) -> bool:
    first, second = np.asarray(getattr(one, what), float), np.asarray(getattr(other, what), float)
    edge = np.full(3, other.smallest_edge)
    scale = {"spacing": np.asarray(other.spacing, float), "origin": edge}.get(what, np.ones(1))
    return bool(np.all(np.abs(first - second) <= _ALIKE * scale))

