"""Selection of one choice per block, such as a level and a depth of codes: the least error within a number of bytes.

The same problem as in selection.py, where bytes depend on the level alone; here every block has bytes of its own. The
upgrades along each block's lower convex hull of (bytes, error) are taken in order of error per byte while they fit, and
then, of those that follow, all that still fit: so what is left is less than the next upgrade of any block.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.integrators.multiresolution.selection import NEGLIGIBLE


@dataclass(frozen=True, eq=False)
class Chosen:
    """``choice`` intp [n]: the row of the sizes and errors. ``bytes`` of all, the sum of ``error``, and ``bound``: no
    choices within the bytes have less error than this."""

    choice: np.ndarray
    bytes: int
    error: float
    bound: float


def select_choices(errors: np.ndarray, sizes: np.ndarray, budget: int, negligible: float = NEGLIGIBLE) -> Chosen:
    """The choices of n blocks that make the best use of ``budget`` bytes.

    ``errors`` float [choices, n], finite, >= 0, weighted; ``sizes`` int [choices, n]. Errors up to ``negligible`` count
    as 0; once all are 0 no more bytes are spent. ValueError if not even the smallest choices fit.
    """
    errors = np.where(errors > negligible, errors, 0.0).astype(np.float64)
    sizes = np.asarray(sizes, np.int64)
    count = errors.shape[1]
    every = np.arange(count)
    smallest = sizes.min(axis=0)
    choice = np.where(sizes == smallest, errors, np.inf).argmin(axis=0)
    spare = int(budget) - int(smallest.sum())
    if spare < 0:
        raise ValueError(f"a budget of {budget} bytes, expected at least {int(smallest.sum())}")
    blocks, targets, steps, slopes = _upgrades(errors, sizes, choice)
    order = np.lexsort((blocks, -slopes))
    blocks, targets, steps, slopes = (each[order] for each in (blocks, targets, steps, slopes))
    taken = int(np.searchsorted(np.cumsum(steps), spare, side="right"))
    choice[blocks[:taken]] = targets[:taken]  # of each block the last one counts, its finest
    spare -= int(steps[:taken].sum())
    relaxed = float(errors[choice, every].sum()) - (spare * float(slopes[taken]) if taken < len(slopes) else 0.0)
    for k in range(taken, len(blocks)):  # a block's upgrades are in order, and from wherever it is now
        if spare <= 0:
            break
        block, target = blocks[k], targets[k]
        more = int(sizes[target, block] - sizes[choice[block], block])
        if more <= spare and errors[target, block] < errors[choice[block], block]:
            choice[block], spare = target, spare - more
    error = float(errors[choice, every].sum())
    return Chosen(choice, int(sizes[choice, every].sum()), error, min(max(relaxed, 0.0), error))


def _upgrades(errors: np.ndarray, sizes: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, ...]:
    """(block, choice, more bytes, error saved per byte) of the corners of every block's lower convex hull, from its
    choice ``start`` on; of each block in order, slopes that fall."""
    found: list[tuple[np.ndarray, ...]] = []
    blocks = np.arange(errors.shape[1])
    here = start.copy()
    last = np.full(len(blocks), np.inf)
    while len(blocks):
        more = sizes[:, blocks] - sizes[here, blocks]
        saved = errors[here, blocks] - errors[:, blocks]
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = np.where((more > 0) & (saved > 0), saved / more, 0.0)
        best = slopes.argmax(axis=0)
        steepest = np.minimum(slopes[best, np.arange(len(blocks))], last)  # falls, however it was rounded
        goes = steepest > 0
        blocks, best, steepest = blocks[goes], best[goes], steepest[goes]
        found.append((blocks, best, more[:, goes][best, np.arange(len(blocks))], steepest))
        here, last = best, steepest
    empty = np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0)
    return tuple(np.concatenate(parts) for parts in zip(empty, *found))
