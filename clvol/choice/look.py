"""Transfer function, material and filter for each kind of data, as tables of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clvol.choice.hounsfield import hounsfield_offset
from clvol.choice.labels import label_background, label_points, label_values
from clvol.choice.sample import Sample
from clvol.choice.statistics import Statistics, statistics_of
from clvol.volume.volume import Volume

Color = tuple[float, float, float]
Point = tuple[float, float, Color]

BACKGROUND: Color = (0.055, 0.06, 0.075)
SURFACE_MATERIAL = {"ambient": 0.22, "diffuse": 0.78, "specular": 0.18, "shininess": 28.0}
SOFT_MATERIAL = {"ambient": 0.5, "diffuse": 0.55, "specular": 0.08, "shininess": 16.0}

_IVORY: Color = (0.97, 0.94, 0.86)
_BONE: tuple[Color, ...] = ((0.80, 0.66, 0.50), (0.95, 0.89, 0.76), (1.0, 0.98, 0.94))
_CLAY: tuple[Color, ...] = ((0.86, 0.76, 0.64), (0.95, 0.89, 0.80), (1.0, 0.98, 0.95))
_VESSEL: tuple[Color, ...] = ((0.62, 0.14, 0.10), (0.86, 0.30, 0.20), (0.99, 0.80, 0.62))
_GLASS: Color = (0.60, 0.70, 0.80)
_AMBER: Color = (0.93, 0.70, 0.40)
# Dark violet, blue, teal, green, yellow: even steps in lightness, the order of matplotlib's "viridis".
_FIELD: tuple[Color, ...] = (
    (0.28, 0.14, 0.46), (0.20, 0.36, 0.55), (0.13, 0.57, 0.55), (0.37, 0.79, 0.38), (0.99, 0.91, 0.14),
)  # fmt: skip
_GLOW: tuple[Color, ...] = ((0.05, 0.25, 0.20), (0.10, 0.65, 0.40), (0.55, 0.95, 0.55), (0.95, 1.0, 0.85))
_COLD: Color = (0.25, 0.50, 0.90)
_WARM: Color = (0.90, 0.35, 0.25)


_CLOUD = 1.9  # ratio of the quartiles of what is inside, from which on it is not solid


@dataclass(frozen=True, eq=False)
class Look:
    """How a kind of data is shown.

    ``kind``: a word or two; ``why``: what it was recognised by. ``points``: (value, opacity, sRGB colour), values
    ascending. ``opacity_unit``: world length of the opacities. ``lit``: whether surfaces are worth lights.
    ``integration``, ``material``, ``background``: keys of the scene.
    """

    kind: str
    why: str
    points: Sequence[Point]
    opacity_unit: float
    lit: bool = True
    integration: dict[str, Any] = field(default_factory=dict)
    material: dict[str, Any] = field(default_factory=dict)
    background: Color = BACKGROUND

    def opacities(self, values: np.ndarray) -> np.ndarray:
        """Opacity over ``opacity_unit`` of ``values`` (any shape); 0 for NaN."""
        at = np.array([value for value, *_ in self.points])
        opacity = np.array([alpha for _, alpha, _ in self.points])
        return np.where(np.isnan(values), 0.0, np.interp(values, at, opacity))


def look_of(volume: Volume, sample: Sample, is_body: bool = False) -> tuple[Look, Statistics | None]:
    """The look of the kind of data that ``volume`` has."""
    labels = label_values(sample, volume.labels)
    statistics = statistics_of(sample)
    if labels is not None:
        if labels.size <= 2:
            return _mask(sample, labels), statistics
        return _labels(sample, labels, volume.labels), statistics
    if statistics is None:
        return _even(sample), None
    if min(sample.values.shape) <= 2:
        return _slice(statistics), statistics
    offset = hounsfield_offset(sample)
    if offset is not None:
        return _hounsfield(sample, offset), statistics
    for recognise in (_distance, _two_signs, _field, _noisy, _vessels):
        look = recognise(statistics)
        if look is not None:
            return look, statistics
    return _object(statistics, is_body), statistics


def mean_edge(sample: Sample) -> float:
    """The geometric mean of a voxel's edges, in world units."""
    return float(np.exp(np.mean(np.log(sample.grid.spacing))))


def _ascending(points: Sequence[Point]) -> list[Point]:
    """``points`` in ascending order of values."""
    ordered = sorted(points, key=lambda point: point[0]) if points[0][0] <= points[-1][0] else list(points)[::-1]
    return ordered


