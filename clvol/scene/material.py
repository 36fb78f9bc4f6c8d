"""[material]: how lit samples and surfaces reflect; read only where something is lit."""

from __future__ import annotations

from pydantic import Field

from clvol.scene.table import Fraction, Number, Table

_SHARE = "a number from 0 to 1"


class Material(Table):
    """Coefficients of the Blinn-Phong model.

    ``two_sided``: the normal is turned to the viewer; otherwise a back face gets no light but the
    ambient one. ``fade``: the gradient's magnitude, in value per world length, below which shading
    fades to the unshaded colour.
    """

    ambient: Fraction = Field(0.1, description=_SHARE)
    diffuse: Fraction = Field(0.7, description=_SHARE)
    specular: Fraction = Field(0.2, description=_SHARE)
    shininess: Number = Field(20.0, ge=1, le=1e4, description="a number from 1 to 10000")
    two_sided: bool = Field(True, description="true or false")
    fade: Number = Field(0.0, ge=0, le=1e300, description="a finite number, 0 or greater")

    @classmethod
    def table_name(cls) -> str:
        return "material"
