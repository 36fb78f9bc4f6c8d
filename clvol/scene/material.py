"""[material]: how lit samples and surfaces reflect; read only where something is lit."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Fraction, Number, Table

_SHARE = "a number from 0 to 1"


class Material(Table):
    """Coefficients of the Blinn-Phong model.

    ``two_sided``: the normal is turned towards the viewer; otherwise back faces receive ambient light
    alone. ``light_at`` "ends" lights pre-integrated segments at both ends and weighs the two by where between them what
    is seen of the segment lies on average (Lum, Wilson and Ma 2004). ``fade`` is the gradient magnitude, in value per
    world length, below which shading fades to the unshaded colour.
    """

    ambient: Fraction = Field(0.1, title="Share of the colour that is visible without light.", description=_SHARE)
    diffuse: Fraction = Field(0.7, title="Coefficient of diffuse reflection.", description=_SHARE)
    specular: Fraction = Field(0.2, title="Coefficient of highlights.", description=_SHARE)
    shininess: Number = Field(
        20.0, ge=1, le=1e4,
        title="Exponent of highlights (Blinn-Phong).",
        description="a number from 1 to 10000",
    )
    light_at: Literal["middle", "ends"] = Field(
        "middle",
        title="Where pre-integrated segments are lit: in their middle, or at both ends, weighed by where they show.",
        description="'middle' or 'ends'",
    )
    two_sided: bool = Field(
        True,
        title="Whether normals are turned towards the eye; otherwise back faces receive ambient light alone.",
        description="true or false",
    )
    fade: Number = Field(
        0.0, ge=0, le=1e300,
        title="Gradient magnitude below which shading fades out, in value per world length.",
        description="a finite number, 0 or greater",
    )

    @classmethod
    def table_name(cls) -> str:
        return "material"
