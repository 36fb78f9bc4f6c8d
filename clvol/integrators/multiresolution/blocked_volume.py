"""A volume on a device as blocks, as integrators see it."""

from __future__ import annotations

import numpy as np

from clvol.device.arguments import Arguments, block_arguments, view_argument
from clvol.device.fields import CellLayout, field_levels
from clvol.device.volume import ResidentVolume
from clvol.features import CLASSIFICATIONS, FILTERS
from clvol.integrators.multiresolution.device_blocks import DeviceBlocks
from clvol.integrators.multiresolution.resident_codes import ResidentCodes
from clvol.integrators.multiresolution.sample_allocator import map_shift
from clvol.opencl.arguments import INT4, RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import BLOCKS, view_dtype
from clvol.scene.resolve import ResolvedScene
from clvol.store.geometry import BlockGrid

HeldBlocks = DeviceBlocks | ResidentCodes

_MORE = ["samples1", "samples2", "samples3"]
_LAYERS = 8  # parts of the volume whose ranges are computed one after another


def levels_of_fields(resolved: ResolvedScene) -> list[int]:
    """Levels of the fields of a reduced scene, which are to take at most a quarter of the memory."""
    return field_levels(resolved, resolved.multiresolution.memory_bytes // 4)


def blocks_struct(grid: BlockGrid) -> np.ndarray:
    """``Blocks`` [1] of cl/block_parameters.h."""
    row = np.zeros(1, BLOCKS)
    row["count"][0, :3] = grid.counts[::-1]
    row["edge"], row["inverse_edge"], row["log_edge"] = grid.edge, 1.0 / grid.edge, grid.levels - 1
    return row


class BlockedVolume(ResidentVolume):
    """A volume on the device as blocks; lattice coordinates are those of ``DeviceVolume``. It has no array of all
    voxels.

    ``bounds`` are those of the resident samples, until ``forget``. Where a scene needs them, for a projection, cells
    are twice as long as in the map of empty space, so that the memory for that map suffices.
    """

    def __init__(self, context: DeviceContext, resolved: ResolvedScene, blocks: HeldBlocks) -> None:
        self.context, self.blocks = context, blocks
        self.values = blocks.value_map
        self.switches = blocks.switches
        self.interblock = resolved.multiresolution.interblock
        grid = blocks.blocks
        nz, ny, nx = grid.shape
        self.size = max(nx, 2), max(ny, 2), max(nz, 2)
        self.stride = (0, 0)
        self.struct = context.upload(blocks_struct(grid))
        self._fine_shift = map_shift(grid, blocks.memory_bytes)
        self._doubled = int(resolved.integration.compositing != "over")
        self.cell_shift = self._fine_shift + self._doubled
        nx, ny, nz = self._fine_cells
        self.cells = nx, ny, nz
        if self._doubled:
            self.cells = -(-nx // 2), -(-ny // 2), -(-nz // 2)
        self._bounds: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def voxels(self) -> DeviceArray:  # type: ignore[override]  # an attribute of the base
        """As in ``ResidentVolume``; for another choice of blocks they may lie in another buffer."""
        return self.blocks.samples[0]

    @property
    def contents(self) -> bytes:
        """As in ``ResidentVolume``: the levels of the resident blocks."""
        return self.blocks.levels.tobytes()

    @property
    def cell_layout(self) -> CellLayout:
        """As in ``ResidentVolume``: blocks begin half a voxel before the first one's centre."""
        return CellLayout(1 << self.cell_shift, -0.5)

    def field_levels(self, resolved: ResolvedScene) -> list[int]:
        """As in ``ResidentVolume``."""
        return levels_of_fields(resolved)

    @property
    def _fine_cells(self) -> tuple[int, int, int]:
        bz, by, bx = self.blocks.blocks.counts
        edge = self.blocks.blocks.edge >> self._fine_shift
        return bx * edge, by * edge, bz * edge

    @property
    def arguments(self) -> Arguments:
        """The arguments of kernels that read blocks, beside ``volume`` and ``view``."""
        return block_arguments(len(self.blocks.samples))

    @property
    def arrays(self) -> dict[str, DeviceArray]:
        blocks = self.blocks
        arrays = {"index": blocks.index, "corners": blocks.corners, "blocks": self.struct}
        return {**arrays, **dict(zip(_MORE, blocks.samples[1:]))}

    def forget(self) -> None:
        """Blocks have changed."""
        self._bounds = None

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        """As in ``ResidentVolume``, of all that is interpolated in a cell, whatever the ``apron``."""
        if self._bounds is None:
            low, high = self._ranges()
            if self._doubled:
                low, high = _coarser(low, np.minimum), _coarser(high, np.maximum)
            self._bounds = low, high
        return self._bounds

    def _ranges(self) -> tuple[np.ndarray, np.ndarray]:
        """float32 [z, y, x] each, of the cells of the map of empty space."""
        context, cells = self.context, self._fine_cells
        view = np.zeros(1, view_dtype(self.switches["VOXEL_BITS"]))
        view["voxel_gain"], view["cell_shift"] = self.values.gain, self._fine_shift
        view["cells"][0, :3] = cells
        kernel = context.kernel(
            "block_cells.cl",
            "block_cell_ranges",
            (
                reads("volume", RAW), view_argument(self.switches["VOXEL_BITS"]), *self.arguments, value("first", INT4),
                writes("ranges", np.float32, "cells", 2),
            ),
            {
                **self.switches, "INTERBLOCK": int(self.interblock), "FILTER": FILTERS["linear"],
                "CLASSIFICATION": CLASSIFICATIONS["post"], "TRANSFER_PIECES": 0, "LANES": 1, "WARPED_CLASSES": 0,
            },
        )  # fmt: skip
        given = {"volume": self.voxels, "view": context.upload(view), **self.arrays}
        low, high = (np.empty(cells[::-1], np.float32) for _ in range(2))
        edge = self.blocks.blocks.edge >> self._fine_shift
        for first, count in self.blocks.boxes():
            axis = int(np.argmax(count))
            layers = -(-count[axis] // _LAYERS)
            for begin in range(0, count[axis], layers):
                start, size = list(first), list(count)
                start[axis] += begin
                size[axis] = min(layers, count[axis] - begin)
                start, size = [edge * n for n in start], [edge * n for n in size]
                ranges = context.empty(np.float32, (int(np.prod(size)), 2))
                kernel(
                    context.queue, tuple(size), None, sizes={"cells": int(np.prod(size))}, first=(*start, 0),
                    ranges=ranges, **given,
                )  # fmt: skip
                found = context.read(ranges).reshape(*size[::-1], 2)
                part = tuple(slice(at, at + n) for at, n in zip(start[::-1], size[::-1]))
                low[part], high[part] = found[..., 0], found[..., 1]
        return low, high


def _coarser(cells: np.ndarray, over: np.ufunc) -> np.ndarray:
    """``over`` applied to groups of 2^3 of ``cells``."""
    for axis, count in enumerate(cells.shape):
        cells = over.reduceat(cells, np.arange(0, count, 2), axis=axis)
    return cells
