"""Converting what a scene states in values to the numbers that voxels are stored as.

Stored numbers may represent values along an axis (``ValueAxis``), or voxels may be quantised. Everything that the
scene states in values is then converted to these numbers, in both cases by ``in_codes``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.scene.isosurface import Isosurface
from clvol.scene.noise import Noise
from clvol.transfer import TransferFunction
from clvol.volume.axis import ValueAxis

if TYPE_CHECKING:
    from clvol.scene.channel import ResolvedChannel
    from clvol.scene.field import ResolvedField
    from clvol.scene.opacity_factor import OpacityFactor
    from clvol.scene.resolve import ResolvedScene

Code = Callable[[ArrayLike], np.ndarray]
_FINITE = (-1e30, 1e30)  # the range of numbers in a scene
_LARGEST = 1e300


def in_stored_values(resolved: ResolvedScene) -> ResolvedScene:
    """``resolved`` with everything stated in stored numbers, so that slopes and offsets are 1 and 0.

    ``axis`` of the result maps stored numbers back to values, for messages.
    """
    fields = tuple(_field_in_stored(field) for field in resolved.fields)
    by_value = [field for field in resolved.fields if field.role == "value"]
    if any(not field.volume.axis.is_plain for field in by_value):
        codes = [code_of(axis, volume.dtype) for volume, axis in (field.volume.plain for field in by_value)]
        layers = tuple(
            replace(layer, values=tuple(float(code(x)) for code, x in zip(codes, layer.values)))
            for layer in resolved.transfer_layers
        )
        resolved = replace(resolved, transfer_layers=layers)
    if any(a is not b for a, b in zip(fields, resolved.fields)):
        resolved = replace(resolved, fields=fields)
    channels = tuple(_channel_in_stored(channel) for channel in resolved.channels)
    if any(a is not b for a, b in zip(channels, resolved.channels)):
        resolved = replace(resolved, channels=channels)
    volume, axis = resolved.volume.plain
    if axis.is_plain:
        return resolved
    code = code_of(axis, volume.dtype)
    changed = in_codes(resolved, code, 1.0 / axis.slope)
    return replace(resolved, volume=volume, axis=axis, **changed)


def code_of(axis: ValueAxis, dtype: np.dtype) -> Code:
    """The function from values to the stored numbers of voxels of ``dtype``."""
    whole = dtype.kind in "iu"
    return lambda values: axis.stored(values, whole=whole)


def in_codes(resolved: ResolvedScene, code: Code, per_value: float) -> dict[str, Any]:
    """The parts of a scene that are stated in values of the volume, converted to codes.

    Codes rise with values; ``per_value`` is the number of codes per unit of the value.
    """

    def factor(by_value: OpacityFactor | None) -> OpacityFactor | None:
        return by_value and replace(by_value, at=by_value.at * per_value)

    def scaled(table: Any, key: str) -> Any:
        number = float(np.clip(getattr(table, key) * per_value, *_FINITE))
        return table.model_copy(update={key: number})

    def level(surface: Isosurface) -> Isosurface:
        value = float(np.clip(code(surface.value), *_FINITE))
        return surface.model_copy(update={"value": value})

    def ends(hairs: Noise) -> Noise:
        stated = {"root": hairs.root, "tip": hairs.tip}
        coded = {key: float(np.clip(code(value), *_FINITE)) for key, value in stated.items() if value is not None}
        return hairs.model_copy(update=coded)

    layers = (
        replace(
            layer,
            magnitude=layer.magnitude * per_value,
            function=function_in_codes(layer.function, code),
        )
        for layer in resolved.transfer_layers
    )
    glow, index = resolved.glow, resolved.refraction
    return {
        "transfer_function": function_in_codes(resolved.transfer_function, code),
        "glow": glow and replace(glow, values=np.clip(code(glow.values), -_LARGEST, _LARGEST)),
        "refraction": index and replace(index, values=np.clip(code(index.values), -_LARGEST, _LARGEST)),
        "isosurfaces": tuple(level(surface) for surface in resolved.isosurfaces),
        "material": scaled(resolved.material, "fade"),
        "gradient_opacity": factor(resolved.gradient_opacity),
        "directional_opacity": factor(resolved.directional_opacity),
        "transfer_layers": tuple(layers),
        "noise": tuple(
            scaled(term, "amplitude") if term.target == "value" else term
            for term in resolved.noise
        ),
        "fur": tuple(map(ends, resolved.fur)),
    }


def function_in_codes(function: TransferFunction, code: Code) -> TransferFunction:
    """``function``, stated in values, as a function of codes."""
    values = np.clip(code(function.values), -_LARGEST, _LARGEST)
    return TransferFunction(values, function.opacities, function.colors, function.opacity_unit)


def _channel_in_stored(channel: ResolvedChannel) -> ResolvedChannel:
    volume, axis = channel.volume.plain
    if axis.is_plain:
        return channel
    function = function_in_codes(channel.function, code_of(axis, volume.dtype))
    return replace(channel, volume=volume, axis=axis, function=function)


def _field_in_stored(field: ResolvedField) -> ResolvedField:
    volume, axis = field.volume.plain
    if axis.is_plain:
        return field
    code = code_of(axis, volume.dtype)
    changed: dict[str, Any] = {"volume": volume, "axis": axis}
    if field.role == "mask":
        changed["threshold"] = float(code(field.threshold))
    elif field.role == "color":
        return field
    elif field.role == "value":
        changed["base"] = float(code(field.base))
    elif field.role == "density":
        changed["function"] = function_in_codes(field.function, code)
    else:
        changed |= _labels_in_stored(field, code)
    return replace(field, **changed)


def _labels_in_stored(field: ResolvedField, code: Code) -> dict[str, np.ndarray]:
    """The labels in stored numbers, without those that no voxel can have."""
    stored = code(field.labels)
    kept = (stored == np.rint(stored)) & (np.abs(stored) < 2.0**53)
    if not kept.any():
        kept[:1], stored = True, np.full(stored.shape, 2.0**53)  # a label that never occurs
    found = {
        "labels": stored[kept].astype(np.int64),
        "colors": field.colors[kept],
        "factors": field.factors[kept],
    }
    for array in found.values():
        array.setflags(write=False)
    return found
