"""Label, density, mask and colour fields."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from clvol.features.effect import Effect, counted, joined, no, yes
from clvol.features.findings import NOTHING_VISIBLE, Findings
from clvol.features.geometry import grids_apart, holds
from clvol.features.values import shows
from clvol.scene.field import ResolvedField
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume

_SLAB = 2**22  # voxels that are examined together
_DOES = {
    "label": "with labels inside the volume",
    "density": "with opacity of its own",
    "mask": "that may cut the volume",
    "color": "of colours of voxels",
    "value": "in a joint transfer function",
}
_found: WeakKeyDictionary = WeakKeyDictionary()  # volume: {labels: whether any of them occurs}


def analyse(found: Findings) -> None:
    kept: list[ResolvedField] = []
    reasons: dict[str, list[str]] = {"label": [], "density": [], "mask": [], "color": [], "value": []}
    for field in found.scene.fields:
        idle = _idle(field, found)
        if idle is None:
            kept.append(field)
        else:
            reasons[field.role].append(idle)
    del reasons["value"]
    for role, why in reasons.items():
        used = sum(field.role == role for field in kept)
        found.note(_effect(role, used, why))
    found.change(fields=tuple(kept))


def _effect(role: str, used: int, idle: list[str]) -> Effect:
    name = f"{role} field"
    if used:
        return yes(name, f"{counted(used, 'field')} {_DOES[role]}")
    return no(name, joined(idle) or f"the scene has no field of role {role!r}")


def _idle(field: ResolvedField, found: Findings) -> str | None:
    """Why ``field`` has no consequence, or None."""
    if field.role == "mask":
        reason = _mask_keeps_all(field, found.scene)
    elif found.projection:
        return f"{found.projection} shows values of the volume alone"
    elif field.role == "value":
        reason = None  # known with the layers of the function
    elif field.role == "label":
        reason = _no_label(field, found)
    elif field.role == "color":
        reason = _no_color(field, found)
    else:
        reason = _no_density(field, found.scene)
    return NOTHING_VISIBLE if reason is None and found.blank else reason


def _no_label(field: ResolvedField, found: Findings) -> str | None:
    if grids_apart(found.scene.volume.grid, field.volume.grid):
        return "the field does not meet the volume"
    if not _occurs(field.volume, field.labels):
        return "none of the labels occurs in the field"
    return None if found.emits else "the transfer function shows nothing that has a label"


def _no_color(field: ResolvedField, found: Findings) -> str | None:
    if grids_apart(found.scene.volume.grid, field.volume.grid):
        return "the field does not meet the volume"
    return None if found.emits else "the transfer function shows nothing that has a colour"


def _no_density(field: ResolvedField, scene: ResolvedScene) -> str | None:
    low, high = field.volume.value_range
    if not shows(field.function, low, high):
        low, high = field.axis.span((low, high))
        return f"the field's points are transparent over its range {low:g} to {high:g}"
    if grids_apart(scene.volume.grid, field.volume.grid):
        return "the field does not meet the volume"
    return None


def _mask_keeps_all(field: ResolvedField, scene: ResolvedScene) -> str | None:
    volume = field.volume
    low, high = volume.value_range
    whole = low > field.threshold if field.keep == "above" else high < field.threshold
    if whole and not (volume.nan_count or volume.inf_count) and _reaches_only(scene, volume):
        return f"the mask is {field.keep} {field.axis.values(field.threshold):g} all over the volume"
    return None


def _reaches_only(scene: ResolvedScene, volume: Volume) -> bool:
    return volume.grid == scene.volume.grid or holds(
        volume.grid, scene.volume.grid.world_corners()
    )


def _occurs(volume: Volume, labels: np.ndarray) -> bool:
    """Whether any of ``labels`` is a voxel's value."""
    low, high = volume.value_range
    labels = labels[(labels >= low) & (labels <= high)]
    if not labels.size:
        return False
    answers = _found.setdefault(volume, {})
    key = labels.tobytes()
    if key not in answers:
        flat = volume.data.reshape(-1)
        if flat.dtype.kind in "iu":
            labels = labels.astype(flat.dtype)
        answers[key] = any(
            bool(np.isin(flat[start : start + _SLAB], labels).any())
            for start in range(0, flat.size, _SLAB)
        )
    return answers[key]
