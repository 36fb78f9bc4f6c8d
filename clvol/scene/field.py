"""[[field]]: a second volume that colours, adds to, or masks the first."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BeforeValidator, Field, WrapValidator, model_validator

from clvol.errors import SceneError, VolumeError
from clvol.readers import is_url, load_volume
from clvol.readers.colored import load_colored
from clvol.scene.table import COLOR, AsTuple, Color, Fraction, Number, Table, Whole, wrong
from clvol.scene.transfer_function import ControlPoint, check_points
from clvol.scene.transfer_layer import function_of
from clvol.scene.volume import Choice, is_path, path_text
from clvol.transfer import TransferFunction, srgb_to_linear
from clvol.transfer.exchange.files import load_labels
from clvol.volume.axis import ValueAxis
from clvol.volume.colored import Colors
from clvol.volume.volume import Volume

LARGEST_COUNT = 3
LARGEST_LABELS = 65536
_LARGEST_LABEL = 2**53 - 1  # float64 does not distinguish larger labels
_READ_BY = {"label": "labels", "density": "points", "mask": None, "color": None, "value": None}
_NEEDED = {
    "labels": "a list of labels { label = …, color = [r, g, b] }, or labels_file, for a field of role 'label'",
    "points": "a list of points { value = …, opacity = …, color = [r, g, b] } for role 'density'",
}


_INVISIBLE = TransferFunction([0.0], [0.0], [[0.0, 0.0, 0.0]])


class Choices(TypedDict):
    """The channel, time and series to read from a file that has several; None where nothing is chosen."""

    channel: int | str | None
    time: int | str | None
    series: int | str | None


@dataclass(frozen=True, eq=False)
class ResolvedField:
    """A field with its volume. Attributes that its role does not read keep their defaults.

    The role "label" reads ``labels`` (int64 [n], ascending, distinct), ``colors`` (float64 [n, 3], linear light) and
    ``factors`` (float64 [n] in [0, 1], on the extinction). "density" reads ``function``, "mask" ``threshold`` and
    ``keep``, "color" ``colors_of_voxels``, "value" ``base``. All numbers are in the stored numbers of ``volume``;
    ``axis`` maps them to the values of the requested volume.
    """

    volume: Volume
    role: Literal["label", "density", "mask", "color", "value"]
    labels: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    colors: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    factors: np.ndarray = field(default_factory=lambda: np.empty(0))
    function: TransferFunction = _INVISIBLE
    threshold: float = 0.5
    keep: Literal["above", "below"] = "above"
    axis: ValueAxis = ValueAxis()
    colors_of_voxels: Colors | None = None
    base: float = 0.0
    labels_path: Path | None = None  # the table that labels come from


class FieldLabel(Table):
    """The look of one label. ``opacity`` is a factor on the extinction of the volume."""

    label: Whole = Field(
        ge=-_LARGEST_LABEL, le=_LARGEST_LABEL,
        title="Value of the voxels with this label.",
        description="a whole number of at most 53 bits",
        examples=[3],
    )
    color: Color = Field(
        title="Colour of the label, in the colour space of the transfer function.",
        description=COLOR,
        examples=[[0.9, 0.3, 0.2]],
    )
    opacity: Fraction = Field(
        1.0,
        title="Factor on the extinction of the volume where the label is.",
        description="a number from 0 to 1",
    )

    @classmethod
    def table_name(cls) -> str:
        return "label"


def _file(value: Any, check: Callable[[Any], Any]) -> Any:
    return value if isinstance(value, Volume) else check(value)


class FieldSettings(Table):
    """A further volume, in the role "label", "density", "mask", "color" or "value".

    ``file`` is relative to the scene file; from Python it may be a ``clvol.Volume``. ``channel``, ``time`` and
    ``series`` select one of several in the file, as in [volume].

    A field has its own grid and is sampled by world position: labels from the nearest voxel, densities and masks
    linearly between voxels. Outside the grid there is no label and no density, and a masked volume is empty. "label":
    each of ``labels`` has its own colour; other labels keep the look of the volume. "density": ``points``, whose
    opacities refer to the opacity_unit of [transfer_function], add to the volume's extinction and emission. "mask":
    the volume is kept where the field is ``keep`` ("above" or "below") the ``threshold``. "color": the colours of its
    voxels (red, green and blue, perhaps alpha) take the place of the transfer function's. "value": a further value of a
    joint transfer function, whose layers are [[transfer_layer]]s with ``values``.
    """

    file: Annotated[
        Annotated[
            str, BeforeValidator(path_text), AfterValidator(is_path), Field(min_length=1)
        ],
        WrapValidator(_file),
    ] = Field(
        title="Volume file, relative to the scene file; from Python also a clvol.Volume.",
        description="the name of a volume file, in quotes",
        examples=["labels.nrrd"],
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
        title="Which series to read where the file or folder has several.",
        description="the index (from 0) or the name of a series",
        examples=[0],
    )
    role: Literal["label", "density", "mask", "color", "value"] = Field(
        title="What the field does: colour by label or by voxel, add a second medium, or mask the volume.",
        description="'label', 'density', 'mask', 'color' or 'value'",
        examples=["label"],
    )
    labels: Annotated[tuple[FieldLabel, ...], AsTuple] | None = Field(
        None,
        title="Colours and opacities by label, for the role 'label'; other labels keep the look of the volume.",
        description="a list of labels { label = …, color = [r, g, b] }",
        examples=[[{"label": 3, "color": [0.9, 0.3, 0.2], "opacity": 1.0}]],
    )
    labels_file: Annotated[str, BeforeValidator(path_text), AfterValidator(is_path)] | None = Field(
        None, min_length=1,
        title="Label table of 3D Slicer or ITK-SNAP in place of labels, relative to the scene file.",
        description="the name of a label table (.ctbl, .txt, .label), in quotes",
        examples=["labels.ctbl"],
    )
    points: Annotated[tuple[ControlPoint, ...], AsTuple] | None = Field(
        None,
        title="Transfer function of the added medium, for the role 'density'.",
        description="a list of points { value = …, opacity = …, color = [r, g, b] }",
        examples=[[
            {"value": 0, "opacity": 0, "color": [0, 0, 0]},
            {"value": 1.0, "opacity": 0.2, "color": [0.3, 0.5, 1.0]},
        ]],
    )
    threshold: Number = Field(
        0.5,
        title="Value at which a mask changes, for the role 'mask'.",
        description="a finite number",
    )
    keep: Literal["above", "below"] = Field(
        "above",
        title="Side of the threshold on which the volume is kept, for the role 'mask'.",
        description="'above' or 'below'",
    )

    base: Number | None = Field(
        None,
        title="Value of the field at which [transfer_function] holds, for the role 'value'; by default its lowest.",
        description="a finite number",
        examples=[0.0],
    )

    @classmethod
    def table_name(cls) -> str:
        return "field"

    @model_validator(mode="after")
    def _has_what_its_role_reads(self) -> FieldSettings:
        needed = _READ_BY[self.role]
        if self.labels_file is not None and (self.role != "label" or self.labels is not None):
            raise wrong("labels_file", self.labels_file, "labels_file in place of labels, for a field of role 'label'")
        for key in ("labels", "points"):
            value = getattr(self, key)
            if key == needed and value is None and self.labels_file is None:
                raise wrong(key, None, _NEEDED[key])
            if key != needed and value is not None:
                raise wrong(key, len(value) or [], f"no {key} for a field of role {self.role!r}")
        for key in ("threshold", "keep"):
            if self.role != "mask" and key in self.model_fields_set:
                got = getattr(self, key)
                raise wrong(key, got, f"no {key} for a field of role {self.role!r}")
        if self.role != "value" and self.base is not None:
            raise wrong("base", self.base, f"no base for a field of role {self.role!r}")
        if self.points is not None:
            check_points(self.points)
        if self.labels is not None:
            _check_labels(self.labels)
        return self

    def load(
        self, folder: Path, where: str, memory_cap: int | None, labels: bool = False
    ) -> Volume:
        """Loads the field's volume.

        Its file is relative to ``folder``; ``where`` names this table in error messages; ``labels``: the file is read
        for labels only. Raises SceneError if the file does not exist, and VolumeError.
        """
        if isinstance(self.file, Volume):
            return self.file
        path: str | Path = self.file if is_url(self.file) else folder / self.file
        if isinstance(path, Path) and not os.path.exists(path):
            got = f"got {self.file!r}, no such file"
            raise SceneError(f"{where}.file", got, "a volume file or a DICOM folder")
        try:
            if self.role == "color":
                return load_colored(path, "luminance", memory_cap=memory_cap, **self.choices)
            return load_volume(path, labels=labels, memory_cap=memory_cap, **self.choices)
        except VolumeError as error:  # readers name the keys of [volume]
            table = where.rpartition(": ")[2]
            what, expected = _with_table(error.what, table), _with_table(error.expected or "", table)
            raise VolumeError(error.where, what, expected or None) from error.__cause__

    @property
    def choices(self) -> Choices:
        return {"channel": self.channel, "time": self.time, "series": self.series}

    def resolved(
        self,
        volume: Volume,
        opacity_unit: float,
        decoded: Callable[[ArrayLike], np.ndarray],
        folder: Path = Path(),
    ) -> ResolvedField:
        """The field with its ``volume``. ``decoded`` converts colours to linear light; a label table is relative to
        ``folder``. Raises SceneError for a label table that cannot be read."""
        if self.role == "mask":
            return ResolvedField(volume, "mask", threshold=self.threshold, keep=self.keep)
        if self.role == "value":
            return ResolvedField(volume, "value", base=volume.value_range[0] if self.base is None else self.base)
        if self.role == "color":
            if volume.colors is None:
                raise SceneError("field", "a volume of one value per voxel for the role 'color'", "colours of voxels")
            return ResolvedField(volume, "color", colors_of_voxels=volume.colors)
        if self.role == "density":
            function = function_of(self.points or (), opacity_unit, decoded)
            return ResolvedField(volume, "density", function=function)
        if self.labels_file is not None:
            found = load_labels(folder / self.labels_file)
            order = np.argsort(found[0])
            labels, factors = np.array(found[0], np.int64)[order], found[2][order]
            colors = srgb_to_linear(found[1][order])
        else:
            ordered = sorted(self.labels or (), key=lambda label: label.label)
            labels = np.array([label.label for label in ordered], np.int64)
            colors = decoded([label.color for label in ordered])
            factors = np.array([label.opacity for label in ordered], np.float64)
        for array in (labels, colors, factors):
            array.setflags(write=False)
        path = None if self.labels_file is None else folder / self.labels_file
        return ResolvedField(volume, "label", labels=labels, colors=colors, factors=factors, labels_path=path)


def _check_labels(labels: tuple[FieldLabel, ...]) -> None:
    if not 1 <= len(labels) <= LARGEST_LABELS:
        raise wrong("labels", len(labels) or [], f"from 1 to {LARGEST_LABELS} labels")
    seen = set()
    for i, label in enumerate(labels):
        if label.label in seen:
            raise wrong(f"labels.{i}.label", label.label, "each label once")
        seen.add(label.label)


def _with_table(text: str, table: str) -> str:
    """``text`` of a reader's message with the keys of ``table`` in place of those of [volume]."""
    return re.sub(r"\bvolume\.(channel|time|series)\b", rf"{table}.\1", text)
