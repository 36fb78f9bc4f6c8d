"""The tables that cl/opacity_factors.h reads: factors on the extinction, and the layers of a function of value
and gradient magnitude."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from clvol.device.memory import value_map
from clvol.features.segments import has_integral_table
from clvol.features.values import reachable
from clvol.features.vocabulary import OPACITY_FACTORS, TRANSFER_LAYERS
from clvol.scene.transfer_layer import axes_of_layers
from clvol.transfer import TransferFunction
from clvol.transfer.integral_table import tabulated_shape
from clvol.transfer.opacity_envelope import opacity_envelope

if TYPE_CHECKING:
    from clvol.scene.opacity_factor import OpacityFactor
    from clvol.scene.resolve import ResolvedScene


def factor_switches(resolved: ResolvedScene) -> dict[str, int]:
    bits = OPACITY_FACTORS["gradient"] * int(resolved.gradient_opacity is not None)
    bits |= OPACITY_FACTORS["directional"] * int(resolved.directional_opacity is not None)
    bits |= OPACITY_FACTORS["fur"] * int(bool(resolved.fur))
    return {"OPACITY_FACTORS": bits, "TRANSFER_LAYERS": _layers_switch(resolved)}


def _layers_switch(resolved: ResolvedScene) -> int:
    if not resolved.transfer_layers:
        return 0
    return TRANSFER_LAYERS[("by-gradient", "of-two", "of-three")[len(resolved.transfer_layers[0].values)]]


def layer_functions(
    resolved: ResolvedScene, function: TransferFunction | None = None
) -> list[TransferFunction]:
    """The transfer functions by gradient magnitude, from 0 on, or those of a joint function, row by row; ``function``
    replaces the scene's first one."""
    first = function or resolved.transfer_function
    return [first, *(layer.function for layer in resolved.transfer_layers)]


def shown_function(resolved: ResolvedScene, function: TransferFunction | None = None) -> TransferFunction:
    """A function that has opacity exactly where any of the scene's functions has some, or emits light,
    or bends rays."""
    functions = layer_functions(resolved, function)
    shapes = [] if resolved.glow is None else [resolved.glow.shape]
    if has_integral_table(resolved.integration):
        entries = resolved.integration.table_size
        shapes += [tabulated_shape(each, *reachable(resolved), entries) for each in functions]
    if resolved.refraction is not None and (changes := resolved.refraction.shape) is not None:
        shapes.append(changes)
    return opacity_envelope([*functions, *shapes])


def factor_rows(factor: OpacityFactor | None, per_edge: float) -> np.ndarray:
    """float32 [2, n]: positions in kernel value per edge (``per_edge`` times those in value per world
    length), and factors."""
    if factor is None:
        return np.zeros((2, 0), np.float32)
    return _float32([factor.at * per_edge, factor.factors])


def layer_places(resolved: ResolvedScene, per_edge: float) -> tuple[np.ndarray, ...]:
    """float32 [layers], ascending from 0: the layers' magnitudes per edge; empty without layers. Of a joint function
    the kernel values of each field at which functions stand."""
    if not resolved.transfer_layers:
        return (np.zeros(0, np.float32),)
    if resolved.transfer_layers[0].values:
        fields = [field for field in resolved.fields if field.role == "value"]
        axes = axes_of_layers([field.base for field in fields], [layer.values for layer in resolved.transfer_layers])
        return tuple(_float32(value_map(field.volume)(np.array(axis))) for field, axis in zip(fields, axes))
    return (_float32([0.0, *(layer.magnitude * per_edge for layer in resolved.transfer_layers)]),)


def _float32(values: Sequence | np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", under="ignore"):
        return np.array(values, np.float64).astype(np.float32).clip(None, np.finfo(np.float32).max)
