"""[image]: the size of the picture and what is behind the volume."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from clvol.scene.table import COLOR, Color, Number, Table, Whole, wrong

LARGEST_AXIS = 65536
LARGEST_PIXELS = 2**28  # 4 GiB as float32 RGBA
_SIDE = f"a whole number of pixels from 1 to {LARGEST_AXIS}"


class ImageSettings(Table):
    """Size of the picture, its background, and the number of rays.

    ``background`` is in the colour space of the transfer function. ``ray_spacing`` is the distance between rays in
    pixels, along rows and columns. Pixels between four rays are interpolated where the rays agree to within
    ``ray_tolerance`` in every channel (linear, premultiplied); all other pixels get rays of their own.

    With ``samples`` more than 1 a pixel is the mean, in linear light, premultiplied, of so many rays through it: all
    pixels with ``refine`` "all"; with "edges" those that differ from a neighbour, and those that may hide something
    thinner than a pixel. Others keep the one ray through their middle. "graded" takes fewer rays for the same error:
    pixels that are not what lies half way between their neighbours are the mean of that ray and of ``samples`` more, or
    of half as many where they differ by less than three times the threshold.
    """

    width: Whole = Field(512, ge=1, le=LARGEST_AXIS, title="Width of the picture in pixels.", description=_SIDE)
    height: Whole = Field(512, ge=1, le=LARGEST_AXIS, title="Height of the picture in pixels.", description=_SIDE)
    background: Color = Field(
        (0.0, 0.0, 0.0),
        title="Colour behind the volume in PNG files and videos, in the colour space of the transfer function.",
        description=COLOR,
    )
    ray_spacing: Whole = Field(
        1, ge=1, le=16,
        title="Distance between rays in pixels; pixels between similar rays are interpolated, others get their own.",
        description="a whole number of pixels from 1 to 16",
    )
    ray_tolerance: Number = Field(
        0.01, ge=0, le=1,
        title="Largest difference of neighbouring rays across which pixels are interpolated (linear, premultiplied).",
        description="a number from 0 to 1",
    )

    samples: Literal[1, 2, 4, 8, 16] = Field(
        1,
        title="Rays per pixel; of more than 1, a pixel is the mean.",
        description="1, 2, 4, 8 or 16",
        examples=[4],
    )
    sample_pattern: Literal["rotated", "regular"] = Field(
        "rotated",
        title="Where a pixel's rays are: in rows and columns of their own (better at upright edges), or on a grid.",
        description="'rotated' (each ray in a row and a column of its own) or 'regular' (a grid)",
    )
    refine: Literal["edges", "graded", "all"] = Field(
        "edges",
        title="Which pixels get more than one ray: those at edges in the displayed picture, or all.",
        description="'edges' (where colour, opacity or depth changes between pixels), 'graded' (where that change "
        "bends, and more rays where it bends more) or 'all'",
    )
    edge_threshold: Number = Field(
        0.02, ge=0, le=1,
        title="Difference of neighbouring pixels, as displayed over the background (0 to 1), that makes an edge.",
        description="a number from 0 (all pixels) to 1",
    )
    pixel_filter: Literal["box", "tent", "gaussian", "mitchell"] = Field(
        "box",
        title="How a pixel weighs the rays around its middle; all but 'box' reach into neighbouring pixels.",
        description="'box' (the mean over the pixel), 'tent', 'gaussian' (both softer) or 'mitchell' (sharper)",
    )

    @property
    def refines(self) -> bool:
        """Whether some pixels get more rays than others."""
        return self.samples > 1 and self.refine != "all"

    @classmethod
    def table_name(cls) -> str:
        return "image"

    @model_validator(mode="after")
    def _not_too_many_pixels(self) -> ImageSettings:
        if self.width * self.height > LARGEST_PIXELS:
            expected = f"at most {LARGEST_PIXELS} pixels in all, not {self.width * self.height}"
            raise wrong("width", self.width, expected)
        return self

    @model_validator(mode="after")
    def _graded_pixels_are_means(self) -> ImageSettings:
        if self.refine == "graded" and self.pixel_filter != "box":
            raise wrong("refine", self.refine, "'edges' or 'all' with a pixel_filter other than 'box'")
        return self
