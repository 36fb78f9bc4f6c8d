"""[display]: how the light of a picture becomes the colours of a PNG, JPEG, TIFF or video."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Number, Table


class Display(Table):
    """Tone mapping of pictures that are displayed; .exr and .npy hold the light as it is.

    ``exposure``, then ``tone_curve`` are applied to the volume's colours, and the background stays as it is.
    ``clvol develop`` applies other values to a picture that has been rendered.
    """

    exposure: Number = Field(
        0.0, ge=-100, le=100,
        title="Factor on the light of the volume, in stops: 1 doubles it.",
        description="a number of stops from -100 to 100",
    )
    tone_curve: Literal["clip", "reinhard", "filmic"] = Field(
        "clip",
        title="How light becomes brightness: cut off at white, or compressed towards it.",
        description="'clip', 'reinhard' or 'filmic'",
    )
    white: Number = Field(
        4.0, ge=1, le=1e6,
        title="Light that the curves 'reinhard' and 'filmic' show as white; 1 is a surface that reflects all.",
        description="a number from 1 to 1e6",
    )
    transparent: bool = Field(
        False,
        title="Whether .png and .tif have an alpha channel in place of the background.",
        description="true or false",
    )

    @classmethod
    def table_name(cls) -> str:
        return "display"
