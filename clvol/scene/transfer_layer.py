"""[[transfer_layer]]: the transfer function at a gradient magnitude above 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from clvol.scene.table import AsTuple, Number, Table
from clvol.scene.transfer_function import ControlPoint, check_points
from clvol.transfer import TransferFunction

LARGEST_LAYERS = 64


@dataclass(frozen=True)
class TransferLayer:
    """``function``, with the transfer function's opacity unit, holds at gradients of ``magnitude``
    (value per world length)."""

    magnitude: float
    function: TransferFunction


class TransferLayerSettings(Table):
    """Together with [transfer_function], which is that at magnitude 0, these make a function of
    value and gradient magnitude: extinction and emission are linear between layers; the last one
    holds above it. Opacities are per the transfer function's opacity_unit, colours in its
    color_space.
    """

    magnitude: Number = Field(
        gt=0,
        title="Gradient magnitude at which this function holds, in value per world length; linear between layers.",
        description="a finite number greater than 0",
        examples=[50.0],
    )
    points: Annotated[tuple[ControlPoint, ...], AsTuple] = Field(
        title="Control points as in [transfer_function].",
        description="a list of points { value = …, opacity = …, color = [r, g, b] }",
        examples=[[
            {"value": 0, "opacity": 0, "color": [0, 0, 0]},
            {"value": 200.0, "opacity": 0.5, "color": [1.0, 0.8, 0.6]},
        ]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "transfer_layer"

    @model_validator(mode="after")
    def _ascending(self) -> TransferLayerSettings:
        check_points(self.points)
        return self

    def layer(
        self, opacity_unit: float, decoded: Callable[[object], np.ndarray]
    ) -> TransferLayer:
        """``decoded`` takes colours to linear light."""
        return TransferLayer(self.magnitude, function_of(self.points, opacity_unit, decoded))


def function_of(
    points: tuple[ControlPoint, ...],
    opacity_unit: float,
    decoded: Callable[[object], np.ndarray],
) -> TransferFunction:
    """The function of control points; ``decoded`` takes their colours to linear light."""
    return TransferFunction(
        [point.value for point in points],
        [point.opacity for point in points],
        decoded([point.color for point in points]),
        opacity_unit,
    )
