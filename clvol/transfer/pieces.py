"""The transfer function as linear pieces with their integrals: what cl/transfer_pieces.h looks up.

On a piece 1 - opacity runs linearly from q0 to q1. With m their mean and r = (q1 - q0) / (q1 + q0), the mean of
-log(1 - opacity) is -log m + S(r), and its first moment about the middle, over lengths of the piece, is -M(r):

    S(r) = 1 - ((1 + r) log(1 + r) - (1 - r) log(1 - r)) / (2 r)
    M(r) = (r - (1 - r^2) / 2 (log(1 + r) - log(1 - r))) / (4 r^2)

Both are finite where one end has opacity 1.
"""

from __future__ import annotations

import logging

import numpy as np

from clvol.transfer.function import TransferFunction

_log = logging.getLogger(__name__)
IN_HALF_REGISTERS = 8  # pieces that a register of 256 bits holds: the least TRANSFER_PIECES
IN_REGISTERS = 16  # and one of 512: the least number of columns
MOST_IN_REGISTERS = 256  # and in several of them: the largest one
ROWS = 27
OPAQUE_DEPTH = 1e15  # of cl/stretch.h
SPANS = 4  # of values in which something shows: those of `View` in cl/view.h
(BEGIN, END, INVERSE, OPACITY, OPACITY_CHANGE, COLOR, COLOR_CHANGE, LENGTH, DEPTH, MOMENT, DEPTHS, COLORS,
 NEXT_OPAQUE, LAST_OPAQUE, UNITS, FROM, TO, CLEAR, CLEAR_CHANGE, ORIGIN, SIXTEENTH) = (
    0, 1, 2, 3, 4, 5, 8, 11, 12, 13, 14, 15, 18, 19, 20, 21, 22, 23, 24, 25, 26
)  # fmt: skip


def piece_count(function: TransferFunction) -> int:
    """The number of pieces of ``function``: between its control points, and one beyond either end."""
    values = function.values
    return int(np.count_nonzero(values[1:] > values[:-1])) + 2


def columns(count: int) -> int:
    """The number of columns of a table of ``count`` pieces: a power of two, since pieces are found by bisection."""
    return max(IN_REGISTERS, 1 << (count - 1).bit_length())


def register_pieces(count: int) -> int:
    """TRANSFER_PIECES of a function of ``count`` pieces: the least number that packets tell apart in registers, and not
    below ``count``; 0 where there is none."""
    width = columns(count) if count > IN_HALF_REGISTERS else IN_HALF_REGISTERS
    return width if width <= MOST_IN_REGISTERS else 0


