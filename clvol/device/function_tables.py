"""The tables of a scene's transfer functions that cl/transfer_pieces.h looks up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.device.memory import ValueMap
from clvol.features.segments import has_integral_table
from clvol.features.values import reachable
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.transfer.integral_table import integral_table
from clvol.transfer.pieces import columns, piece_count, piece_table


def function_tables(
    resolved: ResolvedScene, functions: Sequence[TransferFunction], values: ValueMap, step: float, origin: float
) -> tuple[np.ndarray, tuple[int, int, int]]:
    """float32 [n]: the tables of ``functions`` (over the values that kernels compute with) one behind the other, with
    those of their integrals where the scene requests them; and columns, floats and pieces of each. ``step``: world
    length of a step; ``origin``: what kernels count values from."""
    width = max(columns(piece_count(function)) for function in functions)
    tables = [piece_table(each, step, width, origin).ravel() for each in functions]
    if has_integral_table(resolved.integration):
        low, high = (float(end) for end in values(np.array(reachable(resolved))))
        entries = resolved.integration.table_size
        integrals = [integral_table(each, low, high, entries, origin) for each in functions]
        tables = [np.concatenate(pair) for pair in zip(tables, integrals)]
    return np.concatenate(tables), (width, tables[0].size, max(map(piece_count, functions)))
