"""Slices of pixels at many levels of detail through the samples of a scene: the host side of cl/pyramid.cl."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clvol.device.arguments import Arguments
from clvol.device.transfer_lookup import cycled_function, device_function
from clvol.errors import RenderError
from clvol.features import ORACLES, is_lit
from clvol.features.vocabulary import PYRAMID_COUNTERS
from clvol.integrators.pyramid.cells import padded_cells, way_map
from clvol.integrators.pyramid.clips import halves_rows
from clvol.integrators.pyramid.layout import FREE_REACH, FREE_SHIFT, map_bytes, map_shape, map_shift
from clvol.integrators.pyramid.oracle import KERNEL_ERROR, KERNEL_MAP, Asked, BlockCells, Oracle
from clvol.integrators.pyramid.oracles.visible import visible_in_cells
from clvol.integrators.pyramid.slices import SlicePlan, slice_plan
from clvol.integrators.raycast.march import refined
from clvol.opencl.arguments import reads
from clvol.opencl.context import DeviceArray, DeviceContext, Kernel
from clvol.opencl.struct_check import REPORT_ARGUMENTS, check_structs
from clvol.opencl.structs import PYRAMID
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster

TILE = 32  # pixels per edge of a tile; a multiple of 2^MOST_LEVELS
WORKERS = 64  # work-items of a group that has more than one
CHUNK = 8  # slices that a tile advances by (cl/pyramid.h)
_MOST_SLICES = 2**23
# Switches of kernels that work only on voxels and the transfer function.
_OF_VOXELS = (
    "VOXEL_BITS", "VOXEL_SIGNED", "VOXEL_SCALED", "VOXEL_HOLES", "VOXEL_PAIRS", "FILTER", "CLASSIFICATION",
    "TRANSFER_PIECES",
)  # fmt: skip


class SliceMarch:
    """A ``March`` of all pixels of a tile at once. ``tile``: its edge in pixels, a power of two of at least 2^5;
    ``leap``: whether tiles may leap over empty space. Neither changes the picture.

    ``map`` is the oracle's answer to the question ``asked``; ``free`` maps the distance to anything visible: columns
    sleep by it.
    """

    varies_steps = False
    renders_all_pixels = True
    counters: tuple[str, ...] = PYRAMID_COUNTERS

    def __init__(
        self, oracle: Oracle, lanes: int, workers: int | None = None, tile: int = TILE, leap: bool = True
    ) -> None:
        self.oracle, self.tile, self.leap = oracle, tile, leap
        self.workers = workers or workers_for(lanes)
        self.asked: Asked
        self.map: DeviceArray
        self.free: DeviceArray
        self.free_shape: tuple[int, int, int]
        self.free_shift: int
        self.shown: np.ndarray  # bool [z, y, x]: cells of the caster's maps in which anything can be seen
        self._halves = np.zeros((0, 4))  # half-spaces that clips keep
        self._cut_faces: dict[str, int] = {}
        self.plan: SlicePlan  # of the frame that was announced last

    def adopt(self, resolved: ResolvedScene) -> ResolvedScene:
        if resolved.clips:
            self._halves = halves_rows(resolved.clips, resolved.volume.grid)
        self._cut_faces = cut_face_switches(resolved)
        return without_clips(resolved)

    def switches(self) -> dict[str, int]:
        return {**march_switches(self.oracle, self.workers, self.tile, self.leap), **self._cut_faces}

    def local_size(self, lanes: int) -> tuple[int]:
        return (self.workers,)

    def kernel(self, context: DeviceContext, name: str, declared: Arguments, switches: dict[str, int]) -> Kernel:
        name = "pyramid" if name == "raycast" else name
        return context.kernel("pyramid.cl", name, declared, switches, self.oracle.folder)

    def find_empty_space(self, caster: Raycaster, mask: np.ndarray) -> None:
        """That of rays to surfaces and lights; ``scene_changed`` finds that of slices, with the oracle's map."""
        self.shown = refined(caster, mask) if caster.resolved.isosurfaces else mask

    def scene_changed(self, caster: Raycaster) -> None:
        self._ask(caster)
        caster.distances = self.free

    def for_scene(self, caster: Raycaster, before: Raycaster) -> SliceMarch:
        scene, old = caster.resolved, before.resolved
        other = copy.copy(self)
        moved = scene.animation.time != old.animation.time and scene.animation.cycle
        if _reach(scene) != _reach(old) or moved:
            other.scene_changed(caster)
        return other

    def begin(self, caster: Raycaster, camera: Camera | None, width: int, height: int) -> None:
        scene = caster.resolved
        if camera is None:
            self.plan = SlicePlan.nowhere(scene.pyramid.levels)
            return
        self.plan = slice_plan(scene, camera, width, height)
        _check_slices(scene, camera, caster.length)

    def arguments(self, caster: Raycaster) -> tuple[Arguments, dict[str, DeviceArray]]:
        row = np.zeros(1, PYRAMID)
        plan = self.plan
        row["levels"], row["oversampling"] = plan.levels, plan.oversampling
        row["cells"][0, :3], row["cell_shift"] = self.asked.shape[::-1], self.asked.shift
        row["free_cells"][0, :3], row["free_shift"] = self.free_shape[::-1], self.free_shift
        row["ray_spacing"], row["spacing_growth"] = plan.spacing, plan.growth
        row["edges"][0, :3] = self.asked.edges
        row["oracle"][0] = self.oracle.numbers(self.asked)
        row["gate_low"], row["gate_high"] = caster.gate
        row["half_count"] = len(self._halves)
        row["halves"][0, : len(self._halves)] = self._halves
        arrays = {"pyramid": caster.context.upload(row), "map": self.map}
        return (reads("pyramid", PYRAMID), reads("map", np.uint8)), arrays

    def check_structs(self, caster: Raycaster, switches: dict[str, int]) -> None:
        """As in ``March``, with pyramid.cl: raycast.cl is not compiled."""
        kernel = self.kernel(caster.context, "struct_fields", REPORT_ARGUMENTS, switches)
        check_structs(caster.context, kernel, {**caster.structs, "Pyramid": PYRAMID})

    def _ask(self, caster: Raycaster) -> None:
        """Finds ``map`` and ``free`` for the caster's scene."""
        size = caster.volume.size
        shift = map_shift(size)
        self.asked = self._question(caster, shift, map_shape(size, shift))
        self.map = self._oracle_map(caster.context)
        self.free_shift, self.free_shape = FREE_SHIFT, map_shape(size, FREE_SHIFT)
        coarse = replace(self.asked, shift=FREE_SHIFT, shape=self.free_shape)
        shown = padded_cells(coarse)
        visible_in_cells(coarse, shown)
        self.free = way_map(coarse, shown, FREE_REACH, unit=1.0)

    def _question(
        self, caster: Raycaster, shift: int, shape: tuple[int, int, int], blocks: BlockCells | None = None
    ) -> Asked:
        """The oracle's input for a map of ``shape`` cells of 2^``shift`` lattice cells."""
        scene, volume, function = caster.resolved, caster.volume, caster.function
        grid = scene.volume.grid
        spacing = np.asarray(grid.spacing) / grid.smallest_edge
        return Asked(
            context=caster.context,
            volume=volume,
            function=device_function(cycled_function(scene, function), volume.values),
            nodes=caster.nodes,
            warp=caster.warp,
            view=caster.volume_view(),
            switches={name: caster.switches[name] for name in _OF_VOXELS}
            | {"WARPED_CLASSES": int(caster.nodes.warp is not None)},
            epsilon=scene.pyramid.epsilon / brightest(scene),
            opacity_edges=grid.smallest_edge / function.opacity_unit,
            shift=shift,
            edges=(float(spacing[0]), float(spacing[1]), float(spacing[2])),
            reach=_reach(scene),
            shape=shape,
            filter=scene.integration.filter,
            blocks=blocks,
        )

    def _oracle_map(self, context: DeviceContext) -> DeviceArray:
        """The oracle's map, or a placeholder for none. RenderError where the kernel would read beyond its end."""
        found = self.oracle.map(self.asked)
        needed = map_bytes(self.asked.shape) if self.oracle.kernel in (KERNEL_MAP, KERNEL_ERROR) else 0
        held = 0 if found is None else found.nbytes
        if held < needed:
            where = f"oracle {self.oracle.name!r}"
            raise RenderError(where, f"gave a map of {held} bytes", f"{needed} (clvol.integrators.pyramid.cells)")
        return found if found is not None else context.upload(np.zeros(4, np.uint8))


