"""[[isosurface]]: a surface where the volume has one value."""

from __future__ import annotations

from pydantic import Field

from clvol.scene.table import COLOR, Color, Fraction, Number, Table


class Isosurface(Table):
    """A surface at ``value``, with a colour for each side and an index of refraction.

    ``color`` and ``back_color`` are in the colour space of the transfer function. A ray that meets the surface where
    the value rises sees ``color``, any other ray ``back_color``, which defaults to ``color``. ``refraction`` is the
    index of refraction above the value relative to that below it.
    """

    value: Number = Field(title="Value of the volume on the surface.", description="a finite number", examples=[120.0])
    opacity: Fraction = Field(1.0, title="Opacity of the surface.", description="a number from 0 to 1")
    color: Color = Field(
        (0.8, 0.8, 0.75),
        title="Colour seen from the side of lower values, in the colour space of the transfer function.",
        description=COLOR,
    )
    back_color: Color | None = Field(
        None,
        title="Colour seen from the side of higher values; by default the same as color.",
        description=COLOR,
        examples=[[0.8, 0.3, 0.2]],
    )
    refraction: Number = Field(
        1.0, ge=0.1, le=10,
        title="Index of refraction above the value relative to below it; 1 means rays go straight on.",
        description="an index from 0.1 to 10",
    )

    @classmethod
    def table_name(cls) -> str:
        return "isosurface"
