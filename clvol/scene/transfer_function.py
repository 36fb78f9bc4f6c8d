"""[transfer_function]: control points, a preset, a colour map or a file of another tool."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from clvol.errors import ClvolWarning, SceneError
from clvol.scene.preset_file import expected_preset, is_known
from clvol.scene.table import COLOR, AsTuple, Color, Fraction, Length, Number, Table, plain, wrong
from clvol.scene.volume import is_path, path_text
from clvol.transfer import TransferFunction, preset
from clvol.transfer.color_names import in_linear_light
from clvol.transfer.exchange import Imported, load_colormap, load_imported
from clvol.transfer.exchange.files import KNOWN

LARGEST_POINTS = 65536


def _opacity_item(value: Any) -> float | tuple[float, float]:
    """An opacity, or a pair of position and opacity; their curve is checked where it is used."""
    items = [plain(item) for item in (value if isinstance(value, (list, tuple)) else [value])]
    good = all(isinstance(item, (int, float)) and not isinstance(item, bool) and 0 <= item <= 1 for item in items)
    if not good or len(items) > 2 or (len(items) == 1 and isinstance(value, (list, tuple))):
        raise ValueError("neither an opacity nor a pair")
    return float(items[0]) if len(items) == 1 else (float(items[0]), float(items[1]))


def _brief(value: Any) -> Any:
    """A value as an error message shows it; of a list, its length."""
    return len(value) if isinstance(value, tuple) else value


class ControlPoint(Table):
    """Opacity and colour at one value; both are linear between points."""

    value: Number = Field(title="Value of the volume.", description="a finite number", examples=[0.0])
    opacity: Fraction = Field(
        title="Opacity over one opacity_unit of length.",
        description="a number from 0 to 1",
        examples=[0.0],
    )
    color: Color = Field(
        title="Colour, not multiplied by the opacity, in color_space.",
        description=COLOR,
        examples=[[0.0, 0.0, 0.0]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "point"


def check_points(points: tuple[ControlPoint, ...]) -> None:
    """Raises the error of a model's validator if ``points`` are none, too many, or not in order."""
    if not 1 <= len(points) <= LARGEST_POINTS:
        raise wrong("points", len(points) or [], f"from 1 to {LARGEST_POINTS} points")
    values = [point.value for point in points]
    for i in range(1, len(values)):
        if values[i] < values[i - 1]:
            expected = f"ascending values, here {values[i - 1]} or more"
            raise wrong(f"points.{i}.value", values[i], expected)
        if i > 1 and values[i] == values[i - 2]:
            raise wrong(f"points.{i}.value", values[i], "at most two points at one value")


_POSITION = "opacities from 0 to 1, evenly spaced over the range, or pairs [position from 0 to 1, opacity]"


