"""The first picture of a volume: what is chosen where a scene says nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from clvol.choice.hounsfield import hounsfield_offset
from clvol.choice.look import Look, Point, balanced_unit, look_of
from clvol.choice.sample import Sample, sample_of
from clvol.choice.statistics import Statistics
from clvol.choice.view import View, anatomical_axes, is_placeholder, view_of
from clvol.volume.volume import Volume

_DARKEST = 0.25  # of a colour, where no light shows form and only colour can
_STEP = 0.5  # voxels: surfaces are thin
_VEIL = 0.6  # opacity of labels that light does not shape


@dataclass(frozen=True)
class Wanted:
    """What a scene asks of a look. ``lit``: its method renders lights and filters. ``projects``: it shows a projection
    of values along rays. ``has_surfaces``: it has iso-surfaces of its own."""

    lit: bool = True
    projects: bool = False
    has_surfaces: bool = False


class FirstPicture:
    """What suits ``volume``. Nothing is computed before it is used, and nothing twice."""

    def __init__(self, volume: Volume) -> None:
        self.volume = volume
        self._views: dict[tuple[Point, ...], View] = {}

    @cached_property
    def sample(self) -> Sample:
        return sample_of(self.volume)

    @cached_property
    def _found(self) -> tuple[Look, Statistics | None]:
        is_body = anatomical_axes(self.volume.frame) is not None and not is_placeholder(self.volume)
        return look_of(self.volume, self.sample, is_body)

    @property
    def statistics(self) -> Statistics | None:
        """None where no value differs from another."""
        return self._found[1]

    @property
    def natural(self) -> Look:
        """The look where everything can be chosen."""
        return self._found[0]

    def look(self, wanted: Wanted) -> Look:
        """The look within what the scene leaves to choose."""
        look = self.natural
        if wanted.projects:
            return self._projected(look)
        if wanted.has_surfaces:
            points = [(value, 0.0, color) for value, _, color in look.points]
            alone = replace(look, points=points, why=f"{look.why}; the scene's surfaces are shown alone")
            return alone if wanted.lit else replace(alone, lit=False, integration={}, material={})
        return look if wanted.lit else self._unlit(look)

    @cached_property
    def hounsfield_offset(self) -> float | None:
        """What was added to Hounsfield units; None if the values are something else."""
        return hounsfield_offset(self.sample)

    def placed(self, places: Sequence[Point], scale: str, offset: float) -> list[Point]:
        """Control points at ``places`` of a preset's ``scale``, in values of the volume.

        "hounsfield": Hounsfield units, to which ``offset`` is added; "relative": fractions of the range of values;
        "object": from the background (0) over the object's boundary (0.5) to what is bright in it (1).
        """
        low, high = self.volume.value_range
        found = self.statistics
        points: list[Point] = []
        for at, opacity, color in places:
            if scale == "hounsfield":
                value = at + offset
            elif scale == "relative" or found is None:
                value = low * (1.0 - at) + high * at
            else:
                value = found.value(float(np.interp(at, [0.0, 0.5, 1.0], [0.0, found.edge, 1.0])))
            points.append((value, opacity, color))
        if points[0][0] > points[-1][0]:
            points.reverse()
        kept = [p for k, p in enumerate(points) if not 0 < k < len(points) - 1 or p[0] != points[k - 1][0]]
        return kept if kept[0][0] <= kept[-1][0] else kept[:1]

    def view(self, points: Sequence[Point]) -> View:
        """The view of what the control points show."""
        key = tuple(points)
        if key not in self._views:
            look = replace(self.natural, points=points)
            is_body = self.natural.kind == "CT"
            self._views[key] = view_of(self.volume, self.sample, look.opacities(self.sample.values), is_body)
        return self._views[key]

    def _projected(self, look: Look) -> Look:
        """A ramp from black to white over the object's values."""
        found = self.statistics
        if found is None:
            return look
        low, high = sorted((found.value(0.0), found.value(1.0)))
        points: list[Point] = [(low, 0.0, (0.0, 0.0, 0.0)), (high, 1.0, (1.0, 1.0, 1.0))]
        return replace(look, points=points, lit=False, integration={}, material={}, why=f"{look.why}; as a projection")

    def _unlit(self, look: Look) -> Look:
        """``look`` for a method without lights: colours rise from dark, and rays see into the object."""
        if not look.lit or self.statistics is None:
            return replace(look, lit=False, integration={}, material={})
        if look.kind in ("labels", "mask"):  # between labels the linear filter makes others: thin shells of them
            veil = [(value, min(alpha, _VEIL), color) for value, alpha, color in look.points]
            unit = balanced_unit(self.statistics, veil, 0.85)
            return replace(look, points=veil, opacity_unit=unit, lit=False, integration={}, material={})
        shown = [k for k, (_, alpha, _) in enumerate(look.points) if alpha > 0]
        count = max(len(shown) - 1, 1)
        points: list[Point] = []
        rank = {k: n / count for n, k in enumerate(shown)}
        found = self.statistics
        for k, (value, alpha, color) in enumerate(look.points):
            depth = abs(value - found.background) / max(found.scale, 1e-300)
            share = _DARKEST + (1.0 - _DARKEST) * max(rank.get(k, 0.0), float(np.clip(depth, 0.0, 1.0)))
            share = min(share, 1.0)
            red, green, blue = (round(c * share, 3) for c in color)
            points.append((value, alpha * share, (red, green, blue)))
        unit = max(look.opacity_unit, balanced_unit(found, points, 0.85))
        return replace(
            look, points=points, opacity_unit=unit, lit=False, integration={}, material={},
            why=f"{look.why}; unlit, as the method has no lights or is much faster without",
        )  # fmt: skip


def tables_of(look: Look) -> dict[str, Any]:
    """The tables of a scene that say what ``look`` is, but for lights."""
    points = [
        {"value": value, "opacity": round(float(opacity), 5), "color": list(color)}
        for value, opacity, color in look.points
    ]
    tables: dict[str, Any] = {
        "transfer_function": {"opacity_unit": _rounded(look.opacity_unit), "points": points},
        "image": {"background": list(look.background)},
    }
    if look.integration:
        tables["integration"] = {"step": _STEP, **look.integration}
    if look.lit and look.material:
        tables["material"] = dict(look.material)
    return tables


def lights_for(towards_eye: np.ndarray, up: np.ndarray) -> list[dict[str, Any]]:
    """A key light from the upper left behind the eye, and a weaker one from the eye itself; tables of a scene.

    ``towards_eye`` and ``up``: unit world vectors, not parallel.
    """
    right = np.cross(up, towards_eye)
    right = right / np.linalg.norm(right)
    above = np.cross(towards_eye, right)
    key = 0.75 * towards_eye + 0.6 * above - 0.55 * right
    direction = [round(float(-x), 4) for x in key / np.linalg.norm(key)]
    return [
        {"type": "directional", "direction": direction, "intensity": 0.95},
        {"type": "headlight", "intensity": 0.35},
    ]


def _rounded(length: float) -> float:
    return float(f"{length:.6g}")