def _surface(
    st: Statistics, edge: float, levels: Sequence[tuple[float, float, Color]], width: float
) -> list[Point]:
    """Points that rise from transparent just below ``edge`` to the first of ``levels`` (signal, opacity, colour)."""
    first = levels[0]
    signals = [(edge - width, 0.0, first[2]), *((max(s, edge + width), a, c) for s, a, c in levels)]
    points: list[Point] = []
    for signal, opacity, color in signals:
        value = st.value(signal)
        if not points or value != points[-1][0]:
            points.append((value, opacity, color))
    if len(points) == 1:
        points.append((points[0][0], levels[-1][1], levels[-1][2]))
    return _ascending(points)


def _ramp(colors: Sequence[Color], t: float) -> Color:
    at = np.linspace(0.0, 1.0, len(colors))
    red, green, blue = (float(np.interp(t, at, [color[k] for color in colors])) for k in range(3))
    return round(red, 3), round(green, 3), round(blue, 3)


def _labels(sample: Sample, labels: np.ndarray, said: bool) -> Look:
    background = label_background(sample, labels)
    return Look(
        kind="labels",
        why=f"{'the file says so' if said else 'whole numbers in even regions'}, {labels.size} of them",
        points=label_points(labels, background),
        opacity_unit=mean_edge(sample),
        integration={"filter": "nearest"},
        material=SURFACE_MATERIAL,
    )


def _mask(sample: Sample, labels: np.ndarray) -> Look:
    background = label_background(sample, labels)
    low, high = float(labels[0]), float(labels[-1])
    if low == high:
        points: list[Point] = [(low, 0.9, _IVORY)]
    else:
        inside_high = background != high
        a, b = (0.0, 0.97) if inside_high else (0.97, 0.0)
        points = [(low + 0.40 * (high - low), a, _IVORY), (low + 0.60 * (high - low), b, _IVORY)]
    return Look(
        kind="mask",
        why="two values in even regions",
        points=points,
        opacity_unit=mean_edge(sample),
        integration={"filter": "cubic"},
        material=SURFACE_MATERIAL,
    )


def _even(sample: Sample) -> Look:
    known = sample.values[np.isfinite(sample.values)]
    if known.size == 0:
        return Look("empty", "no voxel has a value", [(0.0, 0.0, _IVORY)], mean_edge(sample), lit=False)
    size = (np.asarray(sample.values.shape[::-1]) * sample.spacing).min()
    return Look(
        "constant", "all voxels have one value", [(float(known[0]), 0.35, (0.70, 0.75, 0.82))], float(size) / 8.0,
        lit=False,
    )  # fmt: skip


def _slice(st: Statistics) -> Look:
    """A single slice: an image."""
    known = st.sample.values[np.isfinite(st.sample.values)]
    low, high = (float(end) for end in np.percentile(known, [1.0, 99.0]))
    if not low < high:
        low, high = st.low, st.high
    points: list[Point] = [(low, 0.95, (0.03, 0.03, 0.04)), (high, 0.95, (1.0, 0.99, 0.97))]
    thinnest = (np.asarray(st.sample.values.shape[::-1]) * st.sample.spacing).min()
    return Look("slice", "one slice: its values as shades of grey", points, 0.3 * float(thinnest), lit=False)


def _hounsfield(sample: Sample, offset: float) -> Look:
    units: list[Point] = [
        (-450.0, 0.0, (0.80, 0.50, 0.40)),
        (-250.0, 0.010, (0.85, 0.56, 0.45)),
        (20.0, 0.016, (0.80, 0.42, 0.34)),
        (110.0, 0.020, (0.80, 0.36, 0.28)),
        (170.0, 0.30, (0.86, 0.52, 0.38)),
        (260.0, 0.80, (0.93, 0.80, 0.64)),
        (600.0, 0.92, (0.97, 0.92, 0.82)),
        (1600.0, 0.97, (1.0, 0.99, 0.96)),
    ]
    said = f"Hounsfield units + {offset:g}" if offset else "Hounsfield units"
    return Look(
        kind="CT",
        why=f"air and soft tissue are where they are in {said}",
        points=[(value + offset, opacity, color) for value, opacity, color in units],
        opacity_unit=1.5 * mean_edge(sample),
        integration={"filter": "cubic"},
        material=SURFACE_MATERIAL,
    )


