"""From values to what a segment looks like: its mean colour and its optical depth."""

from __future__ import annotations

import numpy as np

from clvol.transfer import TransferFunction

OPAQUE = 1e30  # the optical depth of what has opacity 1: finite, so that 0 times it is 0
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


class MovedFunction:
    """A transfer function whose colours move over the volume's range, wrapping; its opacity stays.

    ``shift``: cycle times time, in ranges; None without a cycle. A value has the colour of value' = low
    + mod(value - low + shift range, range); whole ranges leave those within the range as they are.
    """

    def __init__(
        self,
        function: TransferFunction,
        value_range: tuple[float, float] = (0.0, 0.0),
        shift: float | None = None,
    ) -> None:
        self.function = function
        self.low, self.high = value_range
        self.span = self.high - self.low
        self.cycles = shift is not None and self.span > 0
        self.shift = shift % 1.0 * self.span if self.cycles else 0.0

    def color(self, values: np.ndarray) -> np.ndarray:
        """Linear colour [..., 3] of values [...]."""
        if self.cycles:
            stays = (values >= self.low) & (values <= self.high) & (self.shift == 0.0)
            moved = self.low + np.mod(values - self.low + self.shift, self.span)
            values = np.where(stays, values, moved)
        return self.function.color(values)

    def opacity(self, values: np.ndarray) -> np.ndarray:
        """Opacity [...] of one opacity unit of values [...]; 0 for NaN."""
        return self.function.opacity(values)

    def extinction(self, values: np.ndarray) -> np.ndarray:
        """Extinction per world length, finite."""
        return np.minimum(self.function.extinction(values), OPAQUE)

    def breaks(self) -> np.ndarray:
        """The values where the function may have a kink or a step, ascending."""
        values = self.function.values
        if not self.cycles:
            return np.unique(values)
        lap = np.append(values[(values >= self.low) & (values <= self.high)], self.low)
        moved = [lap - self.shift + k * self.span for k in range(-2, 4)]
        return np.unique(np.concatenate([*moved, values]))


