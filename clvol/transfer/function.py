"""The transfer function: opacity and colour, linear between control points.

Opacity is what a path of world length ``opacity_unit`` through a constant value absorbs, so the
extinction is tau(s) = -log(1 - opacity(s)) / opacity_unit, and a picture does not depend on the
step, the spacing or the resolution that it was made with.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.errors import SceneError
from clvol.transfer.color import srgb_to_linear
from clvol.transfer.color_names import parse_color
from clvol.transfer.exchange import OpacityCurve, load_colormap, load_imported, save_function

_WHERE = "transfer_function"


@dataclass(frozen=True, eq=False, init=False)
class TransferFunction:
    """Control points of opacity and colour over the volume's values.

    ``values`` [n]: finite, ascending; two points may share a value, which makes a step: exactly at
    the shared value the later point holds. ``opacities`` [n] in [0, 1]. ``colors`` [n, 3] in
    [0, 1], linear light, not multiplied by opacity; a row may be a colour's name or "#rrggbb".
    ``opacity_unit``: world length > 0 that the opacities are stated for. Values outside the points
    take the end points' opacity and colour; NaN has opacity 0 and the first point's colour. All
    arrays are float64 and read-only.

    Raises SceneError if the points are none, unsorted, out of range or of unequal number.
    """

    values: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    opacity_unit: float = 1.0

    def __init__(
        self, values: ArrayLike, opacities: ArrayLike, colors: ArrayLike, opacity_unit: float = 1.0
    ) -> None:
        for name, given in (("values", values), ("opacities", opacities), ("colors", _without_names(colors))):
            object.__setattr__(self, name, _frozen(name, given))
        n = self.values.size
        if self.values.ndim != 1 or n < 1:
            raise _wrong("values", f"shape {self.values.shape}", "at least one control point")
        if self.opacities.shape != (n,):
            raise _wrong("opacities", f"shape {self.opacities.shape}", f"shape ({n},), as values")
        if self.colors.shape != (n, 3):
            raise _wrong("colors", f"shape {self.colors.shape}", f"shape ({n}, 3)")
        step = np.flatnonzero(self.values[1:] < self.values[:-1])
        if step.size:
            i = int(step[0])
            got = f"{self.values[i + 1]!s} after {self.values[i]!s}"
            raise _wrong(f"values.{i + 1}", got, "ascending values")
        if n > 2 and np.any(self.values[2:] == self.values[:-2]):
            i = int(np.flatnonzero(self.values[2:] == self.values[:-2])[0])
            got = f"{self.values[i]!s} three times"
            raise _wrong(f"values.{i + 2}", got, "at most two points at one value")
        for name in ("opacities", "colors"):
            array = getattr(self, name)
            bad = np.argwhere((array < 0) | (array > 1))
            if bad.size:
                at = tuple(int(i) for i in bad[0])
                where = ".".join([name, *map(str, at)])
                raise _wrong(where, f"{array[at]!s}", "a number from 0 to 1")
        try:
            unit = float(opacity_unit)
        except (TypeError, ValueError):
            unit = float("nan")
        if not 0.0 < unit < float("inf"):
            raise _wrong("opacity_unit", f"{opacity_unit!r}", "a finite length > 0")
        object.__setattr__(self, "opacity_unit", unit)

    @classmethod
    def from_colormap(
        cls,
        colormap: Any,
        value_range: Sequence[float],
        opacity: OpacityCurve | None = None,
        opacity_unit: float = 1.0,
    ) -> TransferFunction:
        """The colours of a colour map over ``value_range`` (low, high).

        ``colormap`` is a name ("viridis", "colorcet:fire", "cmap:crameri:batlow") or a Colormap object of matplotlib or
        cmap. ``opacity`` is a list of opacities, evenly spaced over the range, or of pairs [position from 0 to 1,
        opacity]; by default it rises from 0 to 0.5. Colours are right to within a level of 8 bits. Raises SceneError.
        """
        return cls(*load_colormap(colormap).points(value_range, opacity, opacity_unit))

    @classmethod
    def from_file(
        cls,
        path: str | os.PathLike,
        value_range: Sequence[float] | None = None,
        opacity: OpacityCurve | None = None,
        opacity_unit: float = 1.0,
        entry: str | None = None,
    ) -> TransferFunction:
        """The transfer function in a file of another tool: ``transfer/exchange/files.py`` lists them.

        The values are the file's own, or moved to ``value_range``, which files without values need. ``opacity``, as for
        ``from_colormap``, takes the place of the file's opacities. ``opacity_unit`` holds where the file states none.
        ``entry`` names one of several presets. Raises SceneError.
        """
        return cls(*load_imported(path, entry).points(value_range, opacity, opacity_unit))

    def save(self, path: str | os.PathLike, name: str | None = None) -> None:
        """Writes the function for ParaView (.json) or 3D Slicer (.vp, .vp.json; .ctbl for a table of labels).

        ``name`` is the preset's, by default that of the file. Raises SceneError, UsageError.
        """
        save_function(self, path, name)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TransferFunction):
            return NotImplemented
        return (
            self.opacity_unit == other.opacity_unit
            and np.array_equal(self.values, other.values)
            and np.array_equal(self.opacities, other.opacities)
            and np.array_equal(self.colors, other.colors)
        )

    def __hash__(self) -> int:
        parts = (self.values, self.opacities, self.colors)
        return hash((self.opacity_unit, *(array.tobytes() for array in parts)))

    def opacity(self, s: ArrayLike) -> np.ndarray:
        """Opacity in [0, 1] for values ``s`` (any shape), float64 of the same shape; 0 for NaN."""
        s = np.asarray(s, dtype=np.float64)
        return np.where(np.isnan(s), 0.0, _between(self.values, self.opacities[:, None], s)[..., 0])

    def color(self, s: ArrayLike) -> np.ndarray:
        """Linear colour in [0, 1] for values ``s`` (any shape), float64 ``s.shape + (3,)``."""
        return _between(self.values, self.colors, np.asarray(s, dtype=np.float64))

    def opacity_and_color(self, s: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """``opacity`` and ``color`` of values ``s``, for less than the time of both."""
        s = np.asarray(s, dtype=np.float64)
        both = _between(self.values, np.concatenate([self.opacities[:, None], self.colors], axis=1), s)
        return np.where(np.isnan(s), 0.0, both[..., 0]), both[..., 1:]

    def extinction(self, s: ArrayLike) -> np.ndarray:
        """Extinction per world length for values ``s``, float64; infinite where opacity is 1."""
        with np.errstate(divide="ignore", over="ignore"):
            tau = -np.log1p(-self.opacity(s)) / self.opacity_unit
        return tau + 0.0  # -log1p(-0) is -0


def _without_names(colors: Any) -> Any:
    """``colors`` with names of colours as linear light."""
    if isinstance(colors, np.ndarray) and colors.dtype.kind not in "UO":
        return colors
    try:
        rows = list(colors)
    except TypeError:
        return colors
    for i, row in enumerate(rows):
        if isinstance(row, str):
            try:
                rows[i] = srgb_to_linear(parse_color(row))
            except ValueError as error:
                raise _wrong(f"colors.{i}", repr(row), str(error)) from None
    return rows


def _frozen(name: str, given: ArrayLike) -> np.ndarray:
    """A read-only float64 copy of ``given``; SceneError unless it holds finite numbers."""
    try:
        array = np.array(given, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise _wrong(name, f"{type(given).__name__}", "an array of numbers") from None
    if not np.isfinite(array).all():
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise _wrong(".".join([name, *map(str, at)]), f"{array[at]!s}", "a finite number")
    array.setflags(write=False)
    return array


def _wrong(key: str, got: str, expected: str) -> SceneError:
    return SceneError(f"{_WHERE}: {key}", f"got {got}", expected)


def _between(values: np.ndarray, table: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Linear interpolation of ``table`` [n, k] at ``s`` [...] -> [..., k], steps from the right."""
    last = values.size - 1
    right = np.searchsorted(values, s, side="right")  # points at or below s; NaN sorts last
    low = np.clip(right - 1, 0, last)
    high = np.minimum(low + 1, last)
    # Halves, since the difference of two finite values may overflow.
    half = 0.5 * values
    below = half[low]
    span = half[high] - below
    inside = (right > 0) & (right <= last) & (span > 0)
    with np.errstate(invalid="ignore", over="ignore"):
        t = np.where(inside, (0.5 * s - below) / np.where(span > 0, span, 1.0), 0.0)
    t = np.clip(t, 0.0, 1.0)
    first, second = table[low], table[high]
    mixed = first * (1.0 - t)[..., None]
    mixed += second * t[..., None]
    mixed = np.clip(mixed, np.minimum(first, second), np.maximum(first, second), out=mixed)
    unknown = np.isnan(s)
    return np.where(unknown[..., None], table[0], mixed) if unknown.any() else mixed
