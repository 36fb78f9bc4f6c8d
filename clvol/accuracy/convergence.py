"""Observed order of accuracy: how fast an error falls under refinement, compared with theory.

Verification by convergence (Etiene, Jönsson, Ropinski, Scheidegger, Comba, Nonato, Kirby, Ynnerman,
Silva: "Verifying volume rendering using discretization error analysis", IEEE TVCG 20(1), 2014): a
method whose error is C h^p + O(h^(p+1)) must show order p when h is refined. A wrong weight, a sample
that is half a step off or a missing term lowers p long before a picture looks wrong. An order above
theory means that the comparison or the theory does not apply to the method that was run.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.errors import UsageError

FEWEST_LEVELS = 4
FLOOR_MARGIN = 4.0  # errors below this many times the floor do not show the order
LOCAL_BANDS = 3.0  # a single refinement may deviate this many times as far as the fit


@dataclass(frozen=True)
class Convergence:
    """Errors under refinement.

    ``h`` (> 0, falling: step, voxel edge, pixel edge, ...) and ``errors`` (> 0) have one value per level, for at
    least FEWEST_LEVELS levels. ``floor``: the error that would remain at h = 0 (rounding, tables, ...).

    Raises UsageError for any other numbers.
    """

    h: tuple[float, ...]
    errors: tuple[float, ...]
    floor: float = 0.0

    def __post_init__(self) -> None:
        for name in ("h", "errors"):
            values = tuple(float(v) for v in getattr(self, name))
            object.__setattr__(self, name, values)
            if not all(np.isfinite(v) and v > 0 for v in values):
                raise UsageError(name, f"got {values}", "finite numbers greater than 0")
        if len(self.h) != len(self.errors) or len(self.h) < FEWEST_LEVELS:
            got = f"got {len(self.h)} and {len(self.errors)}"
            raise UsageError("h, errors", got, f"equally many of both, at least {FEWEST_LEVELS}")
        if any(fine >= coarse for coarse, fine in zip(self.h, self.h[1:])):
            raise UsageError("h", f"got {self.h}", "falling numbers")
        if not (np.isfinite(self.floor) and self.floor >= 0):
            raise UsageError("floor", f"got {self.floor!r}", "a finite number, at least 0")

    @property
    def order(self) -> float:
        """The slope of log(error) over log(h), fitted by least squares."""
        slope, _ = np.polyfit(np.log(self.h), np.log(self.errors), 1)
        return float(slope)

    @property
    def local_orders(self) -> tuple[float, ...]:
        """The order between each two successive levels."""
        return tuple((np.diff(np.log(self.errors)) / np.diff(np.log(self.h))).tolist())

    def departure(self, expected: float, band: float) -> str | None:
        """Says what contradicts order ``expected`` within ``band``; None if nothing does.

        The errors must be well above the floor, the fit must lie in the band, and no single refinement may deviate by
        more than LOCAL_BANDS bands, because a fit to orders that vary between levels proves nothing.
        """
        finest = min(self.errors)
        if finest < FLOOR_MARGIN * self.floor:
            return f"least error {finest:.2e} does not stand clear of the floor {self.floor:.2e}"
        if not abs(self.order - expected) <= band:
            return f"observed order {self.order:.2f}, expected {expected:g} within {band:g}"
        wide = LOCAL_BANDS * band
        for order, coarse, fine in zip(self.local_orders, self.h, self.h[1:]):
            if not abs(order - expected) <= wide:
                where = f"from h = {coarse:.3g} to {fine:.3g}"
                return f"order {order:.2f} {where}, expected {expected:g} within {wide:g}"
        return None
