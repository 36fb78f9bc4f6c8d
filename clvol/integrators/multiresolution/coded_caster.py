"""Rays through blocks of which not all are decoded at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clvol.device.view import RayFrame
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.multiresolution.coded_residency import seen_by_tiles
from clvol.integrators.multiresolution.resident_codes import ResidentCodes
from clvol.integrators.multiresolution.scene_errors import effects_on_blocks
from clvol.integrators.raycast.tile_groups import tile_groups


class CodedBlockCaster(BlockCaster):
    """As ``BlockCaster``, with ``ResidentCodes``: before tiles are rendered, the blocks that their rays may need are
    decoded. Where the pool does not hold those of the whole picture, tiles are rendered in groups. The picture does not
    depend on the pool."""

    @property
    def lists_rays(self) -> bool:
        return False  # what a list needs is not known tile by tile

    def groups(
        self, frame: RayFrame, size: tuple[int, int], tiles: np.ndarray | None
    ) -> Iterator[np.ndarray | None]:
        blocks = self.blocks
        assert isinstance(blocks, ResidentCodes)
        grids, reach = (self.resolved.volume.grid, blocks.blocks), effects_on_blocks(self.resolved).reach
        ranges = seen_by_tiles(frame, *grids, blocks.levels, size, self.tile, reach)
        columns, rows = (-(-n // m) for n, m in zip(size, self.tile))
        room = blocks.sample_bytes(blocks.levels)
        for group, seen in tile_groups(ranges, room, blocks.pool_bytes, columns, rows, tiles):
            blocks.hold(np.flatnonzero(seen), "a tile")
            yield group
