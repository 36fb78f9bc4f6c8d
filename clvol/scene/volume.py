"""[volume]: which file, and what to make of it."""

from __future__ import annotations

import math
import os
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from clvol.scene.table import AsTuple, Length, Table, Whole, plain


def _nan_policy(value: Any) -> str | float:
    number = plain(value)
    if isinstance(number, (int, float)) and not isinstance(number, bool):
        if math.isfinite(number):
            return float(number)
    elif value == "transparent":
        return "transparent"
    raise ValueError("neither 'transparent' nor a finite number")


def path_text(value: Any) -> Any:
    return os.fspath(value) if isinstance(value, os.PathLike) else value


def is_path(text: str) -> str:
    if "\0" in text:
        raise ValueError("a null character")
    return text


_Side = Annotated[Whole, Field(ge=1, le=2**31 - 1)]


class VolumeSettings(Table):
    """``file`` is relative to the scene file. ``spacing`` overrides the file's. ``dims`` (nx, ny,
    nz) and ``dtype`` say what a .raw file holds. ``nan`` is what a NaN voxel counts as."""

    file: Annotated[str, BeforeValidator(path_text), AfterValidator(is_path)] = Field(
        min_length=1, description="the name of a volume file, in quotes"
    )
    spacing: Annotated[tuple[Length, Length, Length], AsTuple] | None = Field(
        None, description="three world lengths [x, y, z] greater than 0"
    )
    dims: Annotated[tuple[_Side, _Side, _Side], AsTuple] | None = Field(
        None, description="three whole numbers [nx, ny, nz] greater than 0"
    )
    dtype: str | None = Field(None, min_length=1, description="a voxel type such as 'uint16'")
    nan: Annotated[Any, BeforeValidator(_nan_policy)] = Field(
        "transparent", description="'transparent' or a finite number"
    )

    @classmethod
    def table_name(cls) -> str:
        return "volume"
