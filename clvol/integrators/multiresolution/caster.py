"""Rays through a volume of blocks: the host side of cl/march_blocks.h."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

from clvol.device.arguments import (
    EFFECT_ARGUMENTS,
    Arguments,
    block_arguments,
    scene_arguments,
    view_argument,
)
from clvol.device.effect_state import COUNTERS
from clvol.device.empty_space import dilated, distance_map, surface_mask, visible_mask
from clvol.device.opacity_factors import shown_function
from clvol.device.projection import hidden_score
from clvol.device.transfer_lookup import device_function, scene_nodes, segment_classification
from clvol.device.view import ray_frame
from clvol.features import STEPPINGS, reduced_for_frames
from clvol.features.vocabulary import BLOCK_COUNTERS, CELLS
from clvol.integrators.multiresolution.blocked_volume import BlockedVolume, HeldBlocks
from clvol.integrators.raycast.caster import SECONDS_A_SAMPLE, Raycaster
from clvol.integrators.raycast.history import History
from clvol.integrators.raycast.march import March
from clvol.integrators.raycast.surface_tiles import without_surfaces
from clvol.integrators.raycast.switches import raycast_switches
from clvol.integrators.tiles.geometry import TileGrid
from clvol.integrators.tiles.launch import PacketRenderer
from clvol.integrators.tiles.statistics import corner_statistics
from clvol.opencl.arguments import INT4, RAW, Argument, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import BLOCKS
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.tiles import TILE
from clvol.store.source import DROPPED
from clvol.transfer import TransferFunction
from clvol.transfer.lookup_nodes import visible_cells
from clvol.transfer.pieces import shown_spans, value_gate
from clvol.transfer.step_bounds import most_steps
from clvol.volume.voxel_layout import CELL_SHIFT

# Switches of kernels that work on blocks and cast no rays.
_OF_BLOCKS = (
    "VOXEL_BITS", "VOXEL_SIGNED", "VOXEL_SCALED", "VOXEL_HOLES", "VOXEL_PAIRS", "SAMPLE_BUFFERS",
    "INTERBLOCK", "FILTER", "CLASSIFICATION", "TRANSFER_PIECES",
)  # fmt: skip

Caster = TypeVar("Caster", bound="BlockCaster")


class BlockCaster(Raycaster):
    """As ``Raycaster``, for the method "multiresolution". Scenes with effects take even steps, by the ray caster's own
    marches (cl/march_shaded.h, cl/march_effects.h), with values and gradients of blocks.

    ``blocks``: the resident blocks. ``render`` shows the blocks that are resident at that moment; ``set_resident`` must
    be called after they have changed.
    """

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        blocks: HeldBlocks,
        *,
        lanes: int | None = None,
        skip: bool = True,
        tile: tuple[int, int] = (TILE, TILE),
        march: March | None = None,
        history: History | None = None,
    ) -> None:
        self.blocks = blocks
        self._bounds_are_new = True
        volume = BlockedVolume(context, reduced_for_frames(resolved), blocks)
        super().__init__(
            context, resolved, lanes=lanes, skip=skip, tile=tile, volume=volume, march=march, history=history
        )

    @property
    def structs(self) -> dict[str, np.dtype]:
        return {**super().structs, "Blocks": BLOCKS}

    @property
    def settings(self):
        return self.resolved.multiresolution

    @property
    def _is_midpoint(self) -> bool:
        functions = [self.function]
        return segment_classification(self.resolved.integration, functions) != "preintegrated"

    def set_transfer_function(self, function: TransferFunction) -> None:
        """Another transfer function for the resident blocks: rebuilds tables and empty space."""
        resolved = self.resolved
        self.nodes = scene_nodes(resolved, function)
        mapped = device_function(shown_function(resolved, function), self.volume.values)
        self.function = function
        self.stepping = self._fitting_stepping()
        self._set_colors()
        visible = visible_cells(mapped, self.nodes.values)
        self.gate, self.spans = value_gate(mapped), shown_spans(mapped)
        self._visible = visible, mapped.opacity(self.nodes.values) > 0
        warp = self.nodes.warp
        self.warp = self.context.upload(np.zeros(2, np.float32) if warp is None else warp)
        self._set_switches()
        self.without_surfaces = None
        self.set_resident()

    def _set_switches(self) -> None:
        self.switches = block_switches(
            self.resolved, self.lanes, self.skip, self.stepping, self.function
        )
        self.switches |= self.blocks.switches | self.effects.switches | self.march.switches()

    def _fitting_stepping(self) -> str:
        """The scene's stepping, or "full" where it gives the same steps: if all visible blocks are to be at full
        resolution, one step per sample is an even step, for which there is a faster kernel. Scenes with effects take
        even steps."""
        stepping, goal = self.settings.stepping, self.blocks.goal
        if stepping == "pyramid" or self.effects.switches:  # its march takes steps of its own
            return "full"
        is_even = not ((goal > 0) & (goal != DROPPED)).any()
        return "full" if is_even and stepping in ("limited", "naive") else stepping

    def cell_depths(self) -> None:
        """As in ``Raycaster``: there are no bounds of cells at full resolution."""

    def set_resident(self) -> None:
        """Finds empty space anew in the resident blocks."""
        stepping = self._fitting_stepping()
        if stepping != self.stepping:
            self.stepping = stepping
            self._set_switches()
        assert isinstance(self.volume, BlockedVolume)
        if not self._bounds_are_new:
            self.volume.forget()
        if self.resolved.integration.compositing != "over":
            found = self._projected_cells(self.volume)
        elif self.resolved.noise:
            shows = visible_mask(self.volume, "linear", self.nodes, *self._visible, self._moved)
            found = np.where(shows, CELLS["visible"], CELLS["empty"]).astype(np.uint8)
        else:
            found = self._cells_that_show(*self._visible)
        self._bounds_are_new = False
        self._set_steps()
        self.shown_cells, self.hole_cells = found != CELLS["empty"], found == CELLS["beside-holes"]
        self.shown = self.shown_cells
        if self.resolved.isosurfaces:
            self.shown = self.shown | self._surface_cells()
        if self.effects.switches and (fields := self.effects.fields):
            self.shown = (self.shown | fields.shown) & fields.kept
        self.visible_share = float(self.shown.mean())
        self.march.find_empty_space(self, self.shown)
        self.light_volume_samples = 0
        if self._casts_shadows:
            self._build_shadows()
        self.occlusion_samples = 0
        self._build_occlusion()
        self.without_surfaces = without_surfaces(self)
        self.march.scene_changed(self)

    def _projected_cells(self, volume: BlockedVolume) -> np.ndarray:
        """As ``_cells_that_show``, of a projection: all, since a mean may be a value that occurs in no cell, if the
        function shows anything. The effects get the bounds of what is resident."""
        if not self._bounds_are_new:
            self.effects.update_projection(self.resolved, volume)
        self.effects.set_hidden(hidden_score(self.resolved.integration.compositing, self.gate))
        shows = any(map(np.any, self._visible))
        return np.full(volume.cells[::-1], CELLS["visible" if shows else "empty"], np.uint8)

    def _surface_cells(self) -> np.ndarray:
        """As in ``Raycaster``, of the resident blocks. Cells of voxels lie across the cells of blocks: those beside
        count, too."""
        if self.resolved.noise:
            levels = [float(self.volume.values(surface.value)) for surface in self.resolved.isosurfaces]
            return self._with_surfaces(surface_mask(self.volume, "linear", levels, self._moved))
        nodes = self.nodes.values
        between, at = np.zeros(nodes.size - 1, bool), np.zeros(nodes.size, bool)
        for surface in self.resolved.isosurfaces:
            place = int(np.searchsorted(nodes, float(self.volume.values(surface.value))))
            between[max(place - 2, 0) : place + 1] = at[max(place - 1, 0) : place + 1] = True
        return self._with_surfaces(self._cells_that_show(between, at) != CELLS["empty"])

    def _with_surfaces(self, found: np.ndarray) -> np.ndarray:
        """bool [z, y, x]: the cells ``found``, and those beside where blocks are not at full resolution: there a voxel
        cell may have corners whose values do not occur in its part of a cell. The effects get the distances to them;
        tiles are told apart by cells of the lattice, which lie half a voxel off."""
        around = dilated(found)
        cells = found | (around & ~self._whole_cells)
        self.effects.set_surfaces(distance_map(self.context, cells))
        self.surface_cells = resized_cells(around, self.volume.cell_shift, CELL_SHIFT)
        return cells

    @property
    def _whole_cells(self) -> np.ndarray:
        """bool [z, y, x]: cells of blocks that are, and have around them, nothing but voxels."""
        blocks = self.blocks.blocks
        if not self.settings.interblock:
            return np.zeros(self.volume.cells[::-1], bool)
        whole = ~dilated((self.blocks.levels != 0).reshape(blocks.counts))
        for axis in range(3):
            whole = whole.repeat(blocks.edge >> self.volume.cell_shift, axis=axis)
        return whole

    def _cells_that_show(self, between: np.ndarray, at: np.ndarray) -> np.ndarray:
        """uint8 [z, y, x], ``CELLS``: cells of resident blocks that have a value in one of the intervals ``between``
        nodes, or ``at`` a node."""
        context, volume = self.context, self.volume
        view = self.volume_view()
        kernel = context.kernel(
            "block_cells.cl",
            "visible_block_cells",
            (
                reads("volume", RAW), reads("warp", np.float32, 2), reads("before", np.int32), reads("at", np.uint8),
                self._view_argument, *self._block_arguments, value("first", INT4),
                writes("cells", np.uint8, *volume.cells),
            ),
            self._switches_of_blocks,
        )
        cells = context.empty(np.uint8, volume.cells[::-1])
        given: dict[str, Any] = {
            "volume": volume.voxels,
            "warp": self.warp,
            "before": context.upload(np.concatenate([[0], np.cumsum(between)]).astype(np.int32)),
            "at": context.upload(at.astype(np.uint8)),
            "view": context.upload(view),
            "cells": cells,
        }
        edge = self.blocks.blocks.edge >> volume.cell_shift
        for first, count in self.blocks.boxes():
            box = tuple(n * edge for n in count)
            kernel(context.queue, box, None, first=(*(n * edge for n in first), 0), **(given | self._resident_arrays()))
        return context.read(cells)

    @property
    def _switches_of_blocks(self) -> dict[str, int]:
        of_blocks = {name: self.switches[name] for name in _OF_BLOCKS}
        return of_blocks | {"LANES": 1, "WARPED_CLASSES": int(self.nodes.warp is not None)}

    def _set_steps(self) -> None:
        """For bounded stepping: finds how many steps may be taken at once in each resident block."""
        if self.stepping != "bounded":
            return
        context, blocks = self.context, self.blocks.blocks
        view = self.volume_view()
        kernel = context.kernel(
            "block_bounds.cl",
            "block_bounds",
            (
                reads("volume", RAW), self._view_argument, *self._block_arguments, value("first", INT4),
                writes("bounds", np.float32, blocks.count, 4),
            ),
            self._switches_of_blocks,
        )
        bounds = context.empty(np.float32, (blocks.count, 4))
        given: dict[str, Any] = {
            "volume": self.volume.voxels,
            "view": context.upload(view),
            "bounds": bounds,
        }
        for first, count in self.blocks.boxes():
            kernel(context.queue, count, None, first=(*first, 0), **(given | self._resident_arrays()))
        self.steps = most_steps(
            context.read(bounds),
            device_function(self.function, self.volume.values),
            self.nodes.values,
            self.length,
            self.resolved.integration.step,
            self.settings.step_error,
            blocks.edge,
            self._is_midpoint,
        )
        self._steps = context.upload(np.append(self.steps, np.zeros(4, np.uint8)))

    def for_scene(self: Caster, resolved: ResolvedScene) -> Caster:
        other = super().for_scene(resolved)
        if other.length != self.length:
            other._set_steps()
        return other

    @property
    def _view_argument(self) -> Argument:
        return view_argument(self.volume.switches["VOXEL_BITS"])

    @property
    def _block_arguments(self) -> Arguments:
        return block_arguments(len(self.blocks.samples))

    def _resident_arrays(self) -> dict[str, DeviceArray]:
        assert isinstance(self.volume, BlockedVolume)
        return self.volume.arrays

    def _block_arrays(self) -> dict[str, DeviceArray]:
        arrays = self._resident_arrays()
        return {**arrays, "steps": self._steps} if self.stepping == "bounded" else arrays

    @property
    def _declared(self) -> Arguments:
        return block_arguments(len(self.blocks.samples), bounded=self.stepping == "bounded")

    @property
    def _sample_arguments(self) -> tuple[Arguments, dict[str, DeviceArray]]:
        if not self.effects.switches:
            return self._declared, self._block_arrays()
        return EFFECT_ARGUMENTS + self._declared, {**self.effects.arrays, **self._block_arrays()}

    @property
    def _counter_names(self) -> tuple[str, ...]:
        return (*super()._counter_names, *BLOCK_COUNTERS)

    def counted(self, counts: np.ndarray) -> dict[str, int]:
        """As in ``Raycaster``, with what blocks count."""
        sums = counts.sum(axis=0, dtype=np.uint64)
        named = {name: int(total) for name, total in zip(self._counter_names, sums)}
        shown = self.effects.counted({name: named[name] for name in COUNTERS if name in named})
        named = {name: total for name, total in named.items() if name not in COUNTERS or name in shown}
        return {**named, "occlusion_samples": self.occlusion_samples} if self.occlusion_samples else named

    # As ``RayEngine``, for ``TiledRenderer``

    def packets(self, depth: bool) -> PacketRenderer:
        switches = {**self.switches, "WITH_DEPTH": int(depth)}
        self.check_structs(switches)
        declared, arrays = self._sample_arguments
        return PacketRenderer(
            "tile_rays.cl",
            switches,
            scene_arguments(self.volume.switches["VOXEL_BITS"]) + declared,
            {**self._scene_arrays(), **arrays},
            self.lanes,
            self._most_samples() * SECONDS_A_SAMPLE,
            len(self._counter_names),
        )

    def picture_view(self, camera: Camera, width: int, height: int) -> np.ndarray:
        """``View`` [1] of a whole picture."""
        frame = ray_frame(camera, self.resolved.volume.grid, width, height)
        return self.frame_view(frame, width, height)

    def blank_view(self) -> np.ndarray:
        """``View`` [1] of a picture without pixels."""
        return np.zeros(1, self.view_dtype)

    def corner_statistics(self, view: np.ndarray, grid: TileGrid) -> tuple[np.ndarray, int]:
        blocks, bits = self.blocks.blocks, self.volume.switches["VOXEL_BITS"]
        index = self.blocks.index
        return corner_statistics(self.context, index, blocks, view, bits, grid), blocks.edge


def resized_cells(cells: np.ndarray, shift: int, wanted: int) -> np.ndarray:
    """bool [z, y, x] ``cells`` of 2^``shift`` units as cells of 2^``wanted``: those that hold, or are in, a marked
    one."""
    for axis in range(3):
        if shift > wanted:
            cells = cells.repeat(1 << (shift - wanted), axis=axis)
        elif shift < wanted:
            cells = np.logical_or.reduceat(cells, np.arange(0, cells.shape[axis], 1 << (wanted - shift)), axis=axis)
    return cells


def block_switches(
    resolved: ResolvedScene,
    lanes: int,
    skip: bool,
    stepping: str | None = None,
    function: TransferFunction | None = None,
) -> dict[str, int]:
    """The switches (-D) for a scene of blocks, without those of the samples' type and buffers.
    ``stepping`` and ``function``: used in place of the scene's."""
    settings = resolved.multiresolution
    switches = raycast_switches(resolved, lanes=lanes, skip=skip, function=function)
    even = stepping is None and switches.get("EFFECTS")
    return {
        **switches,
        "BLOCKS": 1,
        "STEPPING": STEPPINGS["full" if even else stepping or settings.stepping],
        "INTERBLOCK": int(settings.interblock),
    }
