"""[[field]]: a second volume that labels, adds to, or cuts the first."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, WrapValidator, model_validator

from clvol.errors import SceneError, VolumeError
from clvol.readers import load_volume
from clvol.scene.table import AsTuple, Color, Fraction, Number, Table, Whole, wrong
from clvol.scene.transfer_function import ControlPoint, check_points
from clvol.scene.transfer_layer import function_of
from clvol.scene.volume import Choice, is_path, path_text
from clvol.transfer import TransferFunction
from clvol.volume.axis import ValueAxis
from clvol.volume.volume import Volume

LARGEST_COUNT = 3
LARGEST_LABELS = 65536
_LARGEST_LABEL = 2**53 - 1  # of 64-bit labels, beyond it none is kept apart
_READ_BY = {"label": "labels", "density": "points", "mask": None}
_NEEDED = {
    "labels": "a list of labels { label = …, color = [r, g, b] } for a field of role 'label'",
    "points": "a list of points { value = …, opacity = …, color = [r, g, b] } for role 'density'",
}


@dataclass(frozen=True, eq=False)
class ResolvedField:
    """A field with its volume; what its role does not read is None.

    "label": ``labels`` int64 [n], ascending, none twice, ``colors`` float64 [n, 3] in linear light,
    ``factors`` float64 [n] in [0, 1] on the extinction. "density": ``function``. "mask":
    ``threshold``, and ``keep``, "above" or "below" it. All in what ``volume`` holds; ``axis`` leads
    from there to the values of the volume asked for.
    """

    volume: Volume
    role: Literal["label", "density", "mask"]
    labels: np.ndarray | None = None
    colors: np.ndarray | None = None
    factors: np.ndarray | None = None
    function: TransferFunction | None = None
    threshold: float | None = None
    keep: Literal["above", "below"] | None = None
    axis: ValueAxis = ValueAxis()


class FieldLabel(Table):
    """``opacity`` is a factor on the volume's own extinction."""

    label: Whole = Field(
        ge=-_LARGEST_LABEL, le=_LARGEST_LABEL,
        title="Value of the voxels with this label.",
        description="a whole number of at most 53 bits",
        examples=[3],
    )
    color: Color = Field(
        title="Colour of the label, in the colour space of the transfer function.",
        description="three numbers [r, g, b] from 0 to 1",
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
    """``file`` is relative to the scene file; from Python it may be a ``clvol.Volume``. ``channel``,
    ``time`` and ``series`` choose where it has several, as in [volume].

    A field has its own grid and is looked up by world position: a label from the nearest voxel,
    density and mask linearly between voxels. Outside the grid is no label and no density, and
    nothing of a masked volume. "label": each of ``labels`` has its own colour; others keep the
    volume's. "density": ``points``, per the transfer function's opacity_unit, add to the volume's
    extinction and emission. "mask": only what is ``keep`` the ``threshold`` is there.
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
    role: Literal["label", "density", "mask"] = Field(
        title="What the field does: colour by label, add a second medium, or mask the volume.",
        description="'label', 'density' or 'mask'",
        examples=["label"],
    )
    labels: Annotated[tuple[FieldLabel, ...], AsTuple] | None = Field(
        None,
        title="Colours and opacities by label, for the role 'label'; other labels keep the look of the volume.",
        description="a list of labels { label = …, color = [r, g, b] }",
        examples=[[{"label": 3, "color": [0.9, 0.3, 0.2], "opacity": 1.0}]],
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

    @classmethod
    def table_name(cls) -> str:
        return "field"

    @model_validator(mode="after")
    def _has_what_its_role_reads(self) -> FieldSettings:
        needed = _READ_BY[self.role]
        for key in ("labels", "points"):
            value = getattr(self, key)
            if key == needed and value is None:
                raise wrong(key, None, _NEEDED[key])
            if key != needed and value is not None:
                raise wrong(key, len(value) or [], f"no {key} for a field of role {self.role!r}")
        for key in ("threshold", "keep"):
            if self.role != "mask" and key in self.model_fields_set:
                got = getattr(self, key)
                raise wrong(key, got, f"no {key} for a field of role {self.role!r}")
        if self.points is not None:
            check_points(self.points)
        if self.labels is not None:
            self._check_labels()
        return self

    def _check_labels(self) -> None:
        if not 1 <= len(self.labels) <= LARGEST_LABELS:
            raise wrong("labels", len(self.labels) or [], f"from 1 to {LARGEST_LABELS} labels")
        seen = set()
        for i, label in enumerate(self.labels):
            if label.label in seen:
                raise wrong(f"labels.{i}.label", label.label, "each label once")
            seen.add(label.label)

    def load(
        self, folder: Path, where: str, memory_cap: int | None, labels: bool = False
    ) -> Volume:
        """The field's volume; ``folder`` is what its file is relative to, ``where`` the place of
        this table for error messages, ``labels`` whether nothing but labels are read from the file.
        Raises SceneError if it is not there, VolumeError."""
        if isinstance(self.file, Volume):
            return self.file
        path = folder / self.file
        if not os.path.exists(path):
            got = f"got {self.file!r}, no such file"
            raise SceneError(f"{where}.file", got, "a volume file or a DICOM folder")
        try:
            return load_volume(path, labels=labels, memory_cap=memory_cap, **self.choices)
        except VolumeError as error:  # readers know of no other table
            table = where.rpartition(": ")[2]
            what, expected = (
                text and re.sub(r"\bvolume\.(channel|time|series)\b", rf"{table}.\1", text)
                for text in (error.what, error.expected)
            )
            raise VolumeError(error.where, what, expected) from error.__cause__

    @property
    def choices(self) -> dict[str, int | str | None]:
        """Which of several channels, times or series; None where nothing is said."""
        return {"channel": self.channel, "time": self.time, "series": self.series}

    def resolved(
        self, volume: Volume, opacity_unit: float, decoded: Callable[[object], np.ndarray]
    ) -> ResolvedField:
        """``decoded`` takes colours to linear light."""
        if self.role == "mask":
            return ResolvedField(volume, "mask", threshold=self.threshold, keep=self.keep)
        if self.role == "density":
            function = function_of(self.points, opacity_unit, decoded)
            return ResolvedField(volume, "density", function=function)
        ordered = sorted(self.labels, key=lambda label: label.label)
        labels = np.array([label.label for label in ordered], np.int64)
        colors = decoded([label.color for label in ordered])
        factors = np.array([label.opacity for label in ordered], np.float64)
        for array in (labels, colors, factors):
            array.setflags(write=False)
        return ResolvedField(volume, "label", labels=labels, colors=colors, factors=factors)
