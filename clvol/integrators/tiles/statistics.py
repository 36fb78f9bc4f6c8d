"""Statistics of the blocks that rays through the corners of tiles meet, from the index of blocks on the device."""

from __future__ import annotations

import numpy as np

from clvol.device.arguments import view_argument
from clvol.integrators.tiles.geometry import TileGrid
from clvol.opencl.arguments import INT4, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.store.geometry import BlockGrid


def corner_statistics(
    context: DeviceContext,
    index: DeviceArray,
    blocks: BlockGrid,
    view: np.ndarray,
    voxel_bits: int,
    tiles: TileGrid,
) -> np.ndarray:
    """float32 [rows + 1, columns + 1, 4], as described in clvol/integrators/tiles/plan.py. ``index`` int32
    [blocks, 2] (bits 0 ... 3 of a block's second word say how many samples it has); ``view``:
    ``View`` [1] of the whole picture, for voxels of ``voxel_bits``."""
    shape = (tiles.rows + 1, tiles.columns + 1)
    declared = (
        reads("index", np.int32, blocks.count, 2),
        view_argument(voxel_bits),
        value("grid", INT4),
        value("tiles", INT4),
        writes("statistics", np.float32, *shape, 4),
    )
    kernel = context.kernel(
        "tile_statistics.cl", "tile_statistics", declared, {"LANES": 1, "VOXEL_BITS": voxel_bits}
    )
    statistics = context.empty(np.float32, (*shape, 4))
    on_device = context.upload(view)
    z, y, x = blocks.counts
    kernel(
        context.queue,
        (shape[0] * shape[1],),
        None,
        index=index,
        view=on_device,
        grid=(x, y, z, blocks.edge),
        tiles=(tiles.columns, tiles.rows, tiles.size, 0),
        statistics=statistics,
    )
    return context.read(statistics)
