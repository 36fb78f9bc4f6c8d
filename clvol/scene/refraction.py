"""[refraction]: an index of refraction by value, by whose gradient rays bend everywhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from clvol.scene.table import AsTuple, Number, Table, wrong
from clvol.transfer import TransferFunction

LARGEST_POINTS = 4096


@dataclass(frozen=True, eq=False)
class RefractiveIndex:
    """An index of refraction that is linear between points, and constant beyond the first and the last: ``values``
    float64 [n], strictly ascending; ``indices`` float64 [n]."""

    values: np.ndarray
    indices: np.ndarray

    def __call__(self, values: ArrayLike) -> np.ndarray:
        """The index for each of ``values`` (any shape); that of the first point for NaN."""
        values = np.asarray(values, np.float64)
        return np.interp(np.where(np.isnan(values), -np.inf, values), self.values, self.indices)

    def slope(self, values: ArrayLike) -> np.ndarray:
        """Its derivative by the value; at a point that of what follows, 0 beyond the ends and for NaN."""
        values = np.asarray(values, np.float64)
        if len(self.values) < 2:
            return np.zeros(values.shape)
        slopes = np.concatenate([[0.0], np.diff(self.indices) / np.diff(self.values), [0.0]])
        piece = np.searchsorted(self.values, np.where(np.isnan(values), -np.inf, values), side="right")
        return np.asarray(slopes[piece])

    @property
    def shape(self) -> TransferFunction | None:
        """A function with opacity exactly where the index changes: there rays cannot leap. None for a constant."""
        changes = np.flatnonzero(np.diff(self.indices))
        if not changes.size:
            return None
        values = np.stack([self.values[changes], self.values[changes], self.values[changes + 1],
                           self.values[changes + 1]], axis=1).ravel()  # fmt: skip
        opacities = np.tile([0.0, 0.5, 0.5, 0.0], changes.size)
        joined = np.flatnonzero(np.diff(changes) == 1)  # between pieces that follow each other there is no gap
        dropped = np.concatenate([4 * joined + 3, 4 * joined + 4])
        keep = np.setdiff1d(np.arange(len(values)), dropped)
        keep = np.setdiff1d(keep, 4 * joined + 5)
        return TransferFunction(values[keep], opacities[keep], np.zeros((keep.size, 3)))


class RefractionPoint(Table):
    """An index of refraction at one value."""

    value: Number = Field(title="Value of the volume.", description="a finite number", examples=[0.0])
    index: Number = Field(
        ge=0.1, le=10, title="Index of refraction there.", description="an index from 0.1 to 10", examples=[1.0]
    )

    @classmethod
    def table_name(cls) -> str:
        return "point"


class Refraction(Table):
    """An index of refraction by value, linear between ``points``. Rays of the eye bend by its gradient along their way,
    a little at each step; light that casts shadows goes straight."""

    points: Annotated[tuple[RefractionPoint, ...], AsTuple] = Field(
        title="Index of refraction by value, linear between points, by whose gradient rays bend.",
        description="a list of points { value = …, index = … }, values strictly ascending",
        examples=[[{"value": 0.0, "index": 1.0}, {"value": 255.0, "index": 1.3}]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "refraction"

    @model_validator(mode="after")
    def _ascending(self) -> Refraction:
        if not 1 <= len(self.points) <= LARGEST_POINTS:
            raise wrong("points", len(self.points) or [], f"from 1 to {LARGEST_POINTS} points")
        for i in range(1, len(self.points)):
            before, value = self.points[i - 1].value, self.points[i].value
            if not value > before:
                raise wrong(f"points.{i}.value", value, f"more than {before}: values ascend")
        return self

    def resolved(self) -> RefractiveIndex:
        arrays = np.array([(point.value, point.index) for point in self.points], np.float64).T.copy()
        arrays.setflags(write=False)
        return RefractiveIndex(arrays[0], arrays[1])