def _distance(st: Statistics) -> Look | None:
    """A signed distance: both signs, and a gradient of the same length nearly everywhere."""
    if not st.low < 0 < st.high:
        return None
    values = st.sample.values
    if min(values.shape) < 5:
        return None
    x, y, z = st.sample.spacing
    inner = np.stack(np.gradient(values, z, y, x))[:, 1:-1, 1:-1, 1:-1]
    length = np.sqrt((inner**2).sum(axis=0))
    length = length[np.isfinite(length)]
    if length.size < 100 or length.mean() <= 0 or np.std(length) > 0.15 * np.mean(length):
        return None
    faces = np.concatenate([values.take(end, axis).ravel() for axis in range(3) for end in (0, -1)])
    inside = -1.0 if np.nanmedian(faces) > 0 else 1.0  # the sign that the faces of the volume do not have
    width = 0.75 * float(np.mean(length)) * mean_edge(st.sample)
    points = [(-inside * width, 0.0, _AMBER), (inside * width, 0.97, _AMBER)]
    return Look(
        kind="distance field",
        why="both signs and an even gradient: the surface is at 0",
        points=_ascending(points),
        opacity_unit=mean_edge(st.sample),
        integration={"filter": "cubic"},
        material=SURFACE_MATERIAL,
    )


def _two_signs(st: Statistics) -> Look | None:
    """A smooth field with as much below as above zero: a shell for each sign."""
    if not (st.low < 0 < st.high and st.both > 0.12 and st.sharpness < 0.5):
        return None
    if abs(st.background) > 0.15 * max(-st.low, st.high):
        return None
    known = np.abs(st.sample.values[np.isfinite(st.sample.values)])
    level = float(np.percentile(known, 99.5)) * 0.38
    high = float(np.percentile(known, 99.5))
    points: list[Point] = [
        (-high, 0.9, _ramp((_COLD, (0.8, 0.9, 1.0)), 0.4)),
        (-level, 0.55, _COLD),
        (-0.75 * level, 0.0, _COLD),
        (0.75 * level, 0.0, _WARM),
        (level, 0.55, _WARM),
        (high, 0.9, _ramp((_WARM, (1.0, 0.9, 0.8)), 0.4)),
    ]
    return Look(
        kind="signed field",
        why="smooth, and as much below zero as above",
        points=points,
        opacity_unit=1.5 * mean_edge(st.sample),
        integration={"filter": "cubic"},
        material=SURFACE_MATERIAL,
    )


def _field(st: Statistics) -> Look | None:
    """A smooth simulation: layers of rising value, their opacity such that the far side still shows."""
    if st.sharpness > 0.33 or st.noise_signal > 0.2:
        return None
    finite = np.isfinite(st.sample.values)
    known = st.signal[finite & (st.signal > 0.02)]
    if known.size == 0:
        return None
    why = "values change slowly from voxel to voxel"
    if np.count_nonzero(~finite) > 0.02 * finite.size:  # what has values is the object, whatever they are
        low, top = (float(end) for end in np.percentile(st.signal[finite], [0.5, 99.5]))
        steps, alphas, opacity = np.linspace(low, top, 6), [0.5, 0.55, 0.6, 0.65, 0.7, 0.75], 0.9
        why += ", where there are any"
    else:
        top = float(np.percentile(known, 99.7))
        base = max(0.06, 2.5 * st.noise_signal) * top
        if st.is_filled or float(np.mean(st.signal > base)) > 0.6:
            base = float(np.percentile(known, 55))
        steps, alphas, opacity = np.linspace(base, top, 6), [0.0, 0.04, 0.10, 0.22, 0.45, 0.8], 0.72
    raw = [(st.value(s), a, _ramp(_FIELD, k / 5)) for k, (s, a) in enumerate(zip(steps, alphas))]
    points = _ascending([p for k, p in enumerate(raw) if k == 0 or p[0] != raw[k - 1][0]])
    return Look(
        kind="smooth field",
        why=why,
        points=points,
        opacity_unit=balanced_unit(st, points, opacity),
        integration={"filter": "cubic"},
        material=SOFT_MATERIAL,
    )


def _noisy(st: Statistics) -> Look | None:
    """Fluorescence and other data whose noise is as strong as edges: brightness by depth of light, smoothed."""
    if st.noise_signal > 0.15 and st.stands_out < 0.03:
        return _haze(st)
    if st.is_filled or st.sign < 0 or not st.sample.is_integer or st.noise_signal < 0.012:
        return None
    inside = st.signal > st.edge
    if not inside.any() or np.median(st.contrast[inside]) < 0.15:
        return None
    lower, upper = np.percentile(st.signal[inside], [25, 75])
    if upper < 1.45 * lower:  # one material: a scan of something solid
        return None
    base = max(3.0 * st.noise_signal, 0.5 * st.edge)
    steps, alphas = np.linspace(base, 1.0, 5), (0.0, 0.08, 0.25, 0.5, 0.8)
    raw = [(st.value(s), a, _ramp(_GLOW, k / 4)) for k, (s, a) in enumerate(zip(steps, alphas))]
    points = _ascending(raw)
    return Look(
        kind="microscopy",
        why="dim background, and noise that grows with the signal",
        points=points,
        opacity_unit=balanced_unit(st, points, 0.6),
        integration={"filter": "cubic"},
        material=SOFT_MATERIAL,
    )


