"""The pre-integrated segment in double precision: what the device-built table must hold.

For values that go linearly from s_front to s_back over a world length d (Engel and Ertl 2002,
section 8; with non-associated colour c and extinction tau):

    A = 1 - exp(-d int_0^1 tau(s(w)) dw),      s(w) = (1 - w) s_front + w s_back
    C = d int_0^1 c(s(w)) tau(s(w)) exp(-d int_0^w tau) dw

The path is cut at the control points. On a piece the opacity is linear, so with q = 1 - opacity the
optical depth has a closed form (below), and integration by parts leaves one smooth integral,

    C = c_a (1 - exp(-D)) + (c_b - c_a) int_0^1 (exp(-D(x)) - exp(-D)) dx.

Here this differs from the paper: no attenuation is neglected, and nothing is sampled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from clvol.transfer.function import TransferFunction

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS
_TOLERANCE = 1e-14
_OPAQUE_DEPTH = 40.0  # exp(-40) = 4e-18: nothing behind is visible
_DEEPEST_SPLIT = 60


def preintegrate(
    transfer_function: TransferFunction,
    s_front: ArrayLike,
    s_back: ArrayLike,
    length: ArrayLike,
) -> np.ndarray:
    """Premultiplied linear RGBA, float64 [..., 4], of segments, with an absolute error of about 1e-13.

    ``s_front``, ``s_back`` and ``length`` (world units, >= 0) are broadcast to [...]. A stretch of opacity 1 is fully
    opaque: a segment ends there, in the front colour of that stretch. Steps of the transfer function are integrated
    as steps; a segment of a single value takes the later of two points with that value. Segments with a NaN or
    infinite value are transparent.
    """
    s_front, s_back, length = np.broadcast_arrays(
        *(np.asarray(given, dtype=np.float64) for given in (s_front, s_back, length))
    )
    shape = s_front.shape
    s_front, s_back, length = s_front.ravel(), s_back.ravel(), length.ravel()
    light = _Light(np.zeros((s_front.size, 3)), np.zeros(s_front.size))
    seen = np.isfinite(s_front) & np.isfinite(s_back) & (length > 0)
    for chosen, path in (
        (seen & (s_front == s_back), _constant_path),
        (seen & (s_front < s_back), _rising_path),
        (seen & (s_front > s_back), _falling_path),
    ):
        rows = np.flatnonzero(chosen)
        if rows.size:
            path(transfer_function, s_front[rows], s_back[rows], length[rows], rows, light)
    alpha = -np.expm1(-light.depth)
    return np.concatenate([light.color, alpha[:, None]], axis=1).reshape(*shape, 4)


@dataclass
class _Light:
    """The colour gathered and the optical depth passed so far, front to back, one row per segment."""

    color: np.ndarray
    depth: np.ndarray


def _constant_path(tf, s_front, s_back, length, rows, light) -> None:
    opacity, color = tf.opacity(s_front), tf.color(s_front)
    _add_pieces(rows, light, opacity, opacity, 1.0 - opacity, 1.0 - opacity, color, color,
                length / tf.opacity_unit)


def _rising_path(tf, s_front, s_back, length, rows, light) -> None:
    for region in range(tf.values.size + 1):
        _add_region(tf, region, s_front, s_back, length, rows, light)


def _falling_path(tf, s_front, s_back, length, rows, light) -> None:
    for region in range(tf.values.size, -1, -1):
        _add_region(tf, region, s_front, s_back, length, rows, light)


def _add_region(tf, region, s_front, s_back, length, rows, light) -> None:
    """Adds the part of each path between control points region - 1 and region."""
    values, last = tf.values, tf.values.size - 1
    lower = values[region - 1] if region > 0 else -np.inf
    upper = values[region] if region <= last else np.inf
    if not lower < upper:
        return
    near, far = max(region - 1, 0), min(region, last)
    if tf.opacities[near] == 0.0 and tf.opacities[far] == 0.0:
        return
    s_a, s_b = np.clip(s_front, lower, upper), np.clip(s_back, lower, upper)
    # Halves, since the difference of two finite values may overflow.
    share = (0.5 * s_b - 0.5 * s_a) / (0.5 * s_back - 0.5 * s_front)
    inside = np.flatnonzero(share > 0)
    if not inside.size:
        return
    s_a, s_b = s_a[inside], s_b[inside]
    if region == 0 or region > last:
        place_a = place_b = np.zeros(inside.size)
    else:
        gap = 0.5 * upper - 0.5 * lower
        place_a, place_b = (np.clip((0.5 * s - 0.5 * lower) / gap, 0, 1) for s in (s_a, s_b))
    opacity, color = tf.opacities, tf.colors

    def mix(table, place):
        place = place if table.ndim == 1 else place[:, None]
        return table[near] * (1.0 - place) + table[far] * place

    _add_pieces(
        rows[inside],
        light,
        mix(opacity, place_a),
        mix(opacity, place_b),
        mix(1.0 - opacity, place_a),
        mix(1.0 - opacity, place_b),
        mix(color, place_a),
        mix(color, place_b),
        share[inside] * (length[inside] / tf.opacity_unit),
    )


def _add_pieces(rows, light, alpha_a, alpha_b, q_a, q_b, color_a, color_b, amount) -> None:
    """Adds pieces of linear opacity and colour; ``amount`` is their length in opacity units."""
    left = np.exp(-light.depth[rows])[:, None]
    opaque = (q_a == 0) & (q_b == 0)
    depth = np.full(rows.size, np.inf)
    clear = ~opaque
    pieces = tuple(array[clear] for array in (alpha_a, alpha_b, q_a, q_b, amount))
    depth[clear] = _depth(1.0, *pieces)
    moment = np.zeros(rows.size)
    changing = clear & np.any(color_a != color_b, axis=1) & (depth > 0)
    pieces = tuple(array[changing] for array in (alpha_a, alpha_b, q_a, q_b, amount))
    moment[changing] = _moment(depth[changing], *pieces)
    shown = color_a * -np.expm1(-depth)[:, None] + (color_b - color_a) * moment[:, None]
    light.color[rows] += left * shown
    light.depth[rows] += depth


def _depth(x, alpha_a, alpha_b, q_a, q_b, amount):
    """Optical depth of the first share ``x`` of a piece, exact to a few ulps.

    The mean of -log q over q_a ... q_x is -log m - g(r), with the mean value m = (q_a + q_x) / 2,
    r = (q_x - q_a) / (q_x + q_a) and
    g(r) = ((1 + r) log(1 + r) - (1 - r) log(1 - r)) / (2 r) - 1 = -sum_k r^(2k) / (2k (2k + 1)).
    """
    alpha_x = alpha_a * (1.0 - x) + alpha_b * x
    q_x = q_a * (1.0 - x) + q_b * x
    alpha_m, q_m = 0.5 * (alpha_a + alpha_x), 0.5 * (q_a + q_x)
    with np.errstate(divide="ignore"):
        minus_log = np.where(alpha_m < 0.5, -np.log1p(-np.minimum(alpha_m, 0.5)), -np.log(q_m))
    # At large q the difference of opacities is the exact one, at small q that of the q.
    r = np.where(alpha_m < 0.5, alpha_a - alpha_x, q_x - q_a) / (q_x + q_a)
    return amount * x * (minus_log - _log_spread(np.clip(r, -1.0, 1.0)))


def _log_spread(r):
    """g(r) of ``_depth``, <= 0, on [-1, 1]."""
    square = r * r
    series = np.zeros_like(r)
    for k in range(9, 0, -1):  # 0.1^20 / 420 is below an ulp of the first term
        series = square * (series + 1.0 / (2 * k * (2 * k + 1)))
    up, down = np.log1p(np.maximum(r, -0.999999)), np.log1p(np.maximum(-r, -0.999999))
    plus, minus = 1.0 + r, 1.0 - r  # (1 + r) log(1 + r) vanishes at r = -1
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.where(r < -0.99, np.log(plus), up)
        down = np.where(r > 0.99, np.log(minus), down)
        up, down = np.where(plus > 0, plus * up, 0.0), np.where(minus > 0, minus * down, 0.0)
        closed = (up - down) / (2.0 * r) - 1.0
    return np.where(np.abs(r) < 0.1, -series, closed)


def _moment(total, *piece):
    """int_0^1 (exp(-D(x)) - exp(-D(1))) dx, by Gauss-Legendre on intervals halved as needed."""
    end = _visible_share(total, *piece)
    result = np.zeros(total.size)
    row = np.arange(total.size)
    a, b = np.zeros(total.size), end.copy()
    whole = _panel(a, b, total, piece, row)
    for _ in range(_DEEPEST_SPLIT):
        if not row.size:
            break
        middle = 0.5 * (a + b)
        left, right = _panel(a, middle, total, piece, row), _panel(middle, b, total, piece, row)
        rough = np.abs(left + right - whole) > _TOLERANCE
        np.add.at(result, row[~rough], (left + right)[~rough])
        row = np.concatenate([row[rough], row[rough]])
        a, b = np.concatenate([a[rough], middle[rough]]), np.concatenate([middle[rough], b[rough]])
        whole = np.concatenate([left[rough], right[rough]])
    np.add.at(result, row, whole)
    return result


def _panel(a, b, total, piece, row):
    x = a[:, None] + (b - a)[:, None] * _NODES
    depth = _depth(x, *(array[row][:, None] for array in piece))
    return (b - a) * ((np.expm1(-depth) - np.expm1(-total[row])[:, None]) @ _WEIGHTS)


def _visible_share(total, *piece):
    """The share of each piece that is visible: nothing behind it contributes. It is 1 if the whole piece does."""
    low, high = np.zeros(total.size), np.ones(total.size)
    deep = np.flatnonzero(total > _OPAQUE_DEPTH)
    some = tuple(array[deep] for array in piece)
    # In steps of 1/4 first, so that shares of 1e-12 are found as precisely as shares of 1/2.
    share = np.ones(deep.size)
    for _ in range(600):
        over = _depth(0.25 * share, *some) > _OPAQUE_DEPTH
        if not over.any():
            break
        share = np.where(over, 0.25 * share, share)
    low[deep], high[deep] = 0.25 * share, share
    for _ in range(40):
        middle = 0.5 * (low[deep] + high[deep])
        over = _depth(middle, *some) > _OPAQUE_DEPTH
        high[deep] = np.where(over, middle, high[deep])
        low[deep] = np.where(over, low[deep], middle)
    return high
