"""[overlay]: what is drawn over the picture: scale bar, colour bar, orientation, box, title, caption."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import COLOR, Color, Number, Table

_BOOL = "true or false"


class Overlay(Table):
    """Drawn over .png, .jpg and .tif pictures and videos at any size, never into .exr and .npy.

    All sizes are relative to the picture. ``scale_bar`` is exact for orthographic cameras; for perspective ones it is
    the length at the distance of the point that the camera looks at, and says so. ``orientation`` names directions by
    the letters of an anatomical frame (L, R, A, P, S, I) where the file has one, and states more than its defaults
    (origin 0 and no direction); otherwise by world axes (+x, -x, …).
    """

    scale_bar: bool = Field(
        False,
        title="Whether a bar of a round world length is shown, with the volume's unit.",
        description=_BOOL,
    )
    color_bar: bool = Field(
        False,
        title="Whether the transfer function is shown: colours, and opacity over the histogram of the volume.",
        description=_BOOL,
    )
    orientation: Literal["none", "letters", "axes"] = Field(
        "none",
        title="How directions are shown: letters at the picture's edges, or arrows in a corner.",
        description="'none', 'letters' or 'axes'",
    )
    box: bool = Field(
        False,
        title="Whether the edges of the volume are shown; those behind the volume are covered by it.",
        description=_BOOL,
    )
    title: str | None = Field(
        None, max_length=2000,
        title="Text at the top.",
        description="text of at most 2000 characters",
        examples=["Head of a visible human"],
    )
    caption: str | None = Field(
        None, max_length=2000,
        title="Text at the bottom, in smaller type.",
        description="text of at most 2000 characters",
        examples=["CT, 1 mm"],
    )
    value_label: str | None = Field(
        None, max_length=200,
        title="Name or unit of the values, beside the colour bar.",
        description="text of at most 200 characters",
        examples=["Hounsfield units"],
    )
    size: Number = Field(
        1.0, ge=0.1, le=10,
        title="Size of everything that is drawn, as a factor.",
        description="a number from 0.1 to 10",
    )
    color: Color | None = Field(
        None,
        title="Colour of text and lines, as on the screen (sRGB); by default black or white, whichever can be read.",
        description=COLOR,
        examples=[[1.0, 1.0, 1.0]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "overlay"

    @property
    def draws(self) -> bool:
        """Whether anything is drawn."""
        lines = self.scale_bar or self.color_bar or self.box or self.orientation != "none"
        return bool(lines or self.title or self.caption)
