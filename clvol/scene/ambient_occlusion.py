"""[ambient_occlusion]: what is enclosed by matter gets less of the light that comes from all around."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Fraction, Length, Number, Table, Whole
from clvol.volume import Grid

_DISTANCE_PER_DIAGONAL = 1.0 / 8.0


class AmbientOcclusion(Table):
    """Light from all around, of which matter within ``distance`` takes a share, less the farther away it is.

    It is found at the points of a grid, ``resolution`` along the volume's longest axis, from ``directions`` rays each
    (obscurance: Zhukov et al. 1998; of volumes: Hernell et al. 2010). Such a point keeps how much light arrives and on
    average from where, so that a surface gets what is before it. In a scene without lights colours are multiplied by
    that share; ``darkens`` says of which light that is one.
    """

    distance: Length | None = Field(
        None,
        title="World length beyond which matter takes no light; by default an eighth of the volume's diagonal.",
        description="a finite world length greater than 0",
        examples=[30.0],
    )
    intensity: Fraction = Field(
        1.0,
        title="Share of that light that matter can take.",
        description="a number from 0 to 1",
    )
    darkens: Literal["all", "ambient"] = Field(
        "all",
        title="All light, or its ambient part alone: material.ambient and the environment's diffuse light.",
        description="'all' or 'ambient'",
    )
    directions: Whole = Field(
        48, ge=8, le=512, multiple_of=2,
        title="Rays per point of the grid, evenly over the sphere.",
        description="an even whole number from 8 to 512",
    )
    resolution: Whole = Field(
        64, ge=4, le=256,
        title="Points of the grid along the longest axis of the volume.",
        description="a whole number from 4 to 256",
    )
    step: Number = Field(
        1.0, gt=0, le=1e6,
        title="Step of these rays in edges of the smallest voxel.",
        description="a number greater than 0, at most 1e6",
    )

    @classmethod
    def table_name(cls) -> str:
        return "ambient_occlusion"

    def complete(self, grid: Grid) -> AmbientOcclusion:
        """A copy with the distance filled in."""
        if self.distance is not None:
            return self
        corners = grid.world_corners()
        lengths = ((corners[:, None] - corners[None]) ** 2).sum(axis=-1) ** 0.5
        return self.model_copy(update={"distance": float(lengths.max()) * _DISTANCE_PER_DIAGONAL})
