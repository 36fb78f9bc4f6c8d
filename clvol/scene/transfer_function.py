"""[transfer_function]: control points or a preset."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from clvol.scene.preset_file import expected_preset, is_known
from clvol.scene.table import AsTuple, Color, Fraction, Length, Number, Table, wrong
from clvol.transfer import TransferFunction, preset, srgb_to_linear

LARGEST_POINTS = 65536


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
        description="three numbers [r, g, b] from 0 to 1",
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


class TransferFunctionSettings(Table):
    """Either ``points`` or a ``preset``; with neither, a grey ramp over the volume's range.

    A preset that is a file (``clvol/scene/preset_file.py``) also brings filter, step, material and lights, where the
    scene states none, and is placed on the volume: ``Scene.completed``.

    ``opacity_unit`` is the world length that opacities refer to. It defaults to 1 for points, and to a 32nd of the
    volume's shortest edge for presets and for the grey ramp. ``color_space`` is the colour space of the points'
    colours and of the image's background.
    """

    opacity_unit: Length | None = Field(
        None,
        title="World length that opacities refer to; by default 1, for presets 1/32 of the shortest volume edge.",
        description="a finite world length greater than 0",
        examples=[1.0],
    )
    color_space: Literal["srgb", "linear"] = Field(
        "srgb",
        title="Colour space of the colours of points and of the background.",
        description="'srgb' or 'linear'",
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

    @classmethod
    def table_name(cls) -> str:
        return "transfer_function"

    @model_validator(mode="after")
    def _one_function(self) -> TransferFunctionSettings:
        if self.preset is not None and self.points is not None:
            raise wrong("preset", self.preset, "either points or a preset, not both")
        if self.preset is not None and not is_known(self.preset):
            raise wrong("preset", self.preset, expected_preset(self.preset))
        if self.points is None:
            return self
        check_points(self.points)
        return self

    def function(
        self, value_range: tuple[float, float], default_unit: float
    ) -> TransferFunction:
        """The function in linear light, for a volume whose finite values span ``value_range``.

        ``default_unit`` is the opacity unit of presets and of the grey ramp where the scene states none.
        """
        if self.points is None:
            unit = default_unit if self.opacity_unit is None else self.opacity_unit
            return preset(self.preset or "grayscale", value_range, unit)
        colors = [point.color for point in self.points]
        return TransferFunction(
            [point.value for point in self.points],
            [point.opacity for point in self.points],
            srgb_to_linear(colors) if self.color_space == "srgb" else colors,
            1.0 if self.opacity_unit is None else self.opacity_unit,
        )
