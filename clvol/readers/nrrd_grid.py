"""The axes of a NRRD file (in space, of channels, of times), and the grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.nrrd_header import NrrdHeader
from clvol.readers.options import Key, ReadOptions
from clvol.volume.grid import Grid
from clvol.volume.units import one_unit

# Kinds of axes in space.
_IN_SPACE = ("domain", "space")
_UNKNOWN = ("none", "???")
_COMPONENTS = {
    "rgb-color": ("red", "green", "blue"),
    "rgba-color": ("red", "green", "blue", "alpha"),
    "hsv-color": ("hue", "saturation", "value"),
    "complex": ("real", "imaginary"),
}


@dataclass(frozen=True)
class Axes:
    """``sizes`` of all axes, fastest first. ``spatial``: the indices of the axes x, y and z. ``others``: for each
    other axis its index, whether it holds channels or times, and its kind.
    """

    sizes: tuple[int, ...]
    spatial: tuple[int, int, int]
    others: tuple[tuple[int, Key, str], ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(nz, ny, nx)."""
        x, y, z = self.spatial
        return self.sizes[z], self.sizes[y], self.sizes[x]

    def choose(self, path: Path, options: ReadOptions) -> tuple[int | slice, ...]:
        """The index of the chosen volume in the array, slowest axis first."""
        which: list[int | slice] = [slice(None)] * len(self.sizes)
        for axis, key, kind in self.others:
            names: Sequence[str | None] = _COMPONENTS.get(kind, ())
            if len(names) != self.sizes[axis]:
                names = [None] * self.sizes[axis]
            which[len(self.sizes) - 1 - axis] = options.choose(key, str(path), names)
        return tuple(which)


def axes_of(path: Path, header: NrrdHeader) -> Axes:
    """The axes: those with a direction or a kind in space are spatial. VolumeError unless there are three of them."""
    sizes = tuple(int(n) for n in header.get("sizes"))
    dimension = header.get("dimension")
    if dimension != len(sizes):
        raise VolumeError(
            str(path), f"dimension {dimension} with {len(sizes)} sizes", "as many sizes"
        )
    said = " ".join(map(str, sizes))
    if min(sizes) < 1:
        raise VolumeError(str(path), f"sizes {said}", "sizes of at least 1")
    shown = header.get("kinds", ())
    kinds = [kind.lower() for kind in shown] if len(shown) == len(sizes) else ["???"] * len(sizes)
    others = _others(header, kinds, sizes)
    spatial = [k for k in range(len(sizes)) if k not in others]
    times = [k for k in others if kinds[k] == "time"]
    if len(spatial) != 3 or len(times) > 1 or len(others) - len(times) > 1:
        strange = [kind for kind in shown if kind.lower() not in (*_IN_SPACE, *_UNKNOWN)]
        note = f" with an axis of kind {', '.join(strange)}" if strange else ""
        raise VolumeError(
            str(path),
            f"{len(sizes)}-D data{note}, sizes {said}",
            "three axes in space, and by their kinds one of channels or times at most",
        )
    x, y, z = spatial
    return Axes(sizes, (x, y, z), tuple((k, "time" if k in times else "channel", kinds[k]) for k in others))


def _others(header: NrrdHeader, kinds: list[str], sizes: tuple[int, ...]) -> list[int]:
    """The axes that are not in space, as far as the header says."""
    others = [k for k, kind in enumerate(kinds) if kind not in (*_IN_SPACE, *_UNKNOWN)]
    directions = header.get("space directions")
    if directions is not None and not others and len(sizes) > 3:
        rows = np.asarray(directions, np.float64)
        if len(rows) == len(sizes):
            others = [k for k, row in enumerate(rows) if np.isnan(row).all()]
    if not others and len(sizes) > 3 and sum(kind in _IN_SPACE for kind in kinds) == 3:
        others = [k for k, kind in enumerate(kinds) if kind not in _IN_SPACE]
    return others


def grid_of(
    path: Path, axes: Axes, header: NrrdHeader, options: ReadOptions
) -> tuple[Grid, str | None]:
    """The grid, and the unit of its lengths; None if the header does not state it."""
    shape, spatial = axes.shape, list(axes.spatial)
    origin = _numbers(path, header, "space origin", 3)
    directions = header.get("space directions")
    if directions is not None:
        rows = np.asarray(directions, dtype=np.float64)
        if rows.shape != (len(axes.sizes), 3) or np.isnan(rows[spatial]).any(axis=1).any():
            raise VolumeError(str(path), "an axis without a space direction", "three directions")
        factors, unit = _unit(header.get("space units", ()), (2, 2, 2), options)  # world axes are always used
        origin = np.zeros(3) if origin is None else origin
        return Grid.from_steps(shape, (rows[spatial] * factors).T, origin * factors), unit

    def of_axes(name: str) -> np.ndarray | None:
        numbers = _numbers(path, header, name, len(axes.sizes))
        return None if numbers is None else numbers[spatial]

    sizes = np.asarray(shape[::-1], dtype=np.float64)
    centerings = header.get("centerings", ())
    centerings = centerings if len(centerings) == len(axes.sizes) else ["cell"] * len(axes.sizes)
    cell = np.array([centerings[k] != "node" for k in spatial])
    lower, upper, steps = of_axes("axis mins"), of_axes("axis maxs"), of_axes("spacings")
    if steps is None and lower is not None and upper is not None:
        steps = (upper - lower) / np.maximum(np.where(cell, sizes, sizes - 1.0), 1.0)
    # In this format NaN means that a spacing is unknown.
    steps = np.ones(3) if steps is None else np.where(np.isnan(steps), 1.0, steps)
    if origin is None and lower is not None:
        known = np.where(np.isnan(lower), 0.0, lower)
        origin = known + np.where(np.isnan(lower) | ~cell, 0.0, 0.5 * steps)
    units = header.get("units", ())
    units = [units[k] for k in spatial] if len(units) == len(axes.sizes) else ()
    factors, unit = _unit(units, shape[::-1], options)
    origin = np.zeros(3) if origin is None else origin
    return Grid.from_steps(shape, np.diag(steps * factors), origin * factors), unit


def _numbers(path: Path, header: NrrdHeader, name: str, count: int) -> np.ndarray | None:
    """The numbers of a field, float64; None if it does not exist."""
    value = header.get(name)
    if value is None:
        return None
    numbers = np.asarray(value, np.float64)
    if numbers.shape != (count,):
        raise VolumeError(str(path), f"{name} of {numbers.size} numbers", f"{count} numbers")
    return numbers


def _unit(
    names: Sequence[str], sizes: tuple[int, int, int], options: ReadOptions
) -> tuple[np.ndarray, str | None]:
    """Factors that convert lengths along the three axes to one unit, and that unit."""
    if len(names) != 3:
        return np.ones(3), None
    factors, unit, wrong = one_unit(names, [n > 1 for n in sizes])
    if wrong is not None:
        options.warn(wrong)
    return np.asarray(factors, np.float64), unit
