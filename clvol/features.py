"""Which effects a scene calls for, and why; and what will therefore be compiled.

One vocabulary in Python and in cl/features.h (a test compares them). What has no effect on the image
is not called for: it is neither compiled nor paid for.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.errors import SceneError
from clvol.scene.clip import Clip
from clvol.scene.resolve import ResolvedScene

FILTERS = {"nearest": 0, "linear": 1, "cubic": 2, "catmull-rom": 3}
# Voxels that a filter uses beyond the corners of a lattice cell.
FILTER_REACH = {"nearest": 0, "linear": 0, "cubic": 1, "catmull-rom": 1}
# How gradients are had; "central" and "sobel" are found on the fly.
GRADIENTS = {"central": 1, "sobel": 2, "precomputed": 3, "analytic": 4}
CLASSIFICATIONS = {"pre": 0, "post": 1, "preintegrated": 2}
QUADRATURES = {"steps": 0, "cells": 1}
METHODS = ("raycast", "reference")
# The sum of the weights' magnitudes along an axis, at most: 1 where no weight is negative.
_WEIGHT = {"catmull-rom": 1.25}


def overshoot(filter: str) -> float:
    """How far ``filter`` takes a sample below the lowest or above the highest of its voxels, at most: a
    share of their span. It is what negative weights can add up to."""
    return (_WEIGHT.get(filter, 1.0) ** 3 - 1.0) / 2.0


@dataclass(frozen=True)
class Effect:
    """One effect of the vocabulary: called for or not, and the reason in words."""

    name: str
    called_for: bool
    reason: str


def effects(resolved: ResolvedScene) -> list[Effect]:
    """Every effect that clvol knows of, with the reason why this scene needs it or not."""
    return [
        _emission_absorption(resolved),
        _lighting(resolved),
        _isosurfaces(resolved),
        _clipping(resolved),
    ]


def called_for(resolved: ResolvedScene) -> list[str]:
    """Names of the effects that are called for."""
    return [effect.name for effect in effects(resolved) if effect.called_for]


def refuse_unknown(resolved: ResolvedScene) -> None:
    """SceneError for what the scene calls for and no kernel gives: better none than a wrong picture."""
    integration, origin = resolved.integration, resolved.origin
    if integration.method not in METHODS:
        expected = " or ".join(repr(name) for name in METHODS)
        raise SceneError(f"{origin}: integration.method", f"got {integration.method!r}", expected)
    if integration.filter not in FILTERS:
        expected = " or ".join(repr(name) for name in FILTERS)
        raise SceneError(f"{origin}: integration.filter", f"got {integration.filter!r}", expected)
    if integration.quadrature == "cells" and integration.method == "raycast":
        where = f"{origin}: integration.quadrature"
        if integration.filter != "linear":
            what = f"got 'cells' with the filter {integration.filter!r}"
            raise SceneError(where, what, "'steps', or the filter 'linear'")
        if integration.classification == "pre":
            expected = "'steps', or the classification 'post' or 'preintegrated'"
            raise SceneError(where, "got 'cells' with the classification 'pre'", expected)


def explain(resolved: ResolvedScene) -> dict[str, Any]:
    """As ``clvol explain --json``: effects with reasons, and what identifies the compiled kernel."""
    refuse_unknown(resolved)
    listed = [
        {"name": e.name, "called_for": e.called_for, "reason": e.reason} for e in effects(resolved)
    ]
    return {"effects": listed, "kernel_hash": kernel_hash(resolved)}


def kernel_hash(resolved: ResolvedScene, lanes: int = 16) -> str:
    """Identifies exactly what gets compiled: sources and switches."""
    from clvol.opencl.context import compile_options
    from clvol.opencl.kernels_path import kernel_folder
    from clvol.render.raycast import raycast_switches, scene_nodes

    if resolved.integration.method == "reference":
        names, options = ("reference*",), (resolved.volume.dtype.name, resolved.integration.filter)
    else:
        warped = scene_nodes(resolved).warp is not None
        options = compile_options(raycast_switches(resolved, warped=warped, lanes=lanes))
        names = ("raycast.cl", "*.h")
    digest = hashlib.sha256(" ".join(options).encode())
    for pattern in names:
        for path in sorted(kernel_folder().glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _emission_absorption(resolved: ResolvedScene) -> Effect:
    function, volume = resolved.transfer_function, resolved.volume
    name = "emission-absorption"
    low, high = volume.value_range
    inside = (function.values >= low) & (function.values <= high)
    ends = function.opacity(np.array([low, high]))
    if not (np.any(function.opacities[inside] > 0) or np.any(ends > 0)):
        reason = f"the transfer function is transparent over the data's range {low:g} to {high:g}"
        return Effect(name, False, reason)
    reason = f"the transfer function has opacity within the data's range {low:g} to {high:g}"
    return Effect(name, True, reason)


def _lighting(resolved: ResolvedScene) -> Effect:
    if not resolved.lights:
        return Effect("lighting", False, "the scene has no light")
    if all(light.intensity == 0 or not np.any(light.color) for light in resolved.lights):
        return Effect("lighting", False, "every light is black or of intensity 0")
    return Effect("lighting", True, f"{len(resolved.lights)} lights")


def _isosurfaces(resolved: ResolvedScene) -> Effect:
    name = "isosurfaces"
    if not resolved.isosurfaces:
        return Effect(name, False, "the scene has no isosurface")
    low, high = resolved.volume.value_range
    seen = [s for s in resolved.isosurfaces if s.opacity > 0 and low <= s.value <= high]
    if not seen:
        reason = f"every iso-value is transparent or outside the data's range {low:g} to {high:g}"
        return Effect(name, False, reason)
    return Effect(name, True, f"{len(seen)} iso-values inside the data's range")


def _clipping(resolved: ResolvedScene) -> Effect:
    if not resolved.clips:
        return Effect("clipping", False, "the scene has no clip plane")
    corners = resolved.volume.grid.world_corners()
    cuts = [clip for clip in resolved.clips if _cuts(clip, corners)]
    if not cuts:
        return Effect("clipping", False, "no clip plane meets the volume")
    return Effect("clipping", True, f"{len(cuts)} planes meet the volume")


def _cuts(clip: Clip, corners: np.ndarray) -> bool:
    """Whether more than rounding of the volume's ``corners`` [n, 3] lies behind the plane."""
    normal = np.asarray(clip.normal)
    normal = normal / np.abs(normal).max()  # so that no square or product may overflow
    point = np.asarray(clip.point)
    rounding = 1e-14 * max(np.abs(corners).max(), np.abs(point).max())
    return bool(np.any((corners - point) @ normal < -rounding))
