"""Rays through blocks of which not all are decoded at a time."""

from __future__ import annotations

import numpy as np

from clvol.device.view import RayFrame
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.multiresolution.coded_residency import seen_by_tiles
from clvol.integrators.multiresolution.resident_codes import ResidentCodes
from clvol.integrators.raycast.caster import TilesDone
from clvol.integrators.raycast.tile_groups import tile_groups
from clvol.opencl.context import DeviceArray


class CodedBlockCaster(BlockCaster):
    """As ``BlockCaster``, with ``ResidentCodes``: before tiles are rendered, the blocks that their rays may need are
    decoded. Where the pool does not hold those of the whole picture, tiles are rendered in groups. The picture does not
    depend on the pool."""

    def _trace(
        self,
        frame: RayFrame,
        size: tuple[int, int],
        view: np.ndarray,
        tiles: int,
        depth: bool,
        progress: TilesDone | None,
        outputs: dict[str, DeviceArray],
        wanted: np.ndarray | None = None,
    ) -> tuple[list[DeviceArray], dict[str, int]]:
        blocks = self.blocks
        assert isinstance(blocks, ResidentCodes)
        ranges = seen_by_tiles(frame, self.resolved.volume.grid, blocks.blocks, blocks.levels, size, self.tile)
        columns, rows = (-(-n // m) for n, m in zip(size, self.tile))
        tallies: list[DeviceArray] = []
        done = 0
        for group, seen in tile_groups(ranges, blocks.sample_bytes(blocks.levels), blocks.pool_bytes, columns, rows):
            blocks.hold(np.flatnonzero(seen), "a tile")
            report = None if progress is None else lambda more, before=done: progress(min(before + more, tiles))
            found, _ = super()._trace(frame, size, view, tiles, depth, report, outputs, group)
            tallies += found
            if group is not None:
                done += int(group.sum())
                self.context.finish()
        return tallies, {}
