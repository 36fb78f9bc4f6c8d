"""[shadow]: the volume attenuates light on its way to the samples that it lights."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from clvol.scene.table import COLOR, Fraction, LinearColor, Number, Table, Whole, wrong


class Shadow(Table):
    """Shadows of all lights with ``casts_shadow``, except headlights, which cast none.

    ``method``: "volume" marches towards each light from the points of a light volume, with ``resolution`` points along
    the volume's longest axis; "rays" marches from each sample. Shadow rays use the scene's classification; ``step`` is
    their step in smallest voxel edges, by default that of the scene. With "rays", one is cast only where the opacity of
    the sample times the remaining transmittance exceeds ``bound``. ``scattering`` is the share of light that arrives
    scattered forward, within ``cone_degrees`` about the light's direction; the share 1 - ``scatter_color`` (linear
    light) of the extinction attenuates it.
    """

    method: Literal["volume", "rays"] = Field(
        "volume",
        title="Shadows from a light volume, or from a shadow ray per lit sample.",
        description="'volume' or 'rays'",
    )
    resolution: Whole = Field(
        64, ge=4, le=512,
        title="Points of the light volume along the longest axis of the volume.",
        description="a whole number from 4 to 512",
    )
    step: Number | None = Field(
        None, gt=0, le=1e6,
        title="Step of the march towards the light, in edges of the smallest voxel; by default that of [integration].",
        description="a number greater than 0, at most 1e6",
        examples=[1.0],
    )
    bound: Fraction = Field(
        1e-3,
        title="Opacity times remaining transmittance below which a sample casts no shadow ray.",
        description="a number from 0 to 1",
    )
    scattering: Fraction = Field(
        0.0,
        title="Share of the light that arrives scattered forward, for the method 'volume'.",
        description="a number from 0 to 1",
    )
    scatter_color: LinearColor = Field(
        (1.0, 1.0, 1.0),
        title="Colour that scattered light keeps, in linear light.",
        description=COLOR,
    )
    cone_degrees: Number = Field(
        30.0, ge=0, le=80,
        title="Half angle of the cone of scattered light, in degrees.",
        description="an angle from 0 to 80 degrees",
    )

    @property
    def is_volume(self) -> bool:
        """Whether light is stored in a light volume instead of gathered along shadow rays."""
        return self.method != "rays"

    @classmethod
    def table_name(cls) -> str:
        return "shadow"

    @model_validator(mode="after")
    def _rays_do_not_scatter(self) -> Shadow:
        if not self.is_volume and self.scattering > 0:
            raise wrong("scattering", self.scattering, "0, or the method 'volume'")
        return self