def _haze(st: Statistics) -> Look:
    """Nothing stands out: all values, as a veil."""
    known = st.sample.values[np.isfinite(st.sample.values)]
    steps = np.percentile(known, [50.0, 75.0, 90.0, 98.0, 99.9])
    alphas = (0.0, 0.05, 0.2, 0.5, 0.8)
    raw = [(float(v), a, _ramp(_FIELD, 0.4 + 0.15 * k)) for k, (v, a) in enumerate(zip(steps, alphas))]
    points = [p for k, p in enumerate(raw) if k == 0 or p[0] > raw[k - 1][0]]
    return Look(
        kind="noise",
        why="nothing stands out from the background",
        points=points,
        opacity_unit=balanced_unit(st, points, 0.6),
        integration={"filter": "cubic"},
        material=SOFT_MATERIAL,
    )


def _vessels(st: Statistics) -> Look | None:
    """Thin bright structures in an empty volume."""
    share = float(np.mean(st.signal > st.edge))
    if share > 0.03 or st.is_filled:
        return None
    edge = max(0.8 * st.edge, 3.5 * st.noise_signal)
    levels = [(edge + 0.06, 0.8, _VESSEL[0]), (0.5 * (edge + 1.0), 0.95, _VESSEL[1]), (1.0, 0.97, _VESSEL[2])]
    return Look(
        kind="vessels",
        why=f"bright structures in {100 * share:.2g} % of the volume",
        points=_surface(st, edge, levels, 0.05),
        opacity_unit=mean_edge(st.sample),
        integration={"filter": "cubic"},
        material=SURFACE_MATERIAL,
    )


def _object(st: Statistics, is_body: bool = False) -> Look:
    """Something that is brighter (or darker) than what is around it."""
    edge = max(st.edge, 3.5 * st.noise_signal)
    width = 0.35 * edge
    materials = [m for m in st.materials if m > edge + 0.08]
    why = f"{len(materials) + 1} materials"
    if not materials and not is_body and (dense := _dense_part(st, edge)) is not None:
        materials, why = [dense], "densities of all sizes"
    if not materials or is_body:
        levels = [
            (edge + width, 0.75, _CLAY[0]),
            (0.5 * (edge + 1.0), 0.9, _CLAY[1]),
            (1.0, 0.97, _CLAY[2]),
        ]
        why = "shown as one surface"
    else:
        cut = materials[-1]
        levels = [
            (edge + width, 0.06, _GLASS), (cut - 0.04, 0.08, _GLASS), (cut + 0.04, 0.8, _AMBER), (1.0, 0.97, _IVORY),
        ]  # fmt: skip
    return Look(
        kind="object",
        why=f"{'darker' if st.sign < 0 else 'brighter'} than what is around it, {why}",
        points=_surface(st, edge, levels, width),
        opacity_unit=1.5 * mean_edge(st.sample),
        integration={"filter": "cubic"},
        material=SURFACE_MATERIAL,
    )


def _dense_part(st: Statistics, edge: float) -> float | None:
    """The signal above which a cloud is dense: Otsu's threshold; None for something solid, whose inside is of nearly
    one value."""
    from skimage.filters import threshold_otsu

    inside = st.signal[st.signal > edge]
    if inside.size < 100:
        return None
    lower, upper = np.percentile(inside, [25, 75])
    if upper < _CLOUD * lower:
        return None
    dense = float(threshold_otsu(np.clip(inside, edge, 1.0)))
    return dense if edge + 0.08 < dense < 0.95 else None


def balanced_unit(st: Statistics, points: Sequence[Point], opacity: float) -> float:
    """The opacity unit with which rays through the object have a mean opacity of ``opacity``."""
    at, alpha = np.array([p[0] for p in points]), np.array([p[1] for p in points])
    depth = -np.log1p(-np.minimum(np.interp(st.sample.values, at, alpha), 0.999))
    depth = np.where(np.isfinite(st.sample.values), depth, 0.0)
    sums = [depth.sum(axis).ravel() * st.sample.spacing[2 - axis] for axis in range(3)]
    paths = np.concatenate(sums)
    paths = paths[paths > 0.05 * np.percentile(paths, 99)]
    if paths.size == 0:
        return mean_edge(st.sample)
    low, high = paths.max() * 1e-4, paths.max() * 1e4
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if np.mean(-np.expm1(-paths / middle)) > opacity else (low, middle)
    return float(np.sqrt(low * high))
