"""[volume]: a file and how to interpret it, or a computed field."""

from __future__ import annotations

import math
import os
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clvol.scene.table import AsTuple, Length, Number, Table, Whole, plain, wrong


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


def _choice(value: Any) -> Any:
    number = plain(value)
    if isinstance(number, int) and not isinstance(number, bool) and 0 <= number < 2**31:
        return number
    if isinstance(value, str) and value:
        return value
    raise ValueError("neither an index nor a name")


Choice = Annotated[Any, BeforeValidator(_choice)]
_Side = Annotated[Whole, Field(ge=1, le=2**31 - 1)]


class VolumeSettings(Table):
    """A volume file, or a computed field.

    ``file`` is relative to the scene file. ``spacing`` overrides that of the file. For a .raw file, ``dims`` (nx, ny,
    nz) and ``dtype`` describe the voxels, ``header_bytes`` counts the bytes before them (-1: the voxels are at the end
    of the file), and ``byte_order`` is the order of their bytes. ``nan`` replaces NaN voxels. Values are ``slope`` *
    stored + ``offset``, applied after the file's own slope and offset; the rest of the scene is stated in these values.
    ``channel``, ``time`` and ``series`` select one of several in a file, by index from 0 or by name; a DICOM series
    also by its SeriesInstanceUID, an array of HDF5 or netCDF by its path inside.

    ``field`` takes the place of a file: it is computed on ``size`` (nx, ny, nz) voxels of 8 bits, with a spacing of 1
    or ``spacing`` (``clvol.volume.procedural.scene_field``).
    """

    file: Annotated[str, BeforeValidator(path_text), AfterValidator(is_path)] | None = Field(
        None, min_length=1,
        title="Volume file, folder of slices or Zarr store, relative to the scene file; or the URL of a Zarr image.",
        description="the name of a volume file, in quotes",
        examples=["brainsmall.nrrd"],
    )
    field: Literal["radial", "ellipsoid", "constant"] | None = Field(
        None,
        title="Computed volume instead of a file, of 8-bit voxels; needs size.",
        description="'radial', 'ellipsoid' or 'constant'",
        examples=["ellipsoid"],
    )
    size: Annotated[tuple[_Side, _Side, _Side], AsTuple] | None = Field(
        None,
        title="Number of voxels along x, y and z of a computed volume.",
        description="three whole numbers [nx, ny, nz] greater than 0",
        examples=[[128, 128, 128]],
    )
    spacing: Annotated[tuple[Length, Length, Length], AsTuple] | None = Field(
        None,
        title="Voxel spacing in world units, instead of that of the file.",
        description="three world lengths [x, y, z] greater than 0",
        examples=[[1.0, 1.0, 1.0]],
    )
    dims: Annotated[tuple[_Side, _Side, _Side], AsTuple] | None = Field(
        None,
        title="Number of voxels along x, y and z of a .raw file.",
        description="three whole numbers [nx, ny, nz] greater than 0",
        examples=[[128, 128, 84]],
    )
    dtype: str | None = Field(
        None, min_length=1,
        title="Voxel type of a .raw file.",
        description="a voxel type such as 'uint16'",
        examples=["uint8"],
    )
    channel: Choice = Field(
        None,
        title="Which channel to read where the file has several.",
        description="the index (from 0) or the name of a channel",
        examples=[0],
    )
    time: Choice = Field(
        None,
        title="Which time step to read where the file has several.",
        description="the index (from 0) of a time",
        examples=[0],
    )
    series: Choice = Field(
        None,
        title="Which series, image or array (its path inside HDF5) to read where there are several.",
        description="the index (from 0) or the name of a series or an array, or a SeriesInstanceUID",
        examples=[0],
    )
    header_bytes: Annotated[Whole, Field(ge=-1, le=2**62)] | None = Field(
        None,
        title="Bytes before the voxels of a .raw file; -1 if the voxels are at its end.",
        description="a whole number of bytes, or -1",
        examples=[0],
    )
    byte_order: Literal["little", "big"] | None = Field(
        None,
        title="Byte order of a .raw file.",
        description="'little' or 'big'",
        examples=["little"],
    )
    slope: Annotated[Number, Field(ge=-1e30, le=1e30)] = Field(
        1.0,
        title="Factor from stored numbers to values, after the file's own; the rest of the scene is in values.",
        description="a finite number that is not 0",
    )
    offset: Annotated[Number, Field(ge=-1e30, le=1e30)] = Field(
        0.0,
        title="Offset from stored numbers to values, after the file's own, such as -1000 for CT kept as HU + 1000.",
        description="a finite number",
    )
    nan: Annotated[Any, BeforeValidator(_nan_policy)] = Field(
        "transparent",
        title="Value that replaces NaN voxels, or 'transparent'.",
        description="'transparent' or a finite number",
    )

    @model_validator(mode="after")
    def _file_or_field(self) -> VolumeSettings:
        if self.file is None and self.field is None:
            raise wrong("file", None, "the name of a volume file, or a field and its size")
        if self.file is not None and self.field is not None:
            raise wrong("field", self.field, "either file or field, not both")
        if self.field is not None and self.size is None:
            expected = "three whole numbers [nx, ny, nz] greater than 0, beside field"
            raise wrong("size", None, expected)
        if self.field is None and self.size is not None:
            raise wrong("size", self.size, "a size beside field alone; for a .raw file, dims")
        if abs(self.slope) < 1e-30:
            raise wrong("slope", self.slope, "a finite number that is not 0")
        for key in ("dims", "dtype", "header_bytes", "byte_order", "channel", "time", "series"):
            value = getattr(self, key)
            if self.field is not None and value is not None:
                raise wrong(key, value, f"no {key} beside field; it has its size, and 8 bits")
        return self

    @classmethod
    def table_name(cls) -> str:
        return "volume"
