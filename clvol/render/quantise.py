"""Voxels held in fewer bits than they are stored in: less memory to read, and an error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.errors import SceneError
from clvol.scene.isosurface import Isosurface
from clvol.scene.opacity_factor import OpacityFactor
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.volume import Volume

_FINITE = (-1e30, 1e30)  # what a scene's numbers may be
_SLICES = 2**22  # voxels quantised at a time, in double precision


def quantised(resolved: ResolvedScene, codes: Volume | None = None) -> ResolvedScene:
    """``resolved`` with its voxels as ``integration.voxel_precision`` says: evenly spaced over the
    volume's range, rounded to nearest, and all that is stated in values (the transfer function, iso-values, ...) in the
    same numbers. ``codes``: the volume that this made of ``resolved.volume`` before.

    SceneError if a voxel is not finite, which no integer says.
    """
    asked, volume = resolved.integration.voxel_precision, resolved.volume
    if asked == "stored" or np.dtype(asked).itemsize >= volume.dtype.itemsize:
        return resolved
    if volume.nan_count or volume.inf_count:
        bad = volume.nan_count + volume.inf_count
        where = f"{resolved.origin}: integration.voxel_precision"
        raise SceneError(where, f"got {asked!r} for {bad} voxels that are not finite", "'stored'")
    low, high = volume.value_range
    most = np.iinfo(asked).max
    # Halves first: high - low may overflow.
    span = (high / 2 - low / 2) * 2
    if not 0 < span < np.inf:
        return resolved

    def code(values: np.ndarray) -> np.ndarray:
        return (np.asarray(values, np.float64) - low) / span * most

    if codes is None:
        codes = _volume_of_codes(volume, code, asked)
    return replace(resolved, volume=codes, **_in_codes(resolved, code, most / span))


def _volume_of_codes(volume: Volume, code: Callable, dtype: str) -> Volume:
    grid, flat = volume.grid, volume.data.reshape(-1)
    codes = np.empty(flat.size, dtype)
    for start in range(0, flat.size, _SLICES):
        part = slice(start, start + _SLICES)
        codes[part] = np.rint(code(flat[part]))
    return Volume(
        codes.reshape(volume.data.shape),
        spacing=grid.spacing, origin=grid.origin, direction=grid.direction, name=volume.name,
    )  # fmt: skip


def _in_codes(resolved: ResolvedScene, code: Callable, per_value: float) -> dict[str, Any]:
    """All of a scene that is stated in values, in codes; ``per_value``: codes a unit of the value."""

    def function(asked: TransferFunction) -> TransferFunction:
        values = np.clip(code(asked.values), -1e300, 1e300)
        return TransferFunction(values, asked.opacities, asked.colors, asked.opacity_unit)

    def factor(asked: OpacityFactor | None) -> OpacityFactor | None:
        return asked and replace(asked, at=asked.at * per_value)

    def scaled(table: Any, key: str) -> Any:
        return table.model_copy(update={key: float(np.clip(getattr(table, key) * per_value, *_FINITE))})

    def level(surface: Isosurface) -> Isosurface:
        value = float(np.clip(code(surface.value), *_FINITE))
        return surface.model_copy(update={"value": value})

    layers = (
        replace(layer, magnitude=layer.magnitude * per_value, function=function(layer.function))
        for layer in resolved.transfer_layers
    )
    return {
        "transfer_function": function(resolved.transfer_function),
        "isosurfaces": tuple(level(surface) for surface in resolved.isosurfaces),
        "material": scaled(resolved.material, "fade"),
        "gradient_opacity": factor(resolved.gradient_opacity),
        "directional_opacity": factor(resolved.directional_opacity),
        "transfer_layers": tuple(layers),
        "noise": tuple(
            scaled(term, "amplitude") if term.target == "value" else term
            for term in resolved.noise
        ),
    }
