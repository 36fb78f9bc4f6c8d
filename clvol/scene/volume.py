"""[volume]: a file and how to interpret it, or a computed field."""

from __future__ import annotations

import math
import os
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from clvol.readers.options import ALL_TIMES
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


def _files(value: Any) -> Any:
    """One name, or a tuple of names."""
    if isinstance(value, (list, tuple)):
        if not value:
            raise ValueError("no file")
        return tuple(_file(each) for each in value)
    return _file(value)


def _file(value: Any) -> str:
    text = path_text(value)
    if not isinstance(text, str) or not text:
        raise ValueError("no name of a file")
    return is_path(text)


def _value_range(value: Any) -> Any:
    numbers = [plain(each) for each in value] if isinstance(value, (list, tuple)) else []
    if len(numbers) == 2 and all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in numbers):
        low, high = map(float, numbers)
        if -1e30 <= low <= high <= 1e30:
            return low, high
    raise ValueError("no range")


_FILES_SCHEMA = WithJsonSchema(
    {"anyOf": [{"type": "string", "minLength": 1}, {"type": "array", "items": {"type": "string"}, "minItems": 1}]}
)
_RANGE_SCHEMA = WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2})
_OF_FILES = (
    "dims", "dtype", "header_bytes", "byte_order", "channel", "color", "time", "series", "step", "steps_per_second",
    "value_range",
)  # fmt: skip
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

    A pattern (``*``, ``?``, ``[...]``; in natural order, t_2 before t_10) or a list of files is a series: a volume that
    changes over time. So is a file with an axis of times, where ``time`` is "all". The step at time t in seconds
    (``animation.time``, or that of a frame) is number floor(``steps_per_second`` * t), the last one after the end
    unless ``loop``. By default all steps are spread over ``animation.frames``; without these there is a frame for each
    step. ``step`` is the step that is shown whatever the time. Range, transfer function and look are those of all
    times, for which each step is read once, unless ``value_range`` states the range.

    ``color``: voxels are red, green, blue and perhaps alpha, and show these colours; the transfer function classifies
    their "luminance" (Rec. 709), their "brightness" (largest component) or their "alpha", and gives opacities alone.

    ``field`` takes the place of a file: it is computed on ``size`` (nx, ny, nz) voxels of 8 bits, with a spacing of 1
    or ``spacing`` (``clvol.volume.procedural.scene_field``).
    """

    file: Annotated[Any, BeforeValidator(_files), _FILES_SCHEMA] | None = Field(
        None,
        title="Volume file, folder of slices, Zarr store or URL; a pattern or a list of them is a series in time.",
        description="the name of a volume file, in quotes, a pattern such as 't_*.nrrd', or a list of names",
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
    color: Literal["luminance", "brightness", "alpha"] | None = Field(
        None,
        title="The file's channels are colours of voxels (RGB, RGBA); which value of theirs is classified.",
        description="'luminance', 'brightness' or 'alpha'",
        examples=["luminance"],
    )
    time: Choice = Field(
        None,
        title="Which time to read where a file has several; 'all': each is a step of a series.",
        description="the index (from 0) of a time, or 'all'",
        examples=[0],
    )
    step: Choice = Field(
        None,
        title="Which step of a series pictures show; by default that of the time of each frame.",
        description="the number (from 0) of a step, or the name of its file",
        examples=[0],
    )
    steps_per_second: Annotated[Number, Field(gt=0, le=1e6)] | None = Field(
        None,
        title="Steps of a series that pass in a second of animation; by default they are spread over the frames.",
        description="a number greater than 0",
        examples=[25.0],
    )
    loop: bool = Field(
        False,
        title="After the last step of a series, whether the first one follows; otherwise the last one stays.",
        description="true or false",
    )
    value_range: Annotated[Any, BeforeValidator(_value_range), _RANGE_SCHEMA] | None = Field(
        None,
        title="Lowest and highest value of a series over all times, instead of reading every step to find them.",
        description="two numbers [lowest, highest]",
        examples=[[0.0, 255.0]],
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
        if isinstance(self.file, tuple) and self.time == ALL_TIMES:
            raise wrong("time", self.time, "the index of one time in each of several files")
        if self.color is not None and self.channel is not None:
            raise wrong("color", self.color, "either channel or color, not both")
        if self.field is None and self.size is not None:
            raise wrong("size", self.size, "a size beside field alone; for a .raw file, dims")
        if abs(self.slope) < 1e-30:
            raise wrong("slope", self.slope, "a finite number that is not 0")
        for key in _OF_FILES:
            value = getattr(self, key)
            if self.field is not None and value is not None:
                raise wrong(key, value, f"no {key} beside field; it has its size, and 8 bits")
        return self

    @classmethod
    def table_name(cls) -> str:
        return "volume"
