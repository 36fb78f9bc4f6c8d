"""The host side of cl/pyramid.cl: adaptive sampling along rays and across them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clvol.device.arguments import Arguments, counts_argument
from clvol.device.view import EVERY_PIXEL, PixelLattice
from clvol.device.volume import DeviceVolume
from clvol.errors import RenderError
from clvol.features import ORACLES, reduced_for_frames
from clvol.features.vocabulary import PYRAMID_COUNTERS
from clvol.integrators.pyramid.cells import padded_cells, way_map
from clvol.integrators.pyramid.clips import halves_rows
from clvol.integrators.pyramid.layout import FREE_REACH, FREE_SHIFT, map_bytes, map_shape, map_shift
from clvol.integrators.pyramid.oracle import (
    KERNEL_ERROR,
    KERNEL_MAP,
    Asked,
    BlockCells,
    Oracle,
)
from clvol.integrators.pyramid.oracles import oracle_named
from clvol.integrators.pyramid.oracles.visible import visible_in_cells
from clvol.integrators.pyramid.slices import SlicePlan, slice_plan
from clvol.integrators.raycast.caster import (
    FrameData,
    Raycaster,
    cycled_function,
    device_function,
    raycast_switches,
)
from clvol.opencl.arguments import reads
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.struct_check import REPORT_ARGUMENTS, check_structs
from clvol.opencl.structs import PYRAMID
from clvol.scene.camera import Camera
from clvol.scene.pyramid import Pyramid
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction

TILE = 32  # pixels an edge of a tile; a multiple of 2^MOST_LEVELS
_MOST_SLICES = 2**23
WORKERS = 64  # work-items of a group where they are not one
# Switches of kernels that look at voxels and classes alone.
_OF_VOXELS = (
    "VOXEL_BITS", "VOXEL_SIGNED", "VOXEL_SCALED", "VOXEL_HOLES", "VOXEL_PAIRS", "FILTER", "CLASSIFICATION", "TRANSFER_PIECES",
)  # fmt: skip


class PyramidMarch:
    """What casters of cl/pyramid.cl have in common; another base is the ``Raycaster`` of their volume, and ``_ask_oracle``
    gives them ``asked``, ``map`` and ``free``."""

    def _prepare_march(
        self, context: DeviceContext, oracle: Oracle, lanes: int | None, workers: int | None,
        tile: int, leap: bool,
    ) -> int:  # fmt: skip
        """Before the other base prepares what it has. Gives the lanes."""
        self.oracle, self.leap, self._edge = oracle, leap, tile
        lanes = lanes or (16 if context.is_cpu else 1)
        self.workers = workers or workers_for(lanes)
        return lanes

    @property
    def pyramid(self) -> Pyramid:
        """The scene's settings."""
        return self.resolved.pyramid

    # What depends on the transfer function

    def _asked(self, shift: int, shape: tuple[int, int, int], blocks: BlockCells | None = None) -> Asked:
        """The question for a map of so many cells of 2^``shift`` lattice cells."""
        resolved, volume = self.resolved, self.volume
        grid = resolved.volume.grid
        spacing = np.asarray(grid.spacing) / grid.smallest_edge
        view = np.zeros(1, self._view_dtype)
        self._describe_volume(view[0])
        return Asked(
            context=self.context,
            volume=volume,
            function=device_function(cycled_function(resolved, self._asked_function), volume.values),
            nodes=self.nodes,
            warp=self.warp,
            view=view,
            switches={name: self.switches[name] for name in _OF_VOXELS}
            | {"WARPED_CLASSES": int(self.nodes.warp is not None)},
            epsilon=self.pyramid.epsilon,
            opacity_edges=grid.smallest_edge / self._asked_function.opacity_unit,
            shift=shift,
            edges=tuple(float(s) for s in spacing),
            reach=self._reach,
            shape=shape,
            filter=resolved.integration.filter,
            blocks=blocks,
        )

    def _scene_arrays(self) -> dict[str, DeviceArray]:
        return {**super()._scene_arrays(), "distances": self.free}

    @property
    def _reach(self) -> float:
        """Distances beyond this are of no use: twice that of the coarsest samples along a ray."""
        step = max(1.0, self.resolved.integration.step)
        return float(np.clip(2.0 ** (self.pyramid.levels + 1) * step, 1.0, 64.0))

    def like(self, resolved: ResolvedScene):
        other = super().like(resolved)
        moved = resolved.animation.time != self.resolved.animation.time and resolved.animation.cycle
        if other._reach != self._reach or moved:
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
        self._check_slices(camera)
        data = super().render(camera, width, height, progress, depth)
        if self._shows_nothing:
            data.counters = dict.fromkeys(self.counter_names, 0)
        if lattice != EVERY_PIXEL:
            some = np.s_[lattice.row :: lattice.spacing, lattice.column :: lattice.spacing]
            shown = None if data.depth is None else data.depth[some]
            data = replace(data, rgba=data.rgba[some], depth=shown)
        return data

    def _check_slices(self, camera: Camera) -> None:
        """RenderError where slices are too many to be told apart in float32."""
        grid = self.resolved.volume.grid
        away = grid.world_corners() - np.asarray(camera.position, np.float64)
        if camera.projection == "orthographic":
            ways = away @ camera.basis()[0]
            first = ways.min()
        else:
            ways = np.linalg.norm(away, axis=1)
            first = max((away @ camera.basis()[0]).min(), 0.0)
        slices = (ways.max() - first) / self.length
        if not slices < _MOST_SLICES:
            what = f"{slices:.3g} slices by the method 'pyramid'"
            expected = f"at most {_MOST_SLICES}: longer steps, a nearer eye, or the method 'raycast'"
            raise RenderError(f"{self.resolved.origin}: integration.step", what, expected)

    renders_all_pixels = True  # whatever the lattice
    counter_names: tuple[str, ...] = PYRAMID_COUNTERS
    _halves = np.zeros((0, 4))  # of space that clips keep

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        self._plan = SlicePlan.nowhere(self.pyramid.levels)
        super().warm_up(width, height, depth)

    @property
    def _local_size(self) -> tuple[int]:
        return (self.workers,)

    def _kernel_of(self, name: str, declared: Arguments, switches: dict[str, int]):
        name = "pyramid" if name == "raycast" else name
        return self.context.kernel("pyramid.cl", name, declared, switches, self.oracle.folder)

    def _more_arguments(self, tiles: int) -> tuple[Arguments, Arguments, dict[str, DeviceArray]]:
        row = np.zeros(1, PYRAMID)
        plan = self._plan
        row["levels"], row["oversampling"] = plan.levels, plan.oversampling
        row["cells"][0, :3], row["cell_shift"] = self.asked.shape[::-1], self.asked.shift
        row["free_cells"][0, :3], row["free_shift"] = self.free_shape[::-1], self.free_shift
        row["ray_spacing"], row["spacing_growth"] = plan.spacing, plan.growth
        row["edges"][0, :3] = self.asked.edges
        row["oracle"][0] = self.oracle.numbers(self.asked)
        row["gate_low"], row["gate_high"] = self.gate
        row["half_count"] = len(self._halves)
        row["halves"][0, : len(self._halves)] = self._halves
        self._tally = self.context.output(np.uint32, (tiles, len(self.counter_names)))
        declared, more = self._source_arguments
        arrays = {"pyramid": self.context.upload(row), "map": self.map, "counts": self._tally}
        own = (reads("pyramid", PYRAMID), reads("map", np.uint8), *counts_argument(len(self.counter_names)))
        return declared, own, {**arrays, **more}

    @property
    def _source_arguments(self) -> tuple[Arguments, dict[str, DeviceArray]]:
        """What samples are taken from beside the first buffer."""
        return (), {}

    def _oracle_map(self) -> DeviceArray:
        """What the oracle found, or what stands for none. RenderError where the kernel would look beyond it."""
        found = self.oracle.map(self.asked)
        needed = map_bytes(self.asked.shape) if self.oracle.kernel in (KERNEL_MAP, KERNEL_ERROR) else 0
        held = 0 if found is None else found.nbytes
        if held < needed:
            where = f"oracle {self.oracle.name!r}"
            raise RenderError(where, f"gave a map of {held} bytes", f"{needed} (clvol.integrators.pyramid.cells)")
        return found if found is not None else self.context.upload(np.zeros(4, np.uint8))

    def _counters(self, counts: np.ndarray) -> dict[str, int]:
        sums = counts.sum(axis=0, dtype=np.uint64)
        return {name: int(total) for name, total in zip(self.counter_names, sums)}

    def _check_struct(self) -> None:
        """As the base does, by pyramid.cl: nothing else of raycast.cl is compiled."""
        kernel = self._kernel_of("struct_fields", REPORT_ARGUMENTS, self.switches)
        check_structs(self.context, kernel, {**self._structs, "Pyramid": PYRAMID})

    def _find_distances(self, *_: np.ndarray) -> None:
        self.distances = None  # columns sleep by ``free``


