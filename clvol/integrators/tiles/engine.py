"""What casts the rays of tiles."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from clvol.integrators.tiles.geometry import TileGrid
from clvol.integrators.tiles.launch import PacketRenderer
from clvol.opencl.context import DeviceContext
from clvol.scene.camera import Camera


class RayEngine(Protocol):
    """A scene resident on a device that casts the rays of tiles."""

    context: DeviceContext

    @property
    def shows_nothing(self) -> bool:
        """Whether nothing is visible, so that no ray needs to be cast."""

    def packets(self, depth: bool) -> PacketRenderer:
        """The kernel that casts rays, with depths or without."""

    def picture_view(self, camera: Camera, width: int, height: int) -> np.ndarray:
        """``View`` [1] of a whole picture."""

    def blank_view(self) -> np.ndarray:
        """``View`` [1] of a picture of no pixels, all zeros."""

    def corner_statistics(
        self, view: np.ndarray, grid: TileGrid
    ) -> tuple[np.ndarray, int] | None:
        """Statistics of the blocks that rays through the tiles' corners meet [rows + 1, columns + 1, 4]
        (clvol/integrators/tiles/plan.py), and the samples per axis of a block at full resolution; None without
        blocks."""

    def counted(self, counts: np.ndarray) -> dict[str, int]:
        """The counts of effects [work-items, COUNTERS], summed by name."""
