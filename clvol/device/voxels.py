"""Voxels as they are rendered: quantised, or the coefficients of a prefilter, where the scene says so."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

from clvol.device.prefilter import prefiltered
from clvol.device.quantise import quantised
from clvol.features import reduced_for_frames
from clvol.scene.resolve import ResolvedScene

_KEPT = 6  # converted volumes
Keep = Callable[[str, Hashable, Callable[[], Any], int], Any]  # as ``integrators.base.Shared.keep``


def as_rendered(resolved: ResolvedScene, keep: Keep | None = None) -> ResolvedScene:
    """``resolved`` without effects that have no consequence, and with the voxels that are rendered. ``keep`` keeps
    converted volumes, so that each is made once."""
    resolved = reduced_for_frames(resolved)
    integration = resolved.integration
    if integration.voxel_precision == "stored" and not integration.prefilter:
        return resolved
    if keep is None:
        return reduced_for_frames(prefiltered(quantised(resolved)))
    key = resolved.volume, integration.voxel_precision, integration.prefilter

    def convert() -> tuple:
        small = quantised(resolved)
        return small.volume, prefiltered(small).volume

    codes, coefficients = keep("converted voxels", key, convert, _KEPT)
    return reduced_for_frames(prefiltered(quantised(resolved, codes), coefficients))
