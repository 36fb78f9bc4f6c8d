"""What an overlay is drawn from, as plain data, which a picture's header keeps: ``clvol develop`` needs no volume."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import Field, model_validator

from clvol.choice.sample import sample_of
from clvol.choice.view import anatomical_axes, is_placeholder
from clvol.errors import VolumeError
from clvol.scene.camera import Camera
from clvol.scene.overlay import Overlay
from clvol.scene.table import AsTuple, Color, Coordinate, Fraction, Number, Table, Vector, wrong
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.scene.resolve import ResolvedScene

BINS = 128
_MOST_SAMPLES = 1_000_000
_RARE = 5e-4  # share of the voxels at each end of the range that the colour bar may leave out
_MOST_POINTS = 4096

_Values = Annotated[tuple[Number, ...], AsTuple, Field(max_length=_MOST_POINTS)]
_Count = Annotated[int, Field(ge=0)]


class Surface(Table):
    """An iso-surface: its value, and its colour in linear light."""

    value: Number
    color: Color


class Description(Table):
    """The overlay of one picture.

    ``corners``: world positions of the volume's corners; the k-th has the upper bound of x where k & 1, of y where
    k & 2, of z where k & 4. ``axes``: world directions of ``names``, and ``opposites`` are what lies the other way.
    ``values``, ``opacities`` and ``colors`` (linear light): the control points, in values. ``counts``: a histogram of
    the values from ``low`` to ``high`` in bins of equal width; empty where it was not requested.
    """

    settings: Overlay
    camera: Camera
    corners: Annotated[tuple[Vector, ...], AsTuple, Field(min_length=8, max_length=8)]
    axes: Annotated[tuple[Vector, ...], AsTuple, Field(min_length=3, max_length=3)]
    names: Annotated[tuple[str, ...], AsTuple, Field(min_length=3, max_length=3)]
    opposites: Annotated[tuple[str, ...], AsTuple, Field(min_length=3, max_length=3)]
    unit: str | None = None
    values: _Values = ()
    opacities: Annotated[tuple[Fraction, ...], AsTuple, Field(max_length=_MOST_POINTS)] = ()
    colors: Annotated[tuple[Color, ...], AsTuple, Field(max_length=_MOST_POINTS)] = ()
    low: Coordinate = 0.0
    high: Coordinate = 1.0
    counts: Annotated[tuple[_Count, ...], AsTuple, Field(max_length=_MOST_POINTS)] = ()
    surfaces: Annotated[tuple[Surface, ...], AsTuple, Field(max_length=_MOST_POINTS)] = ()

    @classmethod
    def table_name(cls) -> str:
        return "overlay"

    @model_validator(mode="after")
    def _can_be_drawn(self) -> Description:
        camera = self.camera
        if camera.position is None or camera.target is None or camera.up is None:
            raise wrong("camera", None, "a complete camera")
        if camera.projection == "orthographic" and camera.height is None:
            raise wrong("camera.height", None, "the height of the view")
        if not len(self.values) == len(self.opacities) == len(self.colors) or list(self.values) != sorted(self.values):
            raise wrong("values", len(self.values), "as many opacities and colours, in ascending order")
        return self


def describe_overlay(resolved: ResolvedScene, camera: Camera) -> Description:
    """The overlay of a picture of ``resolved`` from ``camera``, which is complete. The histogram, of a million voxels
    at most, is only made where a colour bar is requested.

    Directions have anatomical names where the file's frame does and its header states where the voxels lie: headers
    with nothing but defaults are those of converted files, and letters would say what nobody knows."""
    of = resolved.displayed_function, resolved.overlay, resolved.isosurfaces, resolved.axis
    known = _described.get(resolved.volume)
    if known is None or any(a is not b for a, b in zip(known[0], of)):
        known = _described[resolved.volume] = of, _described_anew(resolved, camera)
    described = known[1]
    if described.camera is not camera and described.camera != camera:  # frames from other cameras share the rest
        described = Description.model_construct(**{**dict(described), "camera": camera})
    return described


_described: WeakKeyDictionary[Volume, tuple[tuple[Any, ...], Description]] = WeakKeyDictionary()  # the last one


def _described_anew(resolved: ResolvedScene, camera: Camera) -> Description:
    volume, function = resolved.volume, resolved.displayed_function
    axis = resolved.axis
    low, high = axis.span(resolved.data_range)
    counts: tuple[int, ...] = ()
    values = [float(value) for value in np.atleast_1d(axis.values(function.values))]
    if resolved.overlay.color_bar:
        low, high, counts = _histogram(resolved, values, low, high)
    anatomical = None if is_placeholder(volume) else anatomical_axes(volume.frame)
    axes = np.eye(3) if anatomical is None else anatomical
    return Description(
        settings=resolved.overlay,
        camera=camera,
        corners=tuple(tuple(corner) for corner in _corners(resolved).tolist()),
        axes=tuple(tuple(row) for row in axes.tolist()),
        names=("+x", "+y", "+z") if anatomical is None else ("L", "A", "S"),
        opposites=("\u2212x", "\u2212y", "\u2212z") if anatomical is None else ("R", "P", "I"),
        unit=volume.unit,
        values=tuple(values[:_MOST_POINTS]),
        opacities=tuple(function.opacities.tolist()[:_MOST_POINTS]),
        colors=tuple(tuple(color) for color in function.colors.tolist()[:_MOST_POINTS]),
        low=float(np.clip(low, -1e30, 1e30)),
        high=float(np.clip(high, -1e30, 1e30)),
        counts=counts,
        surfaces=tuple(
            Surface(value=float(axis.values(surface.value)), color=tuple(float(c) for c in surface.color))
            for surface in resolved.isosurfaces[:_MOST_POINTS]
        ),
    )


def _corners(resolved: ResolvedScene) -> np.ndarray:
    """World positions [8, 3] in the order of ``Description.corners``."""
    grid = resolved.volume.grid
    lower, upper = (np.asarray(bound, np.float64) for bound in grid.index_bounds())
    bits = np.array([[k >> axis & 1 for axis in range(3)] for k in range(8)], bool)
    matrix = grid.index_to_world()
    return np.where(bits, upper, lower) @ matrix[:3, :3].T + matrix[:3, 3]


_Bins = tuple[float, float, tuple[int, ...]]
_known: WeakKeyDictionary[Volume, tuple[tuple, _Bins]] = WeakKeyDictionary()  # the last one of each volume


def _histogram(resolved: ResolvedScene, points: list[float], low: float, high: float) -> _Bins:
    """(lowest value, highest value, counts) of the range that most voxels and the control points lie in. Frames of an
    animation share it."""
    key = (tuple(points), low, high, resolved.axis)
    known = _known.get(resolved.volume)
    if known is None or known[0] != key:
        known = _known[resolved.volume] = key, _counted(resolved, points, low, high)
    return known[1]


def _counted(resolved: ResolvedScene, points: list[float], low: float, high: float) -> _Bins:
    try:
        sample = sample_of(resolved.volume, _MOST_SAMPLES).values
    except VolumeError:  # blocks of a store that cannot be read, which the picture may not need
        return low, high, ()
    found = np.asarray(resolved.axis.values(sample[np.isfinite(sample)]))
    if not found.size:
        return low, high, ()
    ends = np.quantile(found, [_RARE, 1.0 - _RARE])
    within = [value for value in points if low <= value <= high]
    low, high = min([*within, float(ends[0])]), max([*within, float(ends[1])])
    if not low < high:
        low, high = low - 0.5, high + 0.5
    bins = BINS
    if resolved.volume.dtype.kind in "iu":  # as many integers in each bin, or bins would differ by that alone
        levels = max(1, round((high - low) / resolved.axis.slope))
        bins = max(1, levels // -(-levels // BINS))
    counts, _ = np.histogram(found, bins, (low, high))
    return low, high, tuple(int(count) for count in counts)
