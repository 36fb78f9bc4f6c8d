"""The host side of cl/pyramid.cl: adaptive sampling along rays and across them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clvol.errors import RenderError
from clvol.features import ORACLES
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import PYRAMID
from clvol.render.device_volume import DeviceVolume
from clvol.render.pyramid.layout import FREE_REACH, FREE_SHIFT, map_shape, map_shift
from clvol.render.pyramid.cells import padded_cells, way_map
from clvol.render.pyramid.oracles import Asked, oracle_named
from clvol.render.pyramid.oracles.visible import visible_in_cells
from clvol.render.pyramid.slices import SlicePlan, slice_plan
from clvol.render.raycast import FrameData, Raycaster, device_function, raycast_switches
from clvol.render.view import EVERY_PIXEL, PixelLattice
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.transfer.tables import length_slices, length_tables

COUNTERS = ("oracle_samples", "syntheses", "accumulations")  # COUNT_... of cl/pyramid.h
TILE = 32  # pixels an edge of a tile; a multiple of 2^MOST_LEVELS
WORKERS = 64  # work-items of a group where they are not one
# Switches of kernels that look at voxels and classes alone.
_OF_VOXELS = (
    "VOXEL_BITS", "VOXEL_SIGNED", "VOXEL_SCALED", "VOXEL_HOLES", "VOXEL_PAIRS", "WARPED_CLASSES",
    "FILTER", "CLASSIFICATION",
)  # fmt: skip
_ARGUMENTS = ", in pyramid V1, in map uint8, out counts uint32"


class PyramidCaster(Raycaster):
    """As ``Raycaster``, for scenes of emission and absorption, pre-integrated, and the method "pyramid".

    ``tile``: edge in pixels, a power of two from 2^5 on; ``leap``: whether tiles may leap over empty space. Neither
    changes the picture.
    """

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        *,
        lanes: int | None = None,
        workers: int | None = None,
        tile: int = TILE,
        leap: bool = True,
        volume: DeviceVolume | None = None,
    ) -> None:
        self.oracle = oracle_named(resolved.pyramid.oracle)
        self.leap, self._edge = leap, tile
        lanes = lanes or (16 if context.is_cpu else 1)
        self.workers = workers or workers_for(lanes)
        super().__init__(context, resolved, lanes=lanes, tile=(tile, tile), volume=volume)
        self.tile = (tile, tile)

    @property
    def settings(self):
        return self.resolved.pyramid

    # What depends on the transfer function

    def set_transfer_function(self, function: TransferFunction) -> None:
        super().set_transfer_function(function)
        self.switches = pyramid_switches(
            self.resolved, self.nodes.warp is not None, self.lanes, self.workers, self._edge,
            self.leap,
        )  # fmt: skip
        self._ask_oracle()

    def _ask_oracle(self) -> None:
        resolved, volume = self.resolved, self.volume
        grid = resolved.volume.grid
        spacing = np.asarray(grid.spacing) / grid.smallest_edge
        view = np.zeros(1, self._view_dtype)
        self._describe_volume(view[0])
        self.asked = Asked(
            context=self.context,
            volume=volume,
            function=device_function(self._asked_function, volume.values),
            nodes=self.nodes,
            warp=self.warp,
            view=view,
            switches={name: self.switches[name] for name in _OF_VOXELS},
            epsilon=self.settings.epsilon,
            opacity_edges=grid.smallest_edge / self._asked_function.opacity_unit,
            shift=map_shift(volume.size),
            edges=tuple(float(s) for s in spacing),
            reach=self._reach,
        )
        found = self.oracle.map(self.asked)
        self._find_free_space()
        self.map = found if found is not None else self.context.upload(np.zeros(4, np.uint8))
        self._oracle_numbers = self.oracle.numbers(self.asked)

    def _find_free_space(self) -> None:
        """The map of how far it is to anything visible, on coarse cells: columns sleep by it."""
        asked = replace(self.asked, shift=FREE_SHIFT)
        shown = padded_cells(asked)
        visible_in_cells(asked, shown)
        self.free = way_map(asked, shown, FREE_REACH, unit=1.0)

    def _scene_arrays(self) -> dict[str, DeviceArray]:
        return {**super()._scene_arrays(), "distances": self.free}

    @property
    def _reach(self) -> float:
        """Distances beyond this are of no use: twice that of the coarsest samples along a ray."""
        return float(np.clip(2.0 ** (self.settings.levels + 1) * self._longest_step, 1.0, 64.0))

    @property
    def _longest_step(self) -> float:
        return max(1.0, self.resolved.integration.step)

    @property
    def _slices(self) -> int:
        return length_slices(self.settings.levels, by_chords=True)

    def _table_of(self, function: TransferFunction) -> DeviceArray:
        return length_tables(
            self.context, function, self.nodes.values, self.length, self.settings.levels,
            by_chords=True,
        )  # fmt: skip

    def like(self, resolved: ResolvedScene) -> PyramidCaster:
        other = super().like(resolved)
        if other._reach != self._reach:
            other._ask_oracle()
        return other

    # What depends on the frame

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Callable[[int, int], None] | None = None,
        depth: bool = True,
        lattice: PixelLattice = EVERY_PIXEL,
    ) -> FrameData:
        """As ``Raycaster.render``. Pixels depend on their neighbours: of a ``lattice`` all are rendered."""
        self._plan = slice_plan(self.resolved, camera, width, height)
        data = super().render(camera, width, height, progress, depth)
        if self._shows_nothing:
            data.counters = dict.fromkeys(COUNTERS, 0)
        if lattice != EVERY_PIXEL:
            some = np.s_[lattice.row :: lattice.spacing, lattice.column :: lattice.spacing]
            shown = None if data.depth is None else data.depth[some]
            data = replace(data, rgba=data.rgba[some], depth=shown)
        return data

    renders_all_pixels = True  # whatever the lattice

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        self._plan = SlicePlan.nowhere(self.settings.levels)
        super().warm_up(width, height, depth)

    @property
    def _local_size(self) -> tuple[int]:
        return (self.workers,)

    def _kernel_of(self, name: str, declared: str, switches: dict[str, int]):
        name = "pyramid" if name == "raycast" else name
        return self.context.kernel("pyramid.cl", name, declared, switches, self.oracle.folder)

    def _more_arguments(self, tiles: int) -> tuple[str, dict[str, DeviceArray]]:
        row = np.zeros(1, PYRAMID)
        plan = self._plan
        row["levels"][0, :2] = (plan.levels, plan.oversampling)
        shape = map_shape(self.volume.size, self.asked.shift)
        row["cells"][0] = (*reversed(shape), self.asked.shift)
        free = map_shape(self.volume.size, FREE_SHIFT)
        row["free_cells"][0] = (*reversed(free), FREE_SHIFT)
        row["spacing"][0, :2] = (plan.spacing, plan.growth)
        row["edges"][0, :3] = self.asked.edges
        row["oracle"][0] = self._oracle_numbers
        row["gate"][0, :2] = self._value_gate
        self._tally = self.context.output(np.uint32, (tiles, len(COUNTERS)))
        arrays = {"pyramid": self.context.upload(row), "map": self.map, "counts": self._tally}
        return _ARGUMENTS, arrays

    @property
    def _value_gate(self) -> tuple[float, float]:
        """``gate`` in values: those of the nodes next to what is visible."""
        nodes, last = self.nodes.values, self.nodes.values.size - 1
        low, high = self.gate
        if not low < high:
            return np.inf, -np.inf
        return (
            -np.inf if low < 0 else float(nodes[int(low)]),
            np.inf if high > last else float(nodes[int(high)]),
        )

    def _counters(self, counts: np.ndarray) -> dict[str, int]:
        sums = counts.sum(axis=0, dtype=np.uint64)
        return {name: int(total) for name, total in zip(COUNTERS, sums)}

    def _check_struct(self) -> None:
        super()._check_struct()
        kernel = self._kernel_of("pyramid_size", "out size uint32", self.switches)
        size = self.context.empty(np.uint32, (1,))
        kernel(self.context.queue, (1,), (1,), size=size)
        on_device = int(self.context.read(size)[0])
        if on_device != PYRAMID.itemsize:
            what = f"{on_device} bytes on the device"
            raise RenderError("struct Pyramid", what, f"{PYRAMID.itemsize}")


def workers_for(lanes: int) -> int:
    """Work-items of a tile where a work-item takes so many pixels at a time."""
    return 1 if lanes > 1 else WORKERS


def pyramid_switches(
    resolved: ResolvedScene,
    warped: bool,
    lanes: int,
    workers: int | None = None,
    tile: int = TILE,
    leap: bool = True,
) -> dict[str, int]:
    """What gets compiled for a scene of the method "pyramid"."""
    oracle = oracle_named(resolved.pyramid.oracle)
    return {
        **raycast_switches(resolved, warped=warped, lanes=lanes),
        "WORKERS": workers or workers_for(lanes),
        "TILE": tile,
        "ORACLE": ORACLES[oracle.kernel],
        "LEAPS": int(leap and oracle.leaps),
    }
