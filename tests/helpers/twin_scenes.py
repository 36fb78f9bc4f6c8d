"""Scenes with closed forms: ramps of a few voxels, and single rays through them."""

from __future__ import annotations

import numpy as np
from reference import render_twin

from clvol import Scene, TransferFunction, Volume

RAMP_SIZE = 16


def constant_function(opacity=0.1, color=(0.8, 0.5, 0.2), unit=1.0) -> TransferFunction:
    """The same for all values."""
    return TransferFunction([0.0], [opacity], [color], unit)


def ramp(slope=1.0, axis=0, size=RAMP_SIZE) -> np.ndarray:
    """float64 [size, size, size], rising by ``slope`` a voxel along ``axis`` (0 is z)."""
    return np.moveaxis(np.broadcast_to(slope * np.arange(size), (size, size, size)), 2, axis).copy()


def scene(array, function=None, *, grid=None, **tables):
    """A resolved scene; ``tables`` as in a scene file. Post-classification and no early stop,
    unless [integration] says otherwise."""
    volume = array if isinstance(array, Volume) else Volume(array, **(grid or {}))
    integration = {"classification": "post", "early_termination": 0.0}
    integration.update(tables.pop("integration", {}))
    return Scene(
        volume=volume,
        transfer_function=constant_function() if function is None else function,
        integration=integration,
        **tables,
    ).resolve()


def ray(resolved, origin, direction, **how) -> np.ndarray:
    """The twin's rgba [4] of one ray."""
    direction = np.asarray(direction, float)
    direction = direction / np.linalg.norm(direction)
    return render_twin(resolved, rays=(np.asarray(origin, float), direction), **how)


def along_z(resolved, x=7.3, y=6.1, start=-5.0, **how) -> np.ndarray:
    """The same along z, from z = ``start``."""
    return ray(resolved, (x, y, start), (0, 0, 1), **how)


def absorbed(opacity: float, length: float) -> float:
    """What ``length`` of an opacity per unit length absorbs."""
    return -np.expm1(np.log1p(-opacity) * length)
