"""[[isosurface]]: the surface where the volume takes one value."""

from __future__ import annotations

from pydantic import Field

from clvol.scene.table import Color, Fraction, Number, Table


class Isosurface(Table):
    """``color`` is in the colour space of the transfer function."""

    value: Number = Field(description="a finite number")
    opacity: Fraction = Field(1.0, description="a number from 0 to 1")
    color: Color = Field((0.8, 0.8, 0.75), description="three numbers [r, g, b] from 0 to 1")

    @classmethod
    def table_name(cls) -> str:
        return "isosurface"
