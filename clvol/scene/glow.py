"""Associated colours: light that is emitted independently of opacity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.transfer import TransferFunction


@dataclass(frozen=True, eq=False)
class Glow:
    """``light`` float64 [n, 3]: linear light per world length that the volume emits at ``values`` (float64 [n],
    ascending; of two at one value the later one holds there), linear in between and constant beyond the ends.
    ``factor``: that of the colours which it was made from."""

    values: np.ndarray
    light: np.ndarray
    factor: float = 1.0

    @property
    def shape(self) -> TransferFunction:
        """A function with opacity exactly where there is light: by it what is visible is told from what is empty."""
        brightest = self.light.max(axis=1)
        largest = max(float(brightest.max()), 1e-300)
        opacities = np.where(brightest > 0, np.clip(0.5 * brightest / largest, 1e-6, 0.5), 0.0)
        return TransferFunction(self.values, opacities, np.zeros((len(self.values), 3)))


def with_glow(function: TransferFunction, factor: float) -> tuple[TransferFunction, Glow]:
    """``function``, whose colours are associated, as one that only absorbs, and the light of its colours: ``factor``
    times the colour over the length of an opacity unit."""
    light = function.colors * (factor / function.opacity_unit)
    light.setflags(write=False)
    black = TransferFunction(function.values, function.opacities, np.zeros_like(function.colors), function.opacity_unit)
    return black, Glow(function.values, light, factor)
