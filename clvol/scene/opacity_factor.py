"""[gradient_opacity] and [directional_opacity]: factors on the extinction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from clvol.scene.table import AsTuple, Fraction, Number, Table, wrong

LARGEST_POINTS = 4096
_POINTS = "a list of points {{ {} = …, opacity = … }}"


@dataclass(frozen=True, eq=False)
class OpacityFactor:
    """A factor in [0, 1] that is linear between points, and constant beyond the first and the last.

    ``at``: float64 [n], ascending, >= 0; where two points coincide, the later one holds. ``factors``: float64 [n].
    """

    at: np.ndarray
    factors: np.ndarray

    def __call__(self, x: ArrayLike) -> np.ndarray:
        """The factor for each of ``x`` (any shape); 1 for NaN."""
        x = np.asarray(x, np.float64)
        last = self.at.size - 1
        right = np.searchsorted(self.at, x, side="right")
        low = np.clip(right - 1, 0, last)
        high = np.minimum(right, last)
        span = self.at[high] - self.at[low]
        with np.errstate(invalid="ignore"):
            t = np.where(span > 0, (x - self.at[low]) / np.where(span > 0, span, 1.0), 0.0)
        t = np.clip(t, 0.0, 1.0)
        return np.where(np.isnan(x), 1.0, (1.0 - t) * self.factors[low] + t * self.factors[high])


class GradientOpacityPoint(Table):
    """A factor on the extinction at one gradient magnitude."""

    magnitude: Number = Field(
        ge=0,
        title="Gradient magnitude, in value per world length.",
        description="a finite number, 0 or greater",
        examples=[0.0],
    )
    opacity: Fraction = Field(
        title="Factor on the extinction there.",
        description="a number from 0 to 1",
        examples=[0.0],
    )

    @classmethod
    def table_name(cls) -> str:
        return "point"


class DirectionalOpacityPoint(Table):
    """A factor on the extinction at one size of the derivative along the ray."""

    derivative: Number = Field(
        ge=0,
        title="Size of the derivative along the ray, in value per world length.",
        description="a finite number, 0 or greater",
        examples=[0.0],
    )
    opacity: Fraction = Field(
        title="Factor on the extinction there.",
        description="a number from 0 to 1",
        examples=[0.0],
    )

    @classmethod
    def table_name(cls) -> str:
        return "point"


class GradientOpacity(Table):
    """A factor by the gradient's magnitude, in value per world length."""

    points: Annotated[tuple[GradientOpacityPoint, ...], AsTuple] = Field(
        title="Factor on the extinction by gradient magnitude, linear between points.",
        description=_POINTS.format("magnitude"),
        examples=[[{"magnitude": 0.0, "opacity": 0.0}, {"magnitude": 40.0, "opacity": 1.0}]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "gradient_opacity"

    @model_validator(mode="after")
    def _ascending(self) -> GradientOpacity:
        _check_ascending("magnitude", [point.magnitude for point in self.points])
        return self

    def factor(self) -> OpacityFactor:
        return _factor([(point.magnitude, point.opacity) for point in self.points])


class DirectionalOpacity(Table):
    """A factor by the size of the value's derivative along the ray, in value per world length."""

    points: Annotated[tuple[DirectionalOpacityPoint, ...], AsTuple] = Field(
        title="Factor on the extinction by the derivative along the ray, linear between points.",
        description=_POINTS.format("derivative"),
        examples=[[{"derivative": 0.0, "opacity": 0.0}, {"derivative": 40.0, "opacity": 1.0}]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "directional_opacity"

    @model_validator(mode="after")
    def _ascending(self) -> DirectionalOpacity:
        _check_ascending("derivative", [point.derivative for point in self.points])
        return self

    def factor(self) -> OpacityFactor:
        return _factor([(point.derivative, point.opacity) for point in self.points])


def _check_ascending(key: str, places: list[float]) -> None:
    if not 1 <= len(places) <= LARGEST_POINTS:
        raise wrong("points", len(places) or [], f"from 1 to {LARGEST_POINTS} points")
    for i in range(1, len(places)):
        if places[i] < places[i - 1]:
            raise wrong(f"points.{i}.{key}", places[i], f"ascending, here {places[i - 1]} or more")
        if i > 1 and places[i] == places[i - 2]:
            raise wrong(f"points.{i}.{key}", places[i], "at most two points at one place")


def _factor(points: list[tuple[float, float]]) -> OpacityFactor:
    arrays = np.array(points, np.float64).T.copy()
    arrays.setflags(write=False)
    return OpacityFactor(arrays[0], arrays[1])
