"""Which effects a scene calls for, and why; and what will therefore be compiled.

One vocabulary in Python and in cl/features.h (a test compares them). What has no effect on the
image is not called for: it is neither compiled nor paid for. Nothing here needs a device.

Each effect, or a few that belong together, is a module with a function ``analyse``, a pass over the
scene: it notes its effects with reasons and takes out of the scene what has no consequence.
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
