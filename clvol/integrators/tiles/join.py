"""Interpolation between the rays of a picture's tiles, on the device (cl/tile_join.cl)."""

from __future__ import annotations

import numpy as np

from clvol.integrators.tiles.geometry import LineTable, Resolution, TileGrid
from clvol.opencl.arguments import INT4, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext

_ARGUMENTS = (
    reads("lines", np.uint8),
    reads("tile_lines", np.int32),
    reads("chosen", np.int32),
    value("shape", INT4),
    writes("image", np.float32, "shape.x", "shape.y", 4),
    writes("depths", np.float32),
)


class Joiner:
    """Fills in the pixels without a ray in the tiles of one picture. ``rows_an_item``: rows of a tile that
    a work-item fills; by default a whole tile where work-items are slow to start, else one, since there may be few
    tiles."""

    def __init__(
        self,
        context: DeviceContext,
        grid: TileGrid,
        depth: bool = True,
        rows_an_item: int | None = None,
    ) -> None:
        self.context, self.grid = context, grid
        self.rows_an_item = rows_an_item or (grid.size if context.is_cpu else 1)
        self.kernel = context.kernel(
            "tile_join.cl", "tile_join", _ARGUMENTS, {"WITH_DEPTH": int(depth)}
        )
        self._table = LineTable()
        self._lines: DeviceArray | None = None

    def join(
        self, resolution: Resolution, chosen: np.ndarray, image: DeviceArray, depths: DeviceArray
    ) -> None:
        """Fills the tiles ``chosen`` (numbers). Every tile must have rays."""
        if not len(chosen):
            return
        context, grid = self.context, self.grid
        before = self._table.entries
        offsets = self._table.offsets(grid, resolution)
        if self._table.entries != before:
            self._lines = context.upload(self._table.array)
        self.kernel(
            context.queue,
            (len(chosen) * -(-grid.size // self.rows_an_item),),
            None,
            lines=self._lines,
            tile_lines=context.upload(offsets),
            chosen=context.upload(np.asarray(chosen, np.int32)),
            shape=(grid.width, grid.height, grid.size, self.rows_an_item),
            image=image,
            depths=depths,
        )


def around(grid: TileGrid, tiles: np.ndarray) -> np.ndarray:
    """int64: ``tiles`` (numbers) and all tiles that touch them, whose pixels depend on them."""
    touched = np.zeros((grid.rows + 2, grid.columns + 2), bool)
    row, column = np.divmod(np.asarray(tiles, np.int64), grid.columns)
    for dy in range(3):
        for dx in range(3):
            touched[row + dy, column + dx] = True
    return np.flatnonzero(touched[1:-1, 1:-1])
