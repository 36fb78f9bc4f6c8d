"""[multiresolution]: settings of the method of that name."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from clvol.scene.sizes import parse_size
from clvol.scene.table import Number, Size, Table, Whole, wrong

_TILES = "0 (every pixel has a ray), or a whole number of pixels from 2 to 256"
_SHARE = "a share of a tile's edge, greater than 0 and at most 1"


class Multiresolution(Table):
    """Blocks within a memory budget, each at a resolution that suits the picture.

    ``memory`` is the device memory that blocks may take; ``memory_bytes`` is the same in bytes.

    ``view_weighting``: the error of a block is weighted by its visibility: whether it is in the picture, how many pixels
    it covers, and how many pixels per voxel. ``occlusion``: it is also weighted by how much of its light
    reaches the eye.

    ``step_error`` applies to "bounded" stepping: the error of a colour that one segment may add (linear,
    premultiplied).

    ``tiles`` is the edge in pixels of the tiles that the picture is cut into; with 0 every pixel has its own ray.
    ``tile_priority`` derives the priority of a tile, and so its number of rays, from the resolutions of the blocks
    behind its corners. ``tile_low`` and ``tile_high`` are the rays per axis of the tiles of lowest and highest
    priority, divided by ``tiles``.
    """

    memory: Size = Field(
        "96 MiB",
        title="Device memory for samples, their index, staging and the map of empty space.",
        description="a size such as \"96 MiB\"",
    )
    stepping: Literal["full", "limited", "naive", "bounded", "pyramid"] = Field(
        "limited",
        title="How step lengths follow the resolution of blocks; see data/examples/README.md.",
        description="'full', 'limited', 'naive', 'bounded' or 'pyramid'",
    )
    step_error: Number = Field(
        0.03, gt=0, le=1,
        title="Error of a colour that one step of 'bounded' stepping may add (linear, premultiplied).",
        description="a number greater than 0, at most 1",
    )
    interblock: bool = Field(
        True,
        title="Whether values are interpolated between blocks (no seams); false is faster and shows seams.",
        description="true or false",
    )
    view_weighting: bool = Field(
        True,
        title="Whether the error of a block is weighted by what the view shows of it.",
        description="true or false",
    )
    occlusion: bool = Field(
        True,
        title="Whether the error of a block is weighted by how much of its light reaches the eye.",
        description="true or false",
    )
    tiles: Whole = Field(
        0, ge=0, le=256,
        title="Edge of image tiles with adaptive ray density, in pixels; 0 sends a ray through every pixel.",
        description=_TILES,
    )
    tile_priority: Literal["max", "average", "rms"] = Field(
        "max",
        title="How the resolutions of the blocks behind its corners give a tile its ray density.",
        description="'max', 'average' or 'rms'",
    )
    tile_low: Number = Field(
        0.1, gt=0, le=1,
        title="Rays per axis of the tiles of lowest priority, divided by tiles.",
        description=_SHARE,
    )
    tile_high: Number = Field(
        0.9, gt=0, le=1,
        title="Rays per axis of the tiles of highest priority, divided by tiles.",
        description=_SHARE,
    )

    @classmethod
    def table_name(cls) -> str:
        return "multiresolution"

    @model_validator(mode="after")
    def _tiles_fit(self) -> Multiresolution:
        if self.tiles == 1:
            raise wrong("tiles", self.tiles, _TILES)
        if self.tile_low > self.tile_high:
            expected = f"at most multiresolution.tile_high, {self.tile_high}"
            raise wrong("tile_low", self.tile_low, expected)
        return self

    @property
    def memory_bytes(self) -> int:
        return parse_size(self.memory)
