"""[[transfer_layer]]: the transfer function at a gradient magnitude above 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from clvol.scene.table import AsTuple, Number, Table
from clvol.scene.transfer_function import ControlPoint, check_points
from clvol.transfer import TransferFunction

LARGEST_LAYERS = 64


@dataclass(frozen=True)
class TransferLayer:
    """The transfer function at the gradient magnitude ``magnitude`` (value per world length).

    ``function`` has the opacity unit of the scene's transfer function.
    """

    magnitude: float
    function: TransferFunction


class TransferLayerSettings(Table):
    """One layer of a transfer function of value and gradient magnitude.

    [transfer_function] is the layer at magnitude 0. Extinction and emission are linear between layers; the last layer
    holds above its magnitude. Opacities refer to the opacity_unit of [transfer_function], colours to its color_space.
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
        self, opacity_unit: float, decoded: Callable[[ArrayLike], np.ndarray]
    ) -> TransferLayer:
        """``decoded`` converts colours to linear light."""
        return TransferLayer(self.magnitude, function_of(self.points, opacity_unit, decoded))


def function_of(
    points: tuple[ControlPoint, ...],
    opacity_unit: float,
    decoded: Callable[[ArrayLike], np.ndarray],
) -> TransferFunction:
    """The function through control points. ``decoded`` converts their colours to linear light."""
    return TransferFunction(
        [point.value for point in points],
        [point.opacity for point in points],
        decoded([point.color for point in points]),
        opacity_unit,
    )
