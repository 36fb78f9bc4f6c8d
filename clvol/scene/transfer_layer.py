"""[[transfer_layer]]: the transfer function at a gradient magnitude above 0."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from clvol.errors import SceneError
from clvol.scene.table import AsTuple, Number, Table, wrong
from clvol.scene.transfer_function import ControlPoint, check_points
from clvol.transfer import TransferFunction

LARGEST_LAYERS = 64


@dataclass(frozen=True)
class TransferLayer:
    """The transfer function at the gradient magnitude ``magnitude`` (value per world length), or at the ``values`` of
    the fields of role "value".

    ``function`` has the opacity unit of the scene's transfer function.
    """

    magnitude: float
    function: TransferFunction
    values: tuple[float, ...] = ()


def axes_of_layers(bases: Sequence[float], values: Sequence[tuple[float, ...]]) -> list[list[float]]:
    """For each field the values at which functions stand, ascending: ``bases``, where [transfer_function] does, and
    those of the layers."""
    return [sorted({base, *(each[k] for each in values)}) for k, base in enumerate(bases)]


def in_rows(layers: Sequence[TransferLayer], bases: Sequence[float], where: str) -> tuple[TransferLayer, ...]:
    """The layers of a joint function in the order of its grid, the first field's values fastest, without the point of
    ``bases``. SceneError, beginning with ``where``, where the layers are not those of a grid."""
    axes = axes_of_layers(bases, [layer.values for layer in layers])
    wanted = [tuple(point[::-1]) for point in product(*axes[::-1])][1:]
    known = {layer.values: layer for layer in layers}
    if any(axis[0] < base for axis, base in zip(axes, bases)):
        stated = ", ".join(f"{base:g}" for base in bases)
        raise SceneError(where, "a layer below [transfer_function]", f"values of at least {stated} (base of the field)")
    if len(known) < len(layers) or tuple(bases) in known:
        raise SceneError(where, "two functions for the same values", "one function for each")
    missing = next((point for point in wanted if point not in known), None)
    if missing is not None:
        raise SceneError(where, f"no layer at values = {list(missing)}", "one for each pair of the fields' values")
    return tuple(known[point] for point in wanted)


class TransferLayerSettings(Table):
    """One layer of a transfer function of value and gradient magnitude.

    [transfer_function] is the layer at magnitude 0. Extinction and emission are linear between layers; the last layer
    holds above its magnitude. Opacities refer to the opacity_unit of [transfer_function], colours to its color_space.

    With ``values`` it is a layer of a joint function of the volume and one or two fields of role "value", in their
    order: [transfer_function] holds where each field has its ``base``, and there is a layer for every combination of
    the values that layers name. Emission and extinction are linear between them; beyond them the outermost hold.
    """

    magnitude: Number | None = Field(
        None, gt=0,
        title="Gradient magnitude at which this function holds, in value per world length; linear between layers.",
        description="a finite number greater than 0",
        examples=[50.0],
    )
    values: Annotated[tuple[Number, ...], AsTuple] | None = Field(
        None, min_length=1, max_length=2,
        title="Values of the fields of role 'value' at which this function holds, in place of a magnitude.",
        description="a list of one or two finite numbers, one for each field of role 'value'",
        examples=[[80.0]],
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
        if (self.magnitude is None) == (self.values is None):
            raise wrong("magnitude", self.magnitude, "either a magnitude or values")
        check_points(self.points)
        return self

    def layer(
        self, opacity_unit: float, decoded: Callable[[ArrayLike], np.ndarray]
    ) -> TransferLayer:
        """``decoded`` converts colours to linear light."""
        function = function_of(self.points, opacity_unit, decoded)
        return TransferLayer(self.magnitude or 0.0, function, self.values or ())


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
