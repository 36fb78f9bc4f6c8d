"""A part of a volume on a device, for rays of the whole volume (cl/owned_box.h)."""

from __future__ import annotations

import math

import numpy as np

from clvol.device.effect_switches import effect_switches
from clvol.device.memory import value_map
from clvol.device.volume import DeviceVolume, ResidentVolume
from clvol.features import FILTER_REACH, reduced_for_frames
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume
from clvol.volume.lazy import LazyVolume
from clvol.volume.voxel_layout import CELL_SHIFT, cell_count, padded_size

Lattice = tuple[int, int, int]  # x, y, z
_GRADIENT_REACH = 2  # voxels beyond those of a sample


class PartVolume(ResidentVolume):
    """The voxels that segments need whose front lies in a box: from ``lower`` to before ``upper`` (x, y, z; lattice
    units), and beyond faces of the volume. Bounds of cells are known where such segments may be.

    For even steps and values that kernels take as they are stored. ``in_front`` float32 [height, width]: the opacity
    in front of the box, which depths depend on.
    """

    def __init__(self, context: DeviceContext, resolved: ResolvedScene, lower: Lattice, upper: Lattice) -> None:
        volume, integration = resolved.volume, resolved.integration
        self.values = value_map(volume)
        low, high = self.values(volume.value_range)
        self._value_range = float(low), float(high)
        self.size = padded_size(volume)
        self.cells = cell_count(self.size[0]), cell_count(self.size[1]), cell_count(self.size[2])
        self.cell_shift = CELL_SHIFT
        grid = volume.grid
        # Segments look back a step (curvature) and ahead one; the filter looks around both, gradients around that.
        steps = [integration.step * grid.smallest_edge / edge for edge in grid.spacing]
        beyond = 1 + FILTER_REACH[integration.filter]
        if effect_switches(reduced_for_frames(resolved)).get("GRADIENT"):
            beyond += _GRADIENT_REACH
        ghost = [math.ceil(step) + beyond for step in steps]
        # Cells of empty space begin at multiples of their edge.
        first = [max(a - g, 0) >> CELL_SHIFT << CELL_SHIFT for a, g in zip(lower, ghost)]
        last = [min(b + g + 1, n) for b, g, n in zip(upper, ghost, grid.size)]
        self.stored = tuple(first), tuple(last)
        (x0, y0, z0), (x1, y1, z1) = first, last
        part = Volume(_box(volume, z0, z1, y0, y1, x0, x1), grid.spacing)
        self._part = DeviceVolume(context, part)
        self.switches, self.stride = dict(self._part.switches), self._part.stride
        self.layout = {"OWNED_BOX": 1, "VOXEL_PAIRS": self.switches["VOXEL_PAIRS"]}
        self._first_cell = [a >> CELL_SHIFT for a in first]
        near = [np.zeros(n, bool) for n in self.cells]
        for axis, (a, b, step) in enumerate(zip(lower, upper, steps)):
            reach = math.ceil(step) + 1
            near[axis][max(a - reach, 0) >> CELL_SHIFT : ((b + reach) >> CELL_SHIFT) + 1] = True
        self._near = near[2][:, None, None] & near[1][None, :, None] & near[0][None, None, :]
        faces = [n - 1 for n in grid.size]
        self.view_fields = {
            "owned_from": tuple(-math.inf if a == 0 else a for a in lower),
            "owned_to": tuple(math.inf if b >= face else b for b, face in zip(upper, faces)),
            "stored_from": tuple(first),
            "stored_to": tuple(a + n - 2 for a, n in zip(first, self._part.size)),
        }

    @property
    def voxels(self) -> DeviceArray:  # type: ignore[override]  # an attribute of the base
        return self._part.voxels

    @property
    def value_range(self) -> tuple[float, float]:
        return self._value_range

    @property
    def nbytes(self) -> int:
        """Bytes of the voxels, without what the device adds."""
        (x0, y0, z0), (x1, y1, z1) = self.stored
        return (x1 - x0) * (y1 - y0) * (z1 - z0) * self.switches["VOXEL_BITS"] // 8

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``; nothing is in cells that no segment of this part comes near."""
        low, high = np.ones(self.cells[::-1]), np.zeros(self.cells[::-1])
        x, y, z = self._first_cell
        some_low, some_high = self._part.bounds(apron)
        nz, ny, nx = some_low.shape
        here = np.s_[z : z + nz, y : y + ny, x : x + nx]
        low[here], high[here] = some_low, some_high
        low[~self._near], high[~self._near] = 1.0, 0.0
        return low, high


def _box(volume: Volume, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
    """The voxels [z0:z1, y0:y1, x0:x1]; read from disk, if the volume is not in memory."""
    if isinstance(volume, LazyVolume) and not volume.is_read:
        return volume.box(z0, z1, y0, y1, x0, x1)
    return np.ascontiguousarray(volume.data[z0:z1, y0:y1, x0:x1])