class PyramidCaster(PyramidMarch, Raycaster):
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
        oracle = oracle_named(resolved.pyramid.oracle)
        lanes = self._prepare_march(context, oracle, lanes, workers, tile, leap)
        resolved = reduced_for_frames(resolved)
        self._halves = halves_rows(resolved.clips, resolved.volume.grid)
        resolved = without_clips(resolved)
        super().__init__(context, resolved, lanes=lanes, tile=(tile, tile), volume=volume)
        self.tile = (tile, tile)

    def set_transfer_function(self, function: TransferFunction) -> None:
        super().set_transfer_function(function)
        self.switches = pyramid_switches(
            self.resolved, self.lanes, self.workers, self._edge, self.leap, function=function,
        )  # fmt: skip
        self._ask_oracle()

    def like(self, resolved: ResolvedScene) -> PyramidCaster:
        return super().like(without_clips(resolved))

    def _ask_oracle(self) -> None:
        size = self.volume.size
        shift = map_shift(size)
        self.asked = self._asked(shift, map_shape(size, shift))
        self.map = self._oracle_map()
        self._find_free_space()

    def _find_free_space(self) -> None:
        """The map of how far it is to anything visible, on coarse cells: columns sleep by it."""
        self.free_shift, self.free_shape = FREE_SHIFT, map_shape(self.volume.size, FREE_SHIFT)
        asked = replace(self.asked, shift=FREE_SHIFT, shape=self.free_shape)
        shown = padded_cells(asked)
        visible_in_cells(asked, shown)
        self.free = way_map(asked, shown, FREE_REACH, unit=1.0)


