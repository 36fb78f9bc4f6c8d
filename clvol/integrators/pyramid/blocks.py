"""The stepping "pyramid" of the integrator "multiresolution": cl/pyramid.cl on a volume of blocks."""

from __future__ import annotations

import numpy as np

from clvol.integrators.multiresolution.caster import BlockCaster, block_switches
from clvol.integrators.multiresolution.device_blocks import DeviceBlocks
from clvol.integrators.pyramid.cells import upload_cells, way_map
from clvol.integrators.pyramid.layout import FREE_REACH
from clvol.integrators.pyramid.march import TILE, SliceMarch, march_switches, workers_for
from clvol.integrators.pyramid.oracle import BlockCells
from clvol.integrators.pyramid.oracles.resolution import Resolution
from clvol.integrators.raycast.caster import Raycaster, lanes_of
from clvol.opencl.context import DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.store.source import DROPPED


class BlockSliceMarch(SliceMarch):
    """A march whose samples are as far apart as those of the blocks, along rays and across them."""

    def _ask(self, caster: Raycaster) -> None:
        assert isinstance(caster, BlockCaster)
        blocks, levels = caster.blocks.blocks, caster.blocks.levels
        spacing = np.where(levels == DROPPED, np.inf, 2.0 ** np.minimum(levels, blocks.levels))
        cells = blocks.edge >> caster.volume.cell_shift  # per axis of a block
        spacing = spacing.reshape(blocks.counts)
        for axis in range(3):
            spacing = np.repeat(spacing, cells, axis=axis)
        held = BlockCells(caster.shown_cells, spacing, caster.hole_cells)
        self.free_shift, self.free_shape = caster.volume.cell_shift, held.shown.shape
        self.asked = self._question(caster, self.free_shift, self.free_shape, held)
        self.map = self._oracle_map(caster.context)
        shown = upload_cells(self.asked, held.shown.astype(np.uint8))
        self.free = way_map(self.asked, shown, FREE_REACH, unit=1.0)


class BlockPyramidCaster(BlockCaster):
    """A ``BlockCaster`` with a ``BlockSliceMarch``, pre-integrated."""

    march: BlockSliceMarch

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
        lanes = lanes_of(context, lanes)
        march = BlockSliceMarch(Resolution(), lanes, workers, tile, leap)
        super().__init__(context, resolved, blocks, lanes=lanes, skip=False, tile=(tile, tile), march=march)


def block_pyramid_switches(resolved: ResolvedScene, lanes: int) -> dict[str, int]:
    """The switches (-D), without those of the samples' type and buffers."""
    switches = block_switches(resolved, lanes, False, "full")
    return {**switches, **march_switches(Resolution(), workers_for(lanes))}
