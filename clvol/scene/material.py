"""[material]: how lit samples and surfaces reflect; read only where something is lit."""

from __future__ import annotations

from pydantic import Field

from clvol.scene.table import Fraction, Number, Table

_SHARE = "a number from 0 to 1"


class Material(Table):
    """Coefficients of the Blinn-Phong model."""

    ambient: Fraction = Field(0.1, description=_SHARE)
    diffuse: Fraction = Field(0.7, description=_SHARE)
    specular: Fraction = Field(0.2, description=_SHARE)
    shininess: Number = Field(20.0, ge=1, le=1e4, description="a number from 1 to 10000")

    @classmethod
    def table_name(cls) -> str:
        return "material"
