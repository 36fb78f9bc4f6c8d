"""Control points as VTK defines them, with midpoint and sharpness: those of ParaView and 3D Slicer.

Between two nodes, the parameter s goes from 0 to 1. The first node's midpoint m is where s = 1/2, linearly on both
sides. Its sharpness h is 0 for linear (below 0.01), 1 for a step at the midpoint (above 0.99); between, s is pressed
towards the middle by a power of 1 + 10 h and then follows a Hermite curve whose end slopes are 1 - h
(vtkPiecewiseFunction::GetTable, vtkColorTransferFunction::GetTable). Values outside take the end nodes' values.

At a value that two nodes share, VTK takes the first, clvol the second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.transfer.color import srgb_to_linear
from clvol.transfer.exchange.sampled import COLOR_ERROR, OPACITY_ERROR, Knots, at_most_two, straightened
from clvol.transfer.exchange.vtk_spaces import between

_LINEAR_BELOW, _STEP_ABOVE = 0.01, 0.99
_NEAREST_END = 1e-5  # of a midpoint to an end


@dataclass(frozen=True)
class Nodes:
    """``values`` [n], ``table`` [n, k] (opacities, or sRGB-encoded colours), ``midpoints`` and ``sharpnesses`` [n]."""

    values: np.ndarray
    table: np.ndarray
    midpoints: np.ndarray
    sharpnesses: np.ndarray

    @classmethod
    def plain(cls, values: np.ndarray, table: np.ndarray) -> Nodes:
        """Nodes that are linear between."""
        return cls(values, table, np.full(len(values), 0.5), np.zeros(len(values)))

    @classmethod
    def ordered(cls, rows: np.ndarray, width: int) -> Nodes:
        """Nodes from rows of value, ``width`` numbers and, where there are two more columns, midpoint and sharpness."""
        values, table = at_most_two(rows[:, 0], rows[:, 1:])
        if table.shape[1] == width:
            return cls.plain(values, table)
        return cls(values, table[:, :width], table[:, width], table[:, width + 1])


def opacity_knots(nodes: Nodes) -> Knots:
    """Points of an opacity curve [n, 1], linear between them, to within ``OPACITY_ERROR``."""
    values, rows = [], []
    for i in range(len(nodes.values) - 1):
        first, last = nodes.table[i], nodes.table[i + 1]

        def curve(u: np.ndarray, i: int = i, first: np.ndarray = first, last: np.ndarray = last) -> np.ndarray:
            return first + (last - first) * _weight(u, nodes.midpoints[i], nodes.sharpnesses[i])[:, None]

        at, table = _piece(nodes, i, curve, OPACITY_ERROR, colors=False)
        values.append(at)
        rows.append(table)
    return _joined(nodes, values, rows)


def color_knots(nodes: Nodes, space: str = "RGB", wrap: bool = True) -> Knots:
    """Points of a colour curve in linear light [n, 3], linear between them, to within ``COLOR_ERROR``.

    ``space`` is VTK's: "RGB", "HSV" (``wrap``: the shorter way around the hues), "Lab" or "Diverging".
    """
    values, rows = [], []
    for i in range(len(nodes.values) - 1):
        first, last = nodes.table[i], nodes.table[i + 1]

        def curve(u: np.ndarray, i: int = i, first: np.ndarray = first, last: np.ndarray = last) -> np.ndarray:
            # VTK has no Hermite curve for diverging maps.
            weight = _weight(u, nodes.midpoints[i], nodes.sharpnesses[i], hermite=space != "Diverging")
            return between(first, last, weight, space, wrap)

        at, table = _piece(nodes, i, curve, COLOR_ERROR, colors=True)
        values.append(at)
        rows.append(table)
    at, table = _joined(nodes, values, rows)
    return at, np.clip(srgb_to_linear(table), 0.0, 1.0)


def _piece(nodes: Nodes, i: int, curve, error: float, *, colors: bool) -> Knots:
    """The points of the piece from node ``i`` to the next, without its last one."""
    low, high = nodes.values[i], nodes.values[i + 1]
    if low == high:
        return nodes.values[i : i + 1], nodes.table[i : i + 1]
    middle = float(np.clip(nodes.midpoints[i], _NEAREST_END, 1.0 - _NEAREST_END))
    if nodes.sharpnesses[i] > _STEP_ABOVE:
        at = low + (high - low) * middle
        return np.array([low, at, at]), nodes.table[[i, i, i + 1]]
    breaks = np.unique([0.0, middle, 1.0])
    if nodes.sharpnesses[i] < _LINEAR_BELOW and middle == 0.5:
        breaks = np.array([0.0, 1.0])
    parameters = straightened(curve, breaks, error, colors)[:-1]
    table = curve(parameters)
    table[0] = nodes.table[i]
    return low + (high - low) * parameters, table


def _joined(nodes: Nodes, values: list[np.ndarray], rows: list[np.ndarray]) -> Knots:
    return at_most_two(
        np.concatenate([*values, nodes.values[-1:]]), np.concatenate([*rows, nodes.table[-1:]])
    )


def _weight(u: np.ndarray, midpoint: float, sharpness: float, hermite: bool = True) -> np.ndarray:
    """The share of the second node at ``u`` in [0, 1] between two nodes."""
    m = float(np.clip(midpoint, _NEAREST_END, 1.0 - _NEAREST_END))
    s = np.where(u < m, 0.5 * u / m, 0.5 + 0.5 * (u - m) / (1.0 - m))
    if sharpness > _STEP_ABOVE:
        return (s >= 0.5).astype(float)
    if sharpness < _LINEAR_BELOW:
        return s
    power = 1.0 + 10.0 * sharpness
    below, above = np.minimum(2.0 * s, 1.0), np.minimum(2.0 * (1.0 - s), 1.0)
    s = np.where(s < 0.5, 0.5 * below**power, 1.0 - 0.5 * above**power)
    if not hermite:
        return s
    smooth = s * s * (3.0 - 2.0 * s)
    return smooth + (1.0 - sharpness) * (s - smooth)
