"""Segments by tabulated integral functions, in double precision."""

from __future__ import annotations

import numpy as np

from clvol.features.values import reachable
from clvol.transfer.integral_table import OPAQUE


class IntegralTable:
    """The integral functions of a scene's transfer function, by sums of small parts, at the nodes it asks for."""

    PARTS = 64  # of an interval

    def __init__(self, resolved) -> None:
        function, entries = resolved.transfer_function, resolved.integration.table_size
        ends = reachable(resolved)
        self.nodes, self.unit = np.linspace(*ends, entries), function.opacity_unit
        step = (ends[1] - ends[0]) / (entries - 1)
        middles = self.nodes[:-1, None] + step * (np.arange(self.PARTS) + 0.5) / self.PARTS
        with np.errstate(divide="ignore"):
            tau = np.minimum(-np.log1p(-function.opacity(middles)), OPAQUE)
        rates = np.concatenate([tau[..., None], tau[..., None] * function.color(middles)], axis=-1).mean(axis=1)
        self.rates = rates  # of each interval
        self.sums = np.concatenate([np.zeros((1, 4)), np.cumsum(rates * step, axis=0)])

    def of_chord(self, front, back, length) -> tuple[np.ndarray, np.ndarray]:
        """(colour [n, 3], optical depth [n]) of segments: colour times opacity is light that nothing has attenuated."""
        known = np.isfinite(front) & np.isfinite(back)
        front, back = (np.where(known, each, self.nodes[0]) for each in (front, back))
        low, high = np.clip(np.minimum(front, back), *self.nodes[[0, -1]]), np.maximum(front, back)
        high = np.clip(high, *self.nodes[[0, -1]])
        interval = np.clip(np.searchsorted(self.nodes, low, side="right") - 1, 0, len(self.rates) - 1)
        ends = [np.stack([np.interp(at, self.nodes, each) for each in self.sums.T], axis=-1) for at in (low, high)]
        whole = ends[1] - ends[0]
        narrow = high - low < 1e-9 * np.ptp(self.nodes)
        mean = np.where(narrow[:, None], self.rates[interval], whole / np.where(narrow, 1.0, high - low)[:, None])
        amount = np.where(known, length / self.unit, 0.0)
        depth = mean[:, 0] * amount
        opacity = -np.expm1(-depth)
        light = mean[:, 1:] * amount[:, None]
        return light / np.where(opacity > 0, opacity, 1.0)[:, None], depth
