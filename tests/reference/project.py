"""The other ways of putting a ray together: extremes and the mean of its values."""

from __future__ import annotations

import numpy as np

from reference.medium import Medium


class Projection:
    """Gathers values along n rays under ``integration.compositing``, then classifies one of each.

    Values that are not finite, and what a mask removes, do not count.
    """

    def __init__(self, mode: str, attenuation: float, medium: Medium, count: int) -> None:
        self.mode, self.attenuation, self.medium = mode, attenuation, medium
        lower, upper = medium.grid.index_bounds()
        self.longest = float(((upper - lower) * medium.grid.spacing).max())
        self.value = np.full(count, np.nan)  # the extreme, or the sum times length
        self.best = np.full(count, -np.inf)  # what was compared
        self.factor = np.ones(count)
        self.passed = np.zeros(count)  # the integral of the normalised value so far
        self.length = np.zeros(count)

    def add(self, rays: np.ndarray, start: np.ndarray, end: np.ndarray) -> None:
        """The next segments, from ``start`` to ``end`` [m, 3], of the rays numbered ``rays``."""
        value = self.medium.value(0.5 * (start + end))
        length = np.linalg.norm(end - start, axis=1) * self.medium.kept_share(start, end)
        counts = np.isfinite(value) & (length > 0)
        rays, value, length = rays[counts], value[counts], length[counts]
        if self.mode == "average":
            self.value[rays] = np.nan_to_num(self.value[rays]) + value * length
            self.length[rays] += length
            return
        factor = np.ones(len(rays))
        score = -value if self.mode == "minimum" else value
        if self.mode == "attenuated-maximum":
            low, high = self.medium.value_range
            share = (value - low) / (high - low) if high > low else np.zeros_like(value)
            share = np.maximum(share, 0.0)  # noise leads beyond the range: nothing shines less
            factor = np.exp(-self.attenuation * self.passed[rays] / self.longest)
            score = share * factor
            self.passed[rays] += share * length
        better = score > self.best[rays]
        rays = rays[better]
        self.best[rays], self.value[rays] = score[better], value[better]
        self.factor[rays] = factor[better]

    def rgba(self) -> np.ndarray:
        """[n, 4], premultiplied; 0 for rays without a sample."""
        value = self.value
        if self.mode == "average":
            value = value / np.where(self.length > 0, self.length, 1.0)
        function = self.medium.functions[0]
        alpha = np.where(np.isnan(value), 0.0, function.opacity(value) * self.factor)
        return np.column_stack([function.color(value) * alpha[:, None], alpha])
