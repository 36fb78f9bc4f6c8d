"""The method "multiresolution" with the stepping "pyramid": cl/pyramid.cl on a volume of blocks."""

from __future__ import annotations

import numpy as np

from clvol.device.arguments import Arguments
from clvol.features.vocabulary import BLOCK_COUNTERS, PYRAMID_COUNTERS
from clvol.integrators.multiresolution.caster import BlockCaster, block_switches
from clvol.integrators.multiresolution.device_blocks import DeviceBlocks
from clvol.integrators.pyramid.caster import TILE, PyramidMarch, march_switches
from clvol.integrators.pyramid.cells import upload_cells, way_map
from clvol.integrators.pyramid.layout import FREE_REACH
from clvol.integrators.pyramid.oracle import BlockCells
from clvol.integrators.pyramid.oracles.resolution import Resolution
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.store.source import DROPPED
from clvol.transfer import TransferFunction


class BlockPyramidCaster(PyramidMarch, BlockCaster):
    """As ``BlockCaster``, pre-integrated, with samples as far apart as the blocks' own: along rays and across them."""

    counter_names = (*PYRAMID_COUNTERS, *BLOCK_COUNTERS)

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        blocks: DeviceBlocks,
        *,
        lanes: int | None = None,
        workers: int | None = None,
        tile: int = TILE,
        leap: bool = True,
    ) -> None:
        lanes = self._prepare_march(context, Resolution(), lanes, workers, tile, leap)
        super().__init__(context, resolved, blocks, lanes=lanes, tile=(tile, tile))
        self.tile = (tile, tile)

    def _fitting_stepping(self) -> str:
        return "pyramid"

    def _set_switches(self) -> None:
        self.switches = block_pyramid_switches(
            self.resolved, self.lanes, self.workers, self._edge, self.leap, function=self._asked_function
        )
        self.switches |= self.blocks.switches

    def set_resident(self) -> None:
        super().set_resident()
        self._ask_oracle()

    def _ask_oracle(self) -> None:
        blocks, levels = self.blocks.blocks, self.blocks.levels
        spacing = np.where(levels == DROPPED, np.inf, 2.0 ** np.minimum(levels, blocks.levels))
        cells = blocks.edge >> self.volume.cell_shift  # of a block, an axis
        spacing = spacing.reshape(blocks.counts)
        for axis in range(3):
            spacing = np.repeat(spacing, cells, axis=axis)
        held = BlockCells(self.shown_cells, spacing, self.hole_cells)
        self.free_shift, self.free_shape = self.volume.cell_shift, held.shown.shape
        self.asked = self._asked(self.free_shift, self.free_shape, held)
        self.map = self._oracle_map()
        shown = upload_cells(self.asked, held.shown.astype(np.uint8))
        self.free = way_map(self.asked, shown, FREE_REACH, unit=1.0)

    @property
    def _source_arguments(self) -> tuple[Arguments, dict[str, DeviceArray]]:
        return self._declared, self._resident_arrays()


def block_pyramid_switches(
    resolved: ResolvedScene,
    lanes: int,
    *how: int | None,
    function: TransferFunction | None = None,
) -> dict[str, int]:
    """What gets compiled, but for what the samples' type and buffers add. ``how``: as for ``march_switches``.
    ``function`` instead of the scene's."""
    switches = block_switches(resolved, lanes, False, "full", function)
    return {**switches, **march_switches(Resolution(), lanes, *how)}
