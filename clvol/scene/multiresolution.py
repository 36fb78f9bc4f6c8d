"""[multiresolution]: settings of the method of that name."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from clvol.scene.sizes import parse_size
from clvol.scene.table import Table


def _as_text(value: object) -> object:
    """Bytes may be given as a plain number."""
    plain = isinstance(value, int) and not isinstance(value, bool)
    return f"{value} B" if plain else value


def _is_size(text: str) -> str:
    parse_size(text)
    return text


class Multiresolution(Table):
    """``memory``: what the bricks may take on the device; ``memory_bytes`` is it in bytes.

    ``view_weighting``: a block's error counts by what the view sees of it: whether it is in the picture, how many pixels it
    covers and how many of them a voxel. ``occlusion``: and by how much light reaches the eye from it.
    """

    memory: Annotated[str, BeforeValidator(_as_text), AfterValidator(_is_size)] = Field(
        "96 MiB", description="a size such as \"96 MiB\""
    )
    stepping: Literal["full", "limited", "naive", "bounded"] = Field(
        "limited", description="'full', 'limited', 'naive' or 'bounded'"
    )
    interblock: bool = Field(True, description="true or false")
    view_weighting: bool = Field(True, description="true or false")
    occlusion: bool = Field(False, description="true or false")

    @classmethod
    def table_name(cls) -> str:
        return "multiresolution"

    @property
    def memory_bytes(self) -> int:
        return parse_size(self.memory)