def _reach(scene: ResolvedScene) -> float:
    """The largest useful distance: twice that of the coarsest samples along a ray."""
    step = max(1.0, scene.integration.step)
    return float(np.clip(2.0 ** (scene.pyramid.levels + 1) * step, 1.0, 64.0))


def _check_slices(scene: ResolvedScene, camera: Camera, length: float) -> None:
    """RenderError where slices, ``length`` apart in the world, are too many to be told apart in float32."""
    away = scene.volume.grid.world_corners() - np.asarray(camera.position, np.float64)
    forward = away @ camera.basis()[0]
    if camera.projection == "orthographic":
        ways, first = forward, forward.min()
    else:
        ways, first = np.linalg.norm(away, axis=1), max(forward.min(), 0.0)
    slices = (ways.max() - first) / length
    if not slices < _MOST_SLICES:
        what = f"{slices:.3g} slices by the method 'pyramid'"
        expected = f"at most {_MOST_SLICES}: longer steps, a nearer eye, or the method 'raycast'"
        raise RenderError(f"{scene.origin}: integration.step", what, expected)


def without_clips(resolved: ResolvedScene) -> ResolvedScene:
    """The scene for the caster: the march handles clips itself."""
    return replace(resolved, clips=()) if resolved.clips else resolved


def brightest(resolved: ResolvedScene) -> float:
    """How many times as large an error of a reduced scene's colours may be under its lights as without, at least 1."""
    if not is_lit(resolved):
        return 1.0
    material = resolved.material
    arriving = sum((light.intensity * np.asarray(light.color, np.float64) for light in resolved.lights), np.zeros(3))
    return max(1.0, material.ambient + (material.diffuse + material.specular) * float(arriving.max()))


def cut_face_switches(resolved: ResolvedScene) -> dict[str, int]:
    """The switch (-D) of a reduced scene whose clips cut faces that are lit."""
    return {"CUT_FACES": 1} if resolved.clips and is_lit(resolved) else {}


def workers_for(lanes: int) -> int:
    """Work-items per tile where a work-item processes ``lanes`` pixels at a time."""
    return 1 if lanes > 1 else WORKERS


def march_switches(oracle: Oracle, workers: int, tile: int = TILE, leap: bool = True) -> dict[str, int]:
    """The switches (-D) of cl/pyramid.cl, without those of the samples."""
    return {
        "WORKERS": workers,
        "TILE": tile,
        "ORACLE": ORACLES[oracle.kernel],
        "LEAPS": int(leap and oracle.leaps),
    }
