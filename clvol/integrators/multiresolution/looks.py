"""How a value may look, where that depends on more than one transfer function: on the gradient, on the values of
further fields, on light that is emitted whatever is absorbed. Errors of blocks are those of the look that shows them
best, and a block hides what is behind it as little as in the look that hides least."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clvol.features.opacity import has_gradient_layers
from clvol.integrators.multiresolution.selection import SourceErrors, source_errors
from clvol.integrators.multiresolution.visible_error import ShownColors, spread_errors
from clvol.scene.glow import Glow
from clvol.scene.resolve import ResolvedScene
from clvol.store.source import BlockSource
from clvol.transfer import TransferFunction


@dataclass(frozen=True)
class Looks:
    """What of a scene changes how values look, beside its transfer function: further ``functions``; ``least_factor``,
    0 to 1: the least share of the extinction that opacity factors leave; whether the gradient decides between them;
    and ``glow``."""

    functions: tuple[TransferFunction, ...] = ()
    least_factor: float = 1.0
    by_gradient: bool = False
    glow: Glow | None = None

    def of(self, function: TransferFunction) -> list[TransferFunction]:
        """All functions with ``function`` as the scene's own, which is the first; with opacity factors each of them
        as strong, and as weak, as it can be."""
        strong = [function, *self.functions]
        if self.least_factor == 1.0:
            return strong
        return strong + [_weakened(each, self.least_factor) for each in strong]

    def shown(self, function: TransferFunction, path: float, background: np.ndarray) -> list[ShownColors]:
        """The colours of each after ``path`` (world) over ``background`` (linear [3])."""
        return [ShownColors(each, path, background, self.glow) for each in self.of(function)]

    def errors(self, source: BlockSource, function: TransferFunction, background: np.ndarray) -> SourceErrors:
        """The errors of ``source``, whatever the gradients and fields are."""
        first, *others = (source_errors(source, each, background, self.glow) for each in self.of(function))
        errors, dropped, transmittances = first.errors, first.dropped, first.transmittances
        for other in others:
            errors = np.maximum(errors, other.errors)
            dropped = dropped & other.dropped
            transmittances = np.maximum(transmittances, other.transmittances)
        if self.by_gradient:
            looks = self.shown(function, source.blocks.edge * source.grid.smallest_edge, background)
            for part in source.statistics():
                piece = slice(part.first, part.first + len(part.reach_low))
                errors[:, piece] += np.where(dropped[piece], np.float32(0.0), spread_errors(part, looks))
        return SourceErrors(errors, dropped, transmittances)


def looks_of(resolved: ResolvedScene) -> Looks:
    """``resolved``: reduced."""
    factors = [each for each in (resolved.gradient_opacity, resolved.directional_opacity) if each is not None]
    least = float(np.prod([factor.factors.min() for factor in factors])) if not resolved.fur else 0.0
    functions = tuple(layer.function for layer in resolved.transfer_layers)
    by_gradient = bool(factors) or bool(resolved.fur) or has_gradient_layers(resolved)
    return Looks(functions, least, by_gradient, resolved.glow)


def _weakened(function: TransferFunction, factor: float) -> TransferFunction:
    """``function`` with its extinction times ``factor``, between its points, too."""
    if not np.isfinite(function.opacity_unit / factor if factor else np.inf):
        return replace(function, opacities=np.zeros_like(function.opacities))
    return replace(function, opacity_unit=function.opacity_unit / factor)
