"""Grids from the coordinates of axes, as in netCDF, HDF5 and Zarr."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.readers.options import ReadOptions
from clvol.volume.grid import Grid
from clvol.volume.units import one_unit

_EVEN = 1e-3  # tolerance of coordinates, as a share of a step


def even_step(values: np.ndarray, name: str, options: ReadOptions) -> tuple[float, float] | None:
    """Step and first of evenly spaced coordinates; None, with a warning, for others, and for fewer than two."""
    if len(values) < 2:
        return None
    values = np.asarray(values, np.float64)
    step = float(values[-1] - values[0]) / (len(values) - 1)
    off = np.abs(values - (values[0] + step * np.arange(len(values)))).max()
    if not np.isfinite(off) or step == 0.0 or off > _EVEN * abs(step):
        options.warn(f"coordinates along {name} are not evenly spaced and are not used")
        return None
    return step, float(values[0])


def grid_of(
    shape: Sequence[int],
    scale: Sequence[float],
    shift: Sequence[float],
    units: Sequence[str | None],
    options: ReadOptions,
) -> tuple[Grid, str | None]:
    """The grid and its unit; ``scale``, ``shift`` and ``units`` are along z, y, x."""
    factors, unit, wrong = one_unit(units[::-1], [n > 1 for n in shape[::-1]])
    if wrong:
        options.warn(wrong)
    steps, origin = np.array(scale[::-1]) * factors, np.array(shift[::-1]) * factors
    return Grid.from_steps(tuple(shape), np.diag(steps), origin.tolist()), unit
