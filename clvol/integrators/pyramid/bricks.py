"""The method "pyramid" on codes that stay on the device: slices of pixels through a pool of decoded bricks."""

from __future__ import annotations

import numpy as np

from clvol.device.tile_ranges import Ranges, tile_ranges
from clvol.device.view import RayFrame
from clvol.integrators.pyramid.march import CHUNK, TILE, SliceMarch
from clvol.integrators.pyramid.oracles import oracle_named
from clvol.integrators.raycast.bricks import BrickCaster, BrickVolume
from clvol.integrators.raycast.caster import lanes_of
from clvol.opencl.context import DeviceContext
from clvol.scene.resolve import ResolvedScene

# How far outside the volume pixels are sampled, in spacings of the coarsest (near_volume of cl/pyramid_levels.h).
_SPACINGS = 3.0


class BrickPyramidCaster(BrickCaster):
    """A ``BrickCaster`` with a ``SliceMarch``. The picture is that of ``PyramidCaster`` bit for bit.

    Pixels of coarse levels are sampled where nothing is visible, too, and what is visible is synthesised from them. So
    a group of tiles needs all bricks that pixels of any level see, in the tiles and around them.
    """

    march: SliceMarch

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        volume: BrickVolume,
        *,
        lanes: int | None = None,
        workers: int | None = None,
        tile: int = TILE,
        leap: bool = True,
    ) -> None:
        lanes = lanes_of(context, lanes)
        march = SliceMarch(oracle_named(resolved.pyramid.oracle), lanes, workers, tile, leap)
        super().__init__(context, resolved, volume, lanes=lanes, tile=(tile, tile), march=march)

    @property
    def _skips(self) -> bool:
        return False

    def _found_ranges(self, frame: RayFrame, size: tuple[int, int]) -> Ranges:
        blocks, spacing = self.volume.pool.blocks, np.asarray(self.resolved.volume.grid.spacing)
        edges = spacing / spacing.min()
        coarsest, reach = self._coarsest(frame, edges)
        upper = np.asarray(self.volume.size) - 1
        low = blocks.places(self.needed)[:, ::-1] * blocks.edge
        high = np.minimum(low + blocks.edge, upper)
        # A place outside the volume has the value at the volume's hull.
        low = low - np.where(low == 0, reach / edges, 0.0) - self._beside
        high = high + np.where(high == upper, reach / edges, 0.0) + self._beside
        return tile_ranges(low, high, frame, np.diag(edges), size, self.tile, coarsest)

    def _coarsest(self, frame: RayFrame, edges: np.ndarray) -> tuple[int, float]:
        """The pixels of the picture along the coarsest one; and how far, in smallest edges, outside the volume such are
        sampled."""
        plan, step = self.march.plan, self.resolved.integration.step
        corners = np.stack(np.meshgrid(*((0, n - 1) for n in self.volume.size)), axis=-1).reshape(-1, 3)
        farthest = np.linalg.norm((corners - frame.origin) * edges, axis=1).max()
        spacing = plan.spacing + plan.growth * farthest / step
        coarsest = 1 << (plan.levels + plan.oversampling)
        return coarsest, _SPACINGS * spacing * coarsest + max(CHUNK, 1 << plan.levels) * step