def piece_table(
    function: TransferFunction, step: float, width: int | None = None, origin: float = 0.0
) -> np.ndarray:
    """The pieces of ``function``, ascending by value: float32 [ROWS, columns].

    ``step`` is the world length of a step, ``origin`` the float32 from which kernels count values, and ``width`` the
    number of columns, at least ``columns(piece_count(function))``. Columns after the last piece begin at infinity,
    and are therefore never looked up.
    """
    count = piece_count(function)
    width = width or columns(count)
    _log.info("transfer function of %d pieces, table of %d bytes", count, 4 * ROWS * width)
    table = np.zeros((ROWS, width))
    table[BEGIN] = np.inf
    values, opacities, colors = function.values - origin, function.opacities, function.colors
    has_length = np.flatnonzero(function.values[1:] > function.values[:-1])
    # The function is constant below the first control point and above the last one.
    low = np.concatenate([[0], has_length, [values.size - 1]])
    high = np.concatenate([[0], has_length + 1, [values.size - 1]])
    piece = slice(0, count)
    table[BEGIN, piece], table[END, piece] = values[low], values[high]
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        length = values[high] - values[low]
        begin, end = (table[row, piece].astype(np.float32) for row in (BEGIN, END))
        float_length = (end - begin).astype(np.float64)
        inverse = np.where(float_length > 0, 1.0 / np.where(float_length > 0, float_length, 1.0), 0.0)
    table[LENGTH, piece] = length
    table[INVERSE, piece] = np.minimum(inverse, 3e38)
    table[OPACITY, piece] = opacities[low]
    table[OPACITY_CHANGE, piece] = opacities[high] - opacities[low]
    table[CLEAR, piece] = 1.0 - opacities[low]
    table[CLEAR_CHANGE, piece] = opacities[low] - opacities[high]
    table[COLOR : COLOR + 3, piece] = colors[low].T
    table[COLOR_CHANGE : COLOR_CHANGE + 3, piece] = (colors[high] - colors[low]).T
    depth, moment = depth_and_moment(opacities[low], opacities[high])
    table[DEPTH, piece] = depth
    table[MOMENT, piece] = moment / np.maximum(depth, 1e-300)
    opaque = depth >= OPAQUE_DEPTH
    counted = np.where(opaque, 0.0, depth) * length
    middle = 0.5 * (colors[low] + colors[high]) * counted[:, None]
    sums = middle - (colors[high] - colors[low]) * np.where(opaque, 0.0, moment * length)[:, None]
    before = np.zeros((4, width))
    before[0, 1 : count + 1] = np.cumsum(counted)[: width - 1]
    before[1:, 1 : count + 1] = np.cumsum(sums, axis=0)[: width - 1].T
    table[DEPTHS : DEPTHS + 4] = before
    index = np.arange(count)
    after = np.minimum.accumulate(np.where(opaque, index, width)[::-1])[::-1]
    table[NEXT_OPAQUE] = width
    table[NEXT_OPAQUE, piece] = after
    table[LAST_OPAQUE] = -1
    table[LAST_OPAQUE, piece] = np.maximum.accumulate(np.where(opaque, index, -1))
    table[UNITS] = step / function.opacity_unit
    table[ORIGIN] = origin
    table[SIXTEENTH, :16] = table[BEGIN, :: width // 16]
    table[FROM], table[TO] = table[BEGIN], table[END]
    table[FROM, 0], table[TO, count - 1] = -np.inf, np.inf
    with np.errstate(over="ignore", under="ignore"):
        return np.where(np.isinf(table), table, np.clip(table, -3e38, 3e38)).astype(np.float32)


def depth_and_moment(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mean of -log(1 - opacity) while the opacity runs linearly from ``first`` to ``second``, at most
    OPAQUE_DEPTH, and M(r) as defined above: float64 arrays of their shape.
    """
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    mean = 0.5 * (first + second)
    clear = 0.5 * ((1.0 - first) + (1.0 - second))
    opaque = clear <= 0.0
    r = np.clip(0.5 * (first - second) / np.where(opaque, 1.0, clear), -1.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        up, down = np.log1p(r), np.log1p(-r)
        up_part = np.where(r > -1.0, (1.0 + r) * up, 0.0)
        down_part = np.where(r < 1.0, (1.0 - r) * down, 0.0)
        spread = 1.0 - (up_part - down_part) / (2.0 * r)
        rest = np.where(np.abs(r) < 1.0, (1.0 - r * r) * (up - down), 0.0)
        moment = (r - 0.5 * rest) / (4.0 * r * r)
        depth = np.where(mean < 0.5, -np.log1p(-np.minimum(mean, 0.5)), -np.log(clear))
    small = np.abs(r) < 0.1
    if small.any():
        square, of_spread, of_moment = r * r, np.zeros_like(r), np.zeros_like(r)
        for k in range(8, 0, -1):
            of_spread = of_spread * square + 1.0 / (2 * k * (2 * k + 1))
            of_moment = of_moment * square + 1.0 / (2 * (2 * k - 1) * (2 * k + 1))
        spread = np.where(small, of_spread * square, spread)
        moment = np.where(small, of_moment * r, moment)
    depth = np.where(opaque, OPAQUE_DEPTH, np.minimum(depth + spread, OPAQUE_DEPTH))
    return depth, np.where(opaque, 0.0, moment)


def has_opaque_point(function: TransferFunction) -> bool:
    """Whether the extinction is unbounded next to where it is infinite, because the opacity reaches 1 in a slope.
    Classification by single samples must not sample such a function.
    """
    values, opacities = function.values, function.opacities
    slopes = (values[1:] > values[:-1]) & (opacities[1:] != opacities[:-1])
    return bool(np.any(slopes & (np.maximum(opacities[1:], opacities[:-1]) >= 1.0)))


def value_gate(function: TransferFunction) -> tuple[float, float]:
    """(low, high) in float32: nothing has opacity if all values are <= low, or all are >= high."""
    above, below = shown_spans(function)
    return float(above.min()), float(below.max())


def shown_spans(function: TransferFunction) -> tuple[np.ndarray, np.ndarray]:
    """(above, below), float32 [SPANS] each: nothing has opacity between two values if for each k both are
    <= above[k], or both are >= below[k]. Of a function that shows in more spans those nearest to each other are one;
    of one that shows in fewer the rest are empty, from infinity to minus infinity.
    """
    values, shows = function.values, function.opacities > 0
    above, below = np.full(SPANS, np.inf, np.float32), np.full(SPANS, -np.inf, np.float32)
    if not shows.any():
        return above, below
    change = np.flatnonzero(np.diff(np.concatenate([[False], shows, [False]])))
    first, last = change[::2], change[1::2] - 1  # of each run of points that show
    width = values[first[1:] - 1] - values[last[:-1] + 1]  # of what is transparent between two runs
    widest = np.argsort(-width, kind="stable")[: SPANS - 1]
    gaps = np.sort(widest[width[widest] > 0])
    for k, (start, end) in enumerate(zip(first[np.append(0, gaps + 1)], last[np.append(gaps, len(last) - 1)])):
        above[k], below[k] = _just_below(function, start), _just_above(function, end)
    return above, below


def _just_below(function: TransferFunction, first: int) -> np.float32:
    """The largest float32 at and below which the run of points that show from ``first`` on has no opacity."""
    if first == 0:
        return np.float32(-np.inf)
    value = function.values[first - 1]
    low = np.float32(value)
    # At a step the later point holds; a knot that float32 cannot represent is ignored.
    if low > value or value == function.values[first]:
        low = np.nextafter(low, np.float32(-np.inf))
    return low


def _just_above(function: TransferFunction, last: int) -> np.float32:
    """The smallest float32 at and above which the run of points that show up to ``last`` has no opacity."""
    if last + 1 == function.values.size:
        return np.float32(np.inf)
    value = function.values[last + 1]
    high = np.float32(value)
    if high < value:
        high = np.nextafter(high, np.float32(np.inf))
    return high
