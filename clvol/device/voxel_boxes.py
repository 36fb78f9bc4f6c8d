"""The voxels of a volume in plain boxes, one after another, for kernels that look once at all voxels and what is around
each (cl/voxel_boxes.h). A volume that is on the device as a whole is one box."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from clvol.opencl.arguments import INT4, RAW, Argument, reads, value

if TYPE_CHECKING:
    from clvol.opencl.context import DeviceArray

LEAST_UNIT = 16  # voxels: of cells that are a power of two, at most this one, none is divided between boxes

BOX_ARGUMENTS: tuple[Argument, ...] = (reads("volume", RAW), value("box", INT4), value("begin", INT4))


@dataclass(frozen=True)
class BoxPlace:
    """Where a box is: rows are whole. Voxels are there from ``first`` to before ``last`` (y, z); those from ``begin``
    to before ``end`` are its own, and belong to no other box."""

    first: tuple[int, int]
    last: tuple[int, int]
    begin: tuple[int, int]
    end: tuple[int, int]


@dataclass(frozen=True, eq=False)
class VoxelBox:
    """``voxels`` [z, y, x] of a box, of the volume's type, on the device."""

    voxels: DeviceArray
    place: BoxPlace

    @property
    def arguments(self) -> Mapping[str, Any]:
        """Values of ``BOX_ARGUMENTS``."""
        first, last, begin = self.place.first, self.place.last, self.place.begin
        return {"volume": self.voxels, "box": (*first, last[0] - first[0], 0), "begin": (*begin, 0, 0)}

    @property
    def launch(self) -> tuple[int, int]:
        """A work-item for every row (y, z) of its own."""
        (y0, z0), (y1, z1) = self.place.begin, self.place.end
        return y1 - y0, z1 - z0


def box_places(
    size: tuple[int, int], halo: tuple[int, int], row_bytes: int, most: int, unit: int = LEAST_UNIT
) -> Iterator[BoxPlace]:
    """Boxes that hold all voxels of ``size`` (y, z) once, and ``halo`` voxels around their own where there are any.
    They begin at multiples of ``unit``, and have at most ``most`` bytes each if that is possible: they are as large as
    halving slices, and then rows, makes them."""
    own = [-(-n // unit) * unit for n in size]
    for axis in (1, 0):
        while own[axis] > unit and box_bytes(size, halo, row_bytes, unit, (own[0], own[1])) > most:
            own[axis] = -(-own[axis] // (2 * unit)) * unit
    for z in range(0, size[1], own[1]):
        for y in range(0, size[0], own[0]):
            begin, end = (y, z), (min(y + own[0], size[0]), min(z + own[1], size[1]))
            first = [max(n - h, 0) // unit * unit for n, h in zip(begin, halo)]
            last = [min(n + h, most_) for n, h, most_ in zip(end, halo, size)]
            yield BoxPlace((first[0], first[1]), (last[0], last[1]), begin, end)


def box_bytes(
    size: tuple[int, int], halo: tuple[int, int], row_bytes: int, unit: int, own: tuple[int, int] | None = None
) -> int:
    """The most bytes of a box with ``own`` rows and slices of its own; None: of the smallest boxes."""
    y, z = (min(n, o + 2 * h + unit - 1) for n, o, h in zip(size, own or (unit, unit), halo))
    return y * z * row_bytes
