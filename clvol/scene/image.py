"""[image]: the size of the picture and what is behind the volume."""

from __future__ import annotations

from pydantic import Field, model_validator

from clvol.scene.table import Color, Table, Whole, wrong

LARGEST_AXIS = 65536
LARGEST_PIXELS = 2**28  # 4 GiB as float32 RGBA
_SIDE = f"a whole number of pixels from 1 to {LARGEST_AXIS}"


class ImageSettings(Table):
    """``background`` is in the colour space of the transfer function."""

    width: Whole = Field(512, ge=1, le=LARGEST_AXIS, description=_SIDE)
    height: Whole = Field(512, ge=1, le=LARGEST_AXIS, description=_SIDE)
    background: Color = Field((0.0, 0.0, 0.0), description="three numbers [r, g, b] from 0 to 1")

    @classmethod
    def table_name(cls) -> str:
        return "image"

    @model_validator(mode="after")
    def _not_too_many_pixels(self) -> ImageSettings:
        if self.width * self.height > LARGEST_PIXELS:
            expected = f"at most {LARGEST_PIXELS} pixels in all, not {self.width * self.height}"
            raise wrong("width", self.width, expected)
        return self