def of_value(function, values: np.ndarray, length: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(colour [n, 3], optical depth [n]) of ``length`` [n] of constant ``values`` [n]."""
    return function.color(values), np.minimum(function.extinction(values) * length, OPAQUE)


def of_chord(
    function, front: np.ndarray, back: np.ndarray, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(mean colour [n, 3], optical depth [n]): see ``placed_chord``."""
    return placed_chord(function, front, back, length)[:2]


def placed_chord(
    function, front: np.ndarray, back: np.ndarray, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(mean colour [n, 3], optical depth [n], mean place [n] of what is seen, 0 to 1) of segments whose value
    runs linearly, front to back.

    The colour is int c tau exp(-int tau) over 1 - exp(-int tau). In a piece between two breaks of
    the function opacity and colour are linear, a to b, and with x = 0 ... 1 along it
    T(x) = -units int log(1 - alpha), A = 1 - exp(-T), int c dA = c_b A(1) - (c_b - c_a) int A dx.
    """
    finite = np.isfinite(front) & np.isfinite(back)
    front, back = np.where(finite, front, 0.0), np.where(finite, back, 0.0)
    n = len(front)
    cuts = np.zeros((n, 1))
    span = back - front
    flat = np.abs(span) <= 1e-12 * np.maximum(np.abs(front), np.abs(back))
    breaks = function.breaks()
    if breaks.size:
        x = (breaks - front[:, None]) / np.where(flat, 1.0, span)[:, None]
        cuts = np.sort(np.clip(np.where(flat[:, None], 0.0, x), 0.0, 1.0), axis=1)
    cuts = np.concatenate([np.zeros((n, 1)), cuts, np.ones((n, 1))], axis=1)
    depth, light, place = np.zeros(n), np.zeros((n, 3)), np.zeros(n)
    for x0, x1 in zip(cuts.T, cuts.T[1:]):
        there = x1 > x0
        x0, x1, at, along = x0[there], x1[there], front[there], span[there]
        units = (x1 - x0) * length[there] / function.function.opacity_unit
        ends = _linear_ends(function, at + x0 * along, at + x1 * along)
        piece_light, piece_depth, piece_at = _linear_piece(*ends, units)
        seen = np.exp(-depth[there]) * -np.expm1(-piece_depth)
        place[there] += seen * (x0 + piece_at * (x1 - x0))
        light[there] += np.exp(-depth[there])[:, None] * piece_light
        depth[there] = np.minimum(depth[there] + piece_depth, OPAQUE)
    opacity = -np.expm1(-depth)
    # Of what is almost transparent the colour is the front's: the quotient has no digits.
    mean = light / np.maximum(opacity, 1e-300)[:, None]
    color = np.where((opacity > 0)[:, None], mean, function.color(front))
    place = np.where(opacity > 0, place / np.maximum(opacity, 1e-300), 0.5)
    return np.where(finite[:, None], color, 0.0), np.where(finite, depth, 0.0), place


def _linear_ends(function, start, end):
    """Opacity and colour at both ends of a piece, as seen from inside (an end may be a step)."""
    quarter, other = start + 0.25 * (end - start), start + 0.75 * (end - start)

    def extrapolated(at_quarter, at_other):
        first = np.clip(1.5 * at_quarter - 0.5 * at_other, 0.0, 1.0)
        last = np.clip(1.5 * at_other - 0.5 * at_quarter, 0.0, 1.0)
        return first, last

    alphas = extrapolated(function.opacity(quarter), function.opacity(other))
    colors = extrapolated(function.color(quarter), function.color(other))
    return (*alphas, *colors)


def _linear_piece(a, b, color_a, color_b, units):
    """(light [n, 3], optical depth [n], mean place [n] of what is seen) of pieces of linear opacity and colour."""

    whole = np.minimum(units * _mean_depth(a, b), OPAQUE)
    thin = (whole < 1.0) & (np.maximum(a, b) < 0.9)
    mean_opacity = np.zeros_like(a)
    # Halved towards the front, where all of an opaque piece happens, and towards both ends, where
    # the depth has a logarithm if the opacity comes to 1.
    halved = 2.0 ** np.arange(-20.0, 0.0)
    halved = np.concatenate([[0.0], halved, 1.0 - halved[-2::-1], [1.0]])
    for part, edges in ((thin, np.array([0.0, 1.0])), (~thin, halved)):
        if part.any():
            width = np.diff(edges)[:, None]
            x = (edges[:-1, None] + _NODES * width).reshape(-1, 1)
            a_, b_ = np.broadcast_arrays(a[part], a[part] + x * (b[part] - a[part]))
            depth = np.minimum(units[part] * x * _mean_depth(a_, b_), OPAQUE)
            mean_opacity[part] = (width * _WEIGHTS).ravel() @ -np.expm1(-depth)
    opacity = -np.expm1(-whole)
    light = color_b * opacity[:, None] - (color_b - color_a) * mean_opacity[:, None]
    at = np.where(opacity > 0, 1.0 - mean_opacity / np.maximum(opacity, 1e-300), 0.5)
    return light, whole, at


def _mean_depth(a, b):
    """Mean of -log(1 - alpha) while alpha runs linearly from a to b."""
    qa, qb = 1.0 - a, 1.0 - b
    near = np.abs(qa - qb) <= 0.1 * (qa + qb)
    far, mean = ~near, np.zeros_like(a)
    q_log_q = [q * np.log(np.where(q > 0, q, 1.0)) for q in (qa[far], qb[far])]
    mean[far] = 1.0 - (q_log_q[0] - q_log_q[1]) / (qa[far] - qb[far])
    a, b = a[near], b[near]
    with np.errstate(divide="ignore"):
        mean[near] = sum(-w * np.log1p(-(a + x * (b - a))) for x, w in zip(_NODES, _WEIGHTS))
    return np.minimum(mean, OPAQUE)


def of_voxels(
    function, voxels: np.ndarray, weights: np.ndarray, length: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same where the filter's voxels [n, k] are classified, then weighted ("pre")."""
    tau = function.extinction(voxels)
    emission = function.color(voxels) * tau[..., None]
    # Negative weights (Catmull-Rom) may leave less than no medium and no light.
    extinction = np.maximum(np.sum(weights * tau, axis=1), 0.0)
    emission = np.maximum(np.sum(weights[..., None] * emission, axis=1), 0.0)
    used = np.any((weights != 0) & ~np.isfinite(voxels), axis=1)
    seen = (extinction > 0) & ~used
    color = np.where(seen[:, None], emission / np.where(seen, extinction, 1.0)[:, None], 0.0)
    return color, np.where(seen, np.minimum(extinction * length, OPAQUE), 0.0)


def curvature_shift(
    before: np.ndarray, front: np.ndarray, back: np.ndarray, length: np.ndarray, filter: str
) -> tuple[np.ndarray, np.ndarray]:
    """The chord of a segment, shifted so that its mean is that of the parabola through the values.

    ``before`` is the value one step before the front, ``length`` the segment's in steps; the shift
    is -s'' length^2 / 12, and the ends stay within the three values.
    """
    if filter == "nearest":
        return front, back
    slope_change = (back - front) / length - (front - before)
    shift = -slope_change * 2.0 / (1.0 + length) * length**2 / 12.0
    good = np.isfinite(shift)
    low = np.minimum(np.minimum(before, front), back)
    high = np.maximum(np.maximum(before, front), back)
    with np.errstate(invalid="ignore"):
        shifted = [np.clip(v + shift, low, high) for v in (front, back)]
    return np.where(good, shifted[0], front), np.where(good, shifted[1], back)


def combined(parts) -> tuple[np.ndarray, np.ndarray]:
    """Extinctions and emissions added up: ``parts`` of (colour [n, 3], optical depth [n])."""
    depth = np.minimum(sum(d for _, d in parts), OPAQUE)
    light = sum(c * d[:, None] for c, d in parts)
    color = light / np.where(depth > 0, depth, 1.0)[:, None]
    return np.where((depth > 0)[:, None], color, parts[0][0]), depth


def layer_weights(magnitude: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Weights [n, layers] of the layers ``at`` ascending magnitudes; the last one holds above."""
    m = np.clip(magnitude, at[0], at[-1])
    high = np.clip(np.searchsorted(at, m, side="right"), 1, len(at) - 1) if len(at) > 1 else None
    weights = np.zeros((len(m), len(at)))
    rows = np.arange(len(m))
    if high is None:
        weights[:, 0] = 1.0
        return weights
    f = (m - at[high - 1]) / (at[high] - at[high - 1])
    weights[rows, high - 1] = 1.0 - f
    weights[rows, high] = f
    return weights
