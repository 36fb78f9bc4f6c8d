"""[image]: the size of the picture and what is behind the volume."""

from __future__ import annotations

from pydantic import Field, model_validator

from clvol.scene.table import COLOR, Color, Number, Table, Whole, wrong

LARGEST_AXIS = 65536
LARGEST_PIXELS = 2**28  # 4 GiB as float32 RGBA
_SIDE = f"a whole number of pixels from 1 to {LARGEST_AXIS}"


class ImageSettings(Table):
    """Size of the picture, its background, and the density of rays.

    ``background`` is in the colour space of the transfer function. ``ray_spacing`` is the distance between rays in
    pixels, along rows and columns. Pixels between four rays are interpolated where the rays agree to within
    ``ray_tolerance`` in every channel (linear, premultiplied); all other pixels get rays of their own.
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

    @classmethod
    def table_name(cls) -> str:
        return "image"

    @model_validator(mode="after")
    def _not_too_many_pixels(self) -> ImageSettings:
        if self.width * self.height > LARGEST_PIXELS:
            expected = f"at most {LARGEST_PIXELS} pixels in all, not {self.width * self.height}"
            raise wrong("width", self.width, expected)
        return self
