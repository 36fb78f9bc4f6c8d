"""The opacity envelope of several transfer functions: one function that has opacity where any of them has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.transfer.cycle import joined, limits
from clvol.transfer.function import TransferFunction


def opacity_envelope(functions: Sequence[TransferFunction]) -> TransferFunction:
    """A function that has opacity exactly where one of ``functions`` has.

    Its control points are those of all of them, and its opacity there is the largest of theirs, linear in
    between. Its colours are those of the first one.
    """
    if len(functions) == 1:
        return functions[0]
    knots = np.unique(np.concatenate([function.values for function in functions]))
    points = np.empty((knots.size, 2, 4))
    for k, side in enumerate(("left", "right")):
        each = [limits(function, knots, side) for function in functions]
        points[:, k] = each[0]
        points[:, k, 0] = np.max([one[:, 0] for one in each], axis=0)
    values, rows = np.repeat(knots, 2), points.reshape(-1, 4)
    return joined(values, rows, functions[0].opacity_unit)
