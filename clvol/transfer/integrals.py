"""Integral functions of a transfer function: of the extinction, and of colour times extinction, up to a value.

With them a segment along which the value runs linearly from a to b is a difference, whatever lies between (Engel, Kraus
and Ertl 2001, section 3.2): its optical depth is that of the mean extinction (K(b) - K(a)) / (b - a), and its colour
(C(b) - C(a)) / (K(b) - K(a)), if attenuation inside the segment is left out. Both are closed forms on each piece, so
neither has nodes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from clvol.transfer.function import TransferFunction
from clvol.transfer.pieces import depth_and_moment

_NARROW = 1e-7  # of what the values are: below it a difference of integrals has lost too many digits


class TransferIntegrals:
    """The integral functions of ``function`` per opacity unit, in double precision.

    ``opaque``: the extinction that stands for an opacity of 1 (a finite one, since differences are taken). An
    opacity that reaches 1 in a slope is integrated as it is.
    """

    def __init__(self, function: TransferFunction, opaque: float) -> None:
        self.function, self.opaque = function, opaque
        values, opacities, colors = function.values, function.opacities, function.colors
        self._length = values[1:] - values[:-1]
        whole = self._pieces(np.arange(values.size - 1), opacities[1:], colors[1:], self._length)
        self._before = np.concatenate([np.zeros((1, 4)), np.cumsum(whole, axis=0)])

    def _pieces(self, piece: np.ndarray, opacity: np.ndarray, color: np.ndarray, length: np.ndarray) -> np.ndarray:
        """Integrals [..., 4] from the beginning of ``piece`` to where it has ``opacity`` and ``color``."""
        first, start = self.function.opacities[piece], self.function.colors[piece]
        depth, moment = depth_and_moment(first, opacity)
        moment = np.where(depth > self.opaque, 0.0, moment)
        depth = np.minimum(depth, self.opaque)
        middle, change = 0.5 * (start + color), color - start
        light = middle * depth[..., None] - change * moment[..., None]
        return np.concatenate([depth[..., None], light], axis=-1) * length[..., None]

    def extinction(self, s: ArrayLike) -> np.ndarray:
        """Extinction per opacity unit, and colour times it, at values ``s`` [...]: float64 [..., 4]."""
        s = np.asarray(s, np.float64)
        opacity, color = self.function.opacity_and_color(s)
        with np.errstate(divide="ignore"):
            tau = np.minimum(-np.log1p(-opacity), self.opaque)
        return np.concatenate([tau[..., None], color * tau[..., None]], axis=-1)

    def at(self, s: ArrayLike) -> np.ndarray:
        """The integrals from the first control point to values ``s`` [...], which are finite: float64 [..., 4]."""
        s = np.asarray(s, np.float64)
        values = self.function.values
        inside = np.clip(s, values[0], values[-1])
        outside = inside != s
        beyond = np.zeros((*s.shape, 4))
        beyond[outside] = self.extinction(inside[outside]) * (s - inside)[outside][..., None]
        if values.size == 1:
            return beyond
        piece = np.clip(np.searchsorted(values, inside, side="right") - 1, 0, values.size - 2)
        # Of a step the first point holds up to it; a piece without length adds nothing.
        length = self._length[piece]
        share = np.where(length > 0, (inside - values[piece]) / np.where(length > 0, length, 1.0), 0.0)
        opacity = self.function.opacities[piece] * (1.0 - share) + self.function.opacities[piece + 1] * share
        first, last = self.function.colors[piece], self.function.colors[piece + 1]
        color = first + (last - first) * share[..., None]
        return self._before[piece] + self._pieces(piece, opacity, color, inside - values[piece]) + beyond

    def mean(self, front: np.ndarray, back: np.ndarray) -> np.ndarray:
        """Mean extinction per opacity unit, and mean of colour times it, while the value runs linearly from ``front``
        to ``back`` [...]: float64 [..., 4]."""
        return self._mean(front, back, self.at(front), self.at(back))

    def mean_along(self, values: np.ndarray) -> np.ndarray:
        """``mean`` from each of ``values`` [..., n] to the next: float64 [..., n - 1, 4]."""
        integrals = self.at(values)
        return self._mean(values[..., :-1], values[..., 1:], integrals[..., :-1, :], integrals[..., 1:, :])

    def _mean(self, front: np.ndarray, back: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        change = back - front
        narrow = np.abs(change) <= _NARROW * (np.abs(front) + np.abs(back)) + 1e-300
        difference = (last - first) / np.where(narrow, 1.0, change)[..., None]
        return np.where(narrow[..., None], self.extinction(0.5 * (front + back)), np.maximum(difference, 0.0))
