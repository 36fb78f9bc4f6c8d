"""The table of associated colours that cl/glow.h reads."""

from __future__ import annotations

import numpy as np

from clvol.device.memory import ValueMap
from clvol.scene.glow import Glow


def glow_rows(glow: Glow, values: ValueMap, reach: tuple[float, float], edge: float) -> np.ndarray:
    """float32 [7, n]: values that kernels compute with, light of an edge (world length ``edge``) at each, and integrals
    of it. ``reach``: values (of the scene) between which all samples lie."""
    low, high = (float(x) for x in values(np.array(reach)))
    at = np.asarray(values(glow.values), np.float64)
    margin = 1.0 + max(high, at[-1]) - min(low, at[0])
    at = np.concatenate([[min(low, at[0]) - margin], at, [max(high, at[-1]) + margin]])
    at = at.astype(np.float32).astype(np.float64)  # integrals are those of the values that kernels have
    light = np.concatenate([glow.light[:1], glow.light, glow.light[-1:]]) * edge
    pieces = 0.5 * np.diff(at)[:, None] * (light[1:] + light[:-1])
    integrals = np.concatenate([np.zeros((1, 3)), np.cumsum(pieces, axis=0)])
    return np.vstack([at, light.T, integrals.T]).astype(np.float32)
