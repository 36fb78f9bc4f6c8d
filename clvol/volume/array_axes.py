"""Recognising the axes z, y, x, channel and time of an array by their names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clvol.errors import VolumeError

AXES = ("t", "c", "z", "y", "x")
_SYNONYMS = {
    "x": "x", "column": "x", "columns": "x", "col": "x", "width": "x", "longitude": "x", "lon": "x",
    "y": "y", "row": "y", "rows": "y", "height": "y", "latitude": "y", "lat": "y",
    "z": "z", "depth": "z", "slice": "z", "slices": "z", "plane": "z", "planes": "z", "level": "z",
    "page": "z", "pln": "z",
    "c": "c", "ch": "c", "channel": "c", "channels": "c", "band": "c",
    "t": "t", "time": "t", "times": "t", "frame": "t", "frames": "t", "timepoint": "t",
}  # fmt: skip
_TYPES = {"channel": "c", "time": "t"}


@dataclass(frozen=True)
class Axis:
    """The metadata of an axis. ``type`` is OME's ("space", "time", "channel")."""

    name: str | None
    type: str | None = None
    unit: str | None = None

    @property
    def kind(self) -> str | None:
        """"x", "y", "z", "c", "t"; None where nothing is known."""
        by_type = _TYPES.get((self.type or "").lower())
        return by_type or _SYNONYMS.get((self.name or "").strip().lower())


@dataclass(frozen=True)
class Placed:
    """The indices of the axes z (None: there is none), y and x, channel and time. All other axes have length 1."""

    space: tuple[int | None, int, int]
    channel: int | None
    time: int | None


def place_axes(axes: Sequence[Axis], shape: Sequence[int], where: str) -> Placed:
    """The axes of an array by their names and lengths; VolumeError if they are ambiguous."""
    if any(n < 1 for n in shape):
        raise VolumeError(where, f"empty array of shape {list(shape)}", "at least one voxel")
    kinds = [axis.kind for axis in axes]
    by_kind = {kind: k for k, kind in enumerate(kinds) if kind}
    if len(by_kind) < sum(kind is not None for kind in kinds):
        raise _unclear(axes, shape, where)
    unknown = [k for k, kind in enumerate(kinds) if kind is None]
    if {"x", "y"} <= set(by_kind):
        z = by_kind.get("z")
        long = [k for k in unknown if shape[k] != 1]
        if z is None and len(long) == 1 and _may_be_z(axes[long[0]]):
            z = long.pop()
        if long:
            raise _unclear(axes, shape, where)
        y, x = by_kind["y"], by_kind["x"]
    else:
        if {"x", "y", "z"} & set(by_kind):
            raise _unclear(axes, shape, where)
        while len(unknown) > 3 and any(shape[k] == 1 for k in unknown):
            unknown.remove(next(k for k in unknown if shape[k] == 1))
        if len(unknown) != 3:
            raise _unclear(axes, shape, where)
        z, y, x = unknown
    return Placed((z, y, x), by_kind.get("c"), by_kind.get("t"))


def _may_be_z(axis: Axis) -> bool:
    return axis.type == "space" or not axis.name


def _unclear(axes: Sequence[Axis], shape: Sequence[int], where: str) -> VolumeError:
    if not any(axis.name for axis in axes):
        return VolumeError(where, f"an array of shape {list(shape)}", "three axes [z, y, x]")
    said = ", ".join(f"{axis.name or 'unnamed'} {n}" for axis, n in zip(axes, shape))
    return VolumeError(where, f"axes of length {said}", "axes z, y, x, and channel c or time t")