def without_clips(resolved: ResolvedScene) -> ResolvedScene:
    """What the base of the caster has of the scene: clips are the march's own."""
    return replace(resolved, clips=()) if resolved.clips else resolved


def workers_for(lanes: int) -> int:
    """Work-items of a tile where a work-item takes so many pixels at a time."""
    return 1 if lanes > 1 else WORKERS


def march_switches(
    oracle: Oracle, lanes: int, workers: int | None = None, tile: int = TILE, leap: bool = True
) -> dict[str, int]:
    """What cl/pyramid.cl has beside the switches of what it samples."""
    return {
        "WORKERS": workers or workers_for(lanes),
        "TILE": tile,
        "ORACLE": ORACLES[oracle.kernel],
        "LEAPS": int(leap and oracle.leaps),
    }


def pyramid_switches(
    resolved: ResolvedScene,
    lanes: int,
    *how: int | None,
    function: TransferFunction | None = None,
) -> dict[str, int]:
    """What gets compiled for a scene of the method "pyramid". ``how``: as for ``march_switches``.
    ``function`` instead of the scene's."""
    plain = without_clips(resolved)
    return {
        **raycast_switches(plain, lanes=lanes, function=function),
        **march_switches(oracle_named(resolved.pyramid.oracle), lanes, *how),
    }