class TransferFunctionSettings(Table):
    """Either ``points``, a ``preset``, a ``colormap`` or a ``file``; with none, a grey ramp over the volume's range.

    A preset that is a file (``clvol/scene/preset_file.py``) also brings filter, step, material and lights, where the
    scene states none, and is placed on the volume: ``Scene.completed``.

    A ``colormap`` of matplotlib, colorcet or cmap is laid over ``range``, by default that of the volume. A ``file`` of
    ParaView, 3D Slicer, ITK-SNAP or VisIt keeps its values unless ``range`` moves them; ``entry`` selects one of
    several presets. ``opacity`` is their opacity curve: it takes the place of the file's, and by default rises from 0
    to 0.5 where there is none.

    With ``associated`` colours light is independent of opacity (Engel and Ertl 2002, equation 15): a path of
    opacity_unit emits ``emission`` times the colour, of which what absorbs on the way takes its part; a value of
    opacity 0 may emit. No light shades it.

    A ``generator`` makes the function from the voxels (``clvol/choice/generated.py``), in the colours of ``colormap``
    or of a palette: "boundary" shows the middle of boundaries between materials (Kindlmann and Durkin 1998),
    "histogram" what is rare; with "-2d" by value and gradient magnitude. Its opacities refer to a voxel (boundaries) or
    to a 32nd of the shortest edge.

    ``opacity_unit`` is the world length that opacities refer to. It defaults to 1 for points, to that of the file where
    it states one, and otherwise to a 32nd of the volume's shortest edge. ``color_space`` is the colour space of the
    points' colours and of the image's background.
    """

    opacity_unit: Length | None = Field(
        None,
        title="World length that opacities refer to; by default 1 for points, else 1/32 of the shortest volume edge.",
        description="a finite world length greater than 0",
        examples=[1.0],
    )
    color_space: Literal["srgb", "linear"] = Field(
        "srgb",
        title="Colour space of the colours of points and of the background.",
        description="'srgb' or 'linear'",
    )
    associated: bool = Field(
        False,
        title="Colours are the light that an opacity_unit emits, whatever its opacity: glow and flames.",
        description="true or false",
    )
    emission: Number = Field(
        1.0, ge=0, le=1e6,
        title="Factor on the light of associated colours; above 1 it exceeds white.",
        description="a number from 0 to 1e6",
    )
    points: Annotated[tuple[ControlPoint, ...], AsTuple] | None = Field(
        None,
        title="Control points, values ascending; two points at one value make a step.",
        description="a list of points { value = …, opacity = …, color = [r, g, b] }",
        examples=[[
            {"value": 0, "opacity": 0, "color": [0, 0, 0]},
            {"value": 80.0, "opacity": 0.2, "color": [0.9, 0.6, 0.3]},
        ]],
    )
    preset: str | None = Field(
        None,
        title="Preset instead of points: 'grayscale', 'hot', 'ct-bone', 'mr-brain' and others, or a preset file.",
        description="the name of a preset or of a preset file (*.toml), in quotes",
        examples=["ct-bone"],
    )
    colormap: str | None = Field(
        None, min_length=1,
        title="Colour map instead of points, of matplotlib, colorcet or cmap.",
        description="the name of a colour map, such as 'viridis' or 'colorcet:fire'",
        examples=["viridis"],
    )
    file: Annotated[str, BeforeValidator(path_text), AfterValidator(is_path)] | None = Field(
        None, min_length=1,
        title="Transfer function of ParaView, 3D Slicer, ITK-SNAP or VisIt instead of points.",
        description="the name of a file: " + KNOWN,
        examples=["preset.json"],
    )
    generator: Literal["histogram", "histogram-2d", "boundary", "boundary-2d"] | None = Field(
        None,
        title="Function made from the data: what is rare, or boundaries; -2d: by gradient magnitude, too.",
        description="'histogram', 'histogram-2d', 'boundary' or 'boundary-2d'",
        examples=["boundary"],
    )
    strength: Fraction = Field(
        0.5,
        title="Largest opacity of a generated function.",
        description="a number from 0 to 1",
    )
    thickness: Number = Field(
        1.0, gt=0, le=1e3,
        title="How far from the middle of a boundary a generated function shows it, in voxels.",
        description="a number greater than 0, at most 1000",
    )
    entry: str | None = Field(
        None,
        title="Which preset of a ParaView file that has several.",
        description="the name of a preset in the file",
        examples=["Cool to Warm"],
    )
    range: Annotated[tuple[Number, Number], AsTuple] | None = Field(
        None,
        title="Values that the ends move to; by default the volume's range for colour maps, the file's own for files.",
        description="two finite numbers [low, high], ascending",
        examples=[[0.0, 255.0]],
    )
    opacity: Annotated[tuple[Annotated[Any, BeforeValidator(_opacity_item)], ...], AsTuple] | None = Field(
        None, min_length=1, max_length=LARGEST_POINTS,
        title="Opacity curve over the range, beside a colour map or a file; by default from 0 to 0.5, or the file's.",
        description=_POSITION,
        examples=[[0.0, 0.05, 0.3]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "transfer_function"

    @model_validator(mode="after")
    def _one_function(self) -> TransferFunctionSettings:
        given = [key for key in ("points", "preset", "colormap", "file") if getattr(self, key) is not None]
        if len(given) > 1:
            first, second = given[:2]
            raise wrong(second, _brief(getattr(self, second)), f"either {first} or {second}, not both")
        given += ["generator"] if self.generator is not None and given != ["colormap"] else []
        if len(given) > 1:
            raise wrong("generator", self.generator, f"either {given[0]} or generator, not both")
        for key in ("strength", "thickness"):
            if key in self.model_fields_set and self.generator is None:
                raise wrong(key, getattr(self, key), f"no {key} without a generator")
        for key, owners in (("entry", ("file",)), ("range", ("colormap", "file")), ("opacity", ("colormap", "file"))):
            value = getattr(self, key)
            if value is not None and not set(owners) & set(given):
                raise wrong(key, _brief(value), f"{key} beside {' or '.join(owners)}")
        if "emission" in self.model_fields_set and not self.associated:
            raise wrong("emission", self.emission, "no emission without associated = true")
        if self.preset is not None and not is_known(self.preset):
            raise wrong("preset", self.preset, expected_preset(self.preset))
        if self.range is not None and not self.range[0] < self.range[1]:
            raise wrong("range", list(self.range), "two finite numbers [low, high], ascending")
        if self.points is not None:
            check_points(self.points)
        return self

    def function(
        self, value_range: tuple[float, float], default_unit: float, folder: Path = Path(), origin: str = "scene"
    ) -> TransferFunction:
        """The function in linear light, for a volume whose finite values span ``value_range``.

        ``default_unit`` is the opacity unit where neither the scene nor its file states one; ``folder`` is what a file
        is relative to; ``origin`` begins error messages. Raises SceneError; warns of what a file says in vain.
        """
        if self.points is not None:
            colors = [point.color for point in self.points]
            return TransferFunction(
                [point.value for point in self.points],
                [point.opacity for point in self.points],
                in_linear_light(colors, self.color_space == "linear"),
                1.0 if self.opacity_unit is None else self.opacity_unit,
            )
        unit = default_unit if self.opacity_unit is None else self.opacity_unit
        if self.colormap is None and self.file is None:
            return preset(self.preset or "grayscale", value_range, unit)
        imported = self._imported(folder, origin)
        wanted = self.range
        if wanted is None and imported.is_relative:
            low, high = value_range
            wanted = (low, high) if low < high else (low - 0.5, low + 0.5)
        return TransferFunction(*imported.points(wanted, self.opacity, unit))

    def _imported(self, folder: Path, origin: str) -> Imported:
        where = f"{origin}: transfer_function"
        if self.file is None:
            return load_colormap(self.colormap, f"{where}.colormap")
        path = folder / self.file
        if not os.path.exists(path):
            raise SceneError(f"{where}.file", f"got {self.file!r}, no such file", KNOWN)
        found = load_imported(path, self.entry)
        for note in found.notes:
            warnings.warn(ClvolWarning(str(path), note), stacklevel=2)
        return found if self.opacity_unit is None else replace(found, opacity_unit=self.opacity_unit)
