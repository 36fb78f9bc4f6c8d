"""The plain ray caster for pictures made of tiles (cl/tile_rays.cl)."""

from __future__ import annotations

import numpy as np

from clvol.device.arguments import EFFECT_ARGUMENTS, scene_arguments
from clvol.device.effect_state import COUNTERS
from clvol.device.view import ray_frame
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.tiles.geometry import TileGrid
from clvol.integrators.tiles.launch import PacketRenderer
from clvol.scene.camera import Camera

_SECONDS_A_SAMPLE = 1e-8  # as of a whole picture


class TileRaycaster(Raycaster):
    """A ``Raycaster`` that casts lists of rays too: an engine for ``TiledRenderer``. It has no
    blocks, so all its tiles are of the same resolution to begin with."""

    def packets(self, depth: bool) -> PacketRenderer:
        has_effects = bool(self.effects.switches)
        return PacketRenderer(
            "tile_rays.cl",
            {**self.switches, "WITH_DEPTH": int(depth)},
            scene_arguments(self.switches["VOXEL_BITS"]) + (EFFECT_ARGUMENTS if has_effects else ()),
            {**self._scene_arrays(), **(self.effects.arrays if has_effects else {})},
            self.lanes,
            self._most_samples() * _SECONDS_A_SAMPLE,
            len(COUNTERS) if has_effects else 0,
        )

    def picture_view(self, camera: Camera, width: int, height: int) -> np.ndarray:
        """``View`` [1] of a whole picture."""
        frame = ray_frame(camera, self.resolved.volume.grid, width, height)
        return self.frame_view(frame, width, height)

    def blank_view(self) -> np.ndarray:
        """``View`` [1] of a picture of no pixels."""
        return np.zeros(1, self.view_dtype)

    def corner_statistics(self, view: np.ndarray, grid: TileGrid) -> None:
        return None

    def counted(self, counts: np.ndarray) -> dict[str, int]:
        """What effects counted, by name."""
        return super().counted(counts)
