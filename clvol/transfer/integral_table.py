"""Tables of the integral functions of a transfer function: the fast approximation of pre-integration.

Engel, Kraus and Ertl (2001, section 3.2; Engel and Ertl 2002, section 8) leave attenuation inside a segment out: then a
segment is two differences of integral functions, T of the extinction and K of colour times extinction. Here both are
tabulated at even nodes and linear in between; ``cl/transfer_pieces.h`` takes the differences, exactly for such tables.
An interval between nodes of which the function shows a part shows as a whole.
"""

from __future__ import annotations

import numpy as np

from clvol.transfer.function import TransferFunction
from clvol.transfer.integrals import TransferIntegrals

OPAQUE = 40.0  # extinction per opacity unit that stands for an opacity of 1: differences need a finite one
HEAD = 2  # numbers before the entries: the first node's value, and entries per value


def _nodes(low: float, high: float, entries: int) -> np.ndarray:
    if not low < high:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, entries)


def integral_table(function: TransferFunction, low: float, high: float, entries: int, origin: float) -> np.ndarray:
    """float32 [HEAD + 4 entries]: the value of the first node, counted from ``origin``, entries per unit of the value,
    and per node (T, K red, K green, K blue) from ``low`` to ``high``, per opacity unit. Where there is one value alone
    the table spans one unit around it."""
    nodes = _nodes(low, high, entries)
    found = TransferIntegrals(function, OPAQUE).at(nodes)
    found -= found[:1]
    head = [nodes[0] - origin, (entries - 1) / (nodes[-1] - nodes[0])]
    return np.concatenate([head, found.ravel()]).astype(np.float32)


def tabulated_shape(function: TransferFunction, low: float, high: float, entries: int) -> TransferFunction:
    """A function with opacity where the table of ``function`` shows something: on all of an interval between nodes of
    which ``function`` shows a part, and a rounding beyond."""
    nodes = _nodes(low, high, entries)
    rises = np.diff(TransferIntegrals(function, OPAQUE).at(nodes)[:, 0]) > 0
    change = np.flatnonzero(np.diff(np.concatenate([[False], rises, [False]])))
    rounding = 1e-6 * max(abs(nodes[0]), abs(nodes[-1]), nodes[-1] - nodes[0])
    values, opacities = [nodes[0] - 1.0 - rounding], [0.0]
    for start, end in zip(change[::2], change[1::2]):
        begin, stop = max(nodes[start] - rounding, values[-1]), nodes[end] + rounding
        values += [begin, begin, stop, stop]
        opacities += [0.0, 0.5, 0.5, 0.0]
    kept = [k for k, x in enumerate(values) if k < 2 or not x == values[k - 1] == values[k - 2]]
    values, opacities = [values[k] for k in kept], [opacities[k] for k in kept]
    return TransferFunction(values, opacities, np.zeros((len(values), 3)), function.opacity_unit)
