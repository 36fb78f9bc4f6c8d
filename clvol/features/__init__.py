"""The effects that a scene needs, with reasons, and therefore what is compiled.

Python and cl/features.h share one vocabulary (a test compares them). Settings without a consequence for the image are
neither compiled nor paid for. No device is needed.

Each effect, or a group of related ones, is a module with a function ``analyse``: a pass over the scene that notes its
effects with reasons, and removes everything without a consequence from the scene.
"""

from __future__ import annotations

from clvol.features.analysis import NAMES, called_for, effects, reduced, reduced_for_frames
from clvol.features.effect import Effect
from clvol.features.findings import emits
from clvol.features.lighting import NEUTRAL, is_lit
from clvol.features.vocabulary import (
    CLASSIFICATIONS,
    COMPOSITINGS,
    FILTER_REACH,
    FILTERS,
    GRADIENTS,
    ORACLES,
    QUADRATURES,
    SLICES,
    STEPPINGS,
    overshoot,
)

__all__ = [
    "CLASSIFICATIONS",
    "COMPOSITINGS",
    "FILTERS",
    "FILTER_REACH",
    "GRADIENTS",
    "NAMES",
    "NEUTRAL",
    "ORACLES",
    "QUADRATURES",
    "SLICES",
    "STEPPINGS",
    "Effect",
    "called_for",
    "effects",
    "emits",
    "is_lit",
    "overshoot",
    "reduced",
    "reduced_for_frames",
]
