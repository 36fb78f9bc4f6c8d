"""The plain twin of cl/reference.cl: one ray, one short function after the other, slow and obvious.

Only tests use it. It finds the pieces with polynomial roots and integrates them with scipy's
adaptive quadrature, one inside the other; it shares nothing with the kernel but the definition.
"""

from __future__ import annotations

import numpy as np

from clvol.transfer import TransferFunction


def integrate_ray(
    voxels: np.ndarray,
    transfer_function: TransferFunction,
    origin: np.ndarray,
    direction: np.ndarray,
    *,
    filter: str = "linear",
    classification: str = "post",
) -> tuple[np.ndarray, float]:
    """(premultiplied rgba [4], depth) of the ray origin + t direction, t >= 0.

    ``voxels`` [z, y, x]. ``origin`` [3] is an index (x, y, z), ``direction`` [3] the change of
    index per world length. ``depth`` is where the opacity reaches one half, inf if nowhere.
    """
    from scipy.integrate import quad, quad_vec
    from scipy.optimize import brentq

    tf = transfer_function
    origin, direction = np.asarray(origin, float), np.asarray(direction, float)
    color, optical_depth, median = np.zeros(3), 0.0, np.inf
    for start, end in _cells(voxels, origin, direction, filter):
        corners, weights = _cell(voxels, origin, direction, start, end, filter)
        if corners is None:
            continue
        for a, b in _pieces(corners, weights, tf, start, end, classification):
            middle = 0.5 * (a + b)
            if np.all(_opacity(corners, weights, tf, np.array([middle]), classification) == 1.0):
                front = _color(corners, weights, tf, a + 1e-12 * (b - a), classification)
                color += np.exp(-optical_depth) * front
                return np.append(color, 1.0), min(median, a)

            def tau(t):
                return _extinction(corners, weights, tf, t, classification)

            def depth(t):
                return quad(tau, a, t, epsabs=1e-14, epsrel=1e-13, limit=200)[0]

            def emission(t):
                tau_t = tau(t)
                c = _color(corners, weights, tf, t, classification) if tau_t > 0 else np.zeros(3)
                return c * tau_t * np.exp(-depth(t))

            piece = depth(b)
            if piece == 0.0:
                continue
            light = quad_vec(emission, a, b, epsabs=1e-12, epsrel=1e-12)[0]
            color += np.exp(-optical_depth) * light
            left = np.log(2.0) - optical_depth
            if np.isinf(median) and piece >= left:
                median = brentq(lambda t: depth(t) - left, a, b, xtol=1e-14) if piece > left else b
            optical_depth += piece
    return np.append(color, -np.expm1(-optical_depth)), median


def _cells(voxels, origin, direction, filter):
    """The stretches (t start, t end) of the ray, cut wherever it enters another cell."""
    start, end, cuts = 0.0, np.inf, []
    for axis, n in enumerate(voxels.shape[::-1]):
        lower, upper = (0.0, n - 1.0) if n > 1 else (-0.5, 0.5)
        if direction[axis] == 0.0:
            if not lower <= origin[axis] <= upper:
                return
            continue
        ends = sorted((np.array([lower, upper]) - origin[axis]) / direction[axis])
        start, end = max(start, ends[0]), min(end, ends[1])
        planes = np.arange(n) + 0.5 if filter == "nearest" else np.arange(n)
        if n > 1:
            cuts.extend((planes - origin[axis]) / direction[axis])
    if start < end:
        ts = [start, *sorted(t for t in cuts if start < t < end), end]
        yield from ((a, b) for a, b in zip(ts, ts[1:]) if b > a)


def _cell(voxels, origin, direction, start, end, filter):
    """Values [k] of the voxels that the stretch uses, and a function t -> their weights [k].

    None instead of the values where one of them is not finite.
    """
    middle = origin + 0.5 * (start + end) * direction
    size = np.array(voxels.shape[::-1])
    if filter == "nearest":
        x, y, z = np.clip(np.floor(middle + 0.5), 0, size - 1).astype(int)
        value = float(voxels[z, y, x])
        return (np.array([value]) if np.isfinite(value) else None), lambda t: np.ones(1)
    base = np.clip(np.floor(middle), 0, np.maximum(size - 2, 0)).astype(int)
    taps = (-1, 0, 1, 2) if filter == "cubic" else (0, 1)
    axis_weights = _spline_weights if filter == "cubic" else _linear_weights

    def all_weights(t):
        u = np.where(size > 1, origin + t * direction - base, 0.0)
        x, y, z = (axis_weights(u[axis]) for axis in range(3))
        return np.array([a * b * c for c in z for b in y for a in x])

    used = all_weights(0.5 * (start + end)) != 0.0
    values = np.array([
        float(voxels[tuple(np.clip(base[::-1] + (k, j, i), 0, size[::-1] - 1))])
        for k in taps for j in taps for i in taps
    ])[used]
    return (values if np.all(np.isfinite(values)) else None), lambda t: all_weights(t)[used]


def _linear_weights(u):
    return 1.0 - u, u


def _spline_weights(u):
    """Of the voxels -1, 0, 1, 2 at a place u = 0 ... 1: the uniform cubic B-spline."""
    v = 1.0 - u
    return v**3 / 6, 2 / 3 - u * u * (2 - u) / 2, 2 / 3 - v * v * (2 - v) / 2, u**3 / 6


def _pieces(values, weights, tf, start, end, classification):
    """Cuts a stretch where its value crosses a control point."""
    cuts = []
    if classification != "pre" and np.ptp(values) > 0:
        degree = 9 if len(values) > 8 else 3
        x = 0.5 - 0.5 * np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
        samples = [weights(start + u * (end - start)) @ values for u in x]
        field = np.polynomial.Chebyshev.fit(x, samples, degree, domain=[0, 1])
        for value in tf.values:
            roots = (field - value).roots()
            cuts.extend(roots[np.abs(roots.imag) < 1e-9].real)
    us = [0.0, *sorted(u for u in cuts if 0.0 < u < 1.0), 1.0]
    ts = [start + u * (end - start) for u in us]
    return [(a, b) for a, b in zip(ts, ts[1:]) if b - a > 1e-13 * (end - start)]


def _value(values, weights, t):
    # Clipping keeps a constant cell exactly constant, which a step in the function may need.
    return float(np.clip(weights(t) @ values, values.min(), values.max()))


def _opacity(values, weights, tf, ts, classification):
    if classification == "pre":
        return np.where(np.any(tf.opacity(values) == 1.0), 1.0, 0.0)
    return tf.opacity(np.array([_value(values, weights, t) for t in ts]))


def _extinction(values, weights, tf, t, classification):
    if classification == "pre":
        return float(weights(t) @ tf.extinction(values))
    # An end of a piece may touch opacity 1, where the extinction is infinite but integrable.
    return min(float(tf.extinction(_value(values, weights, t))), 700.0 / tf.opacity_unit)


def _color(values, weights, tf, t, classification):
    if classification == "pre":
        tau = tf.extinction(values)
        tau = np.where(np.isinf(tau), 1.0, 0.0) if np.isinf(tau).any() else tau
        shares = weights(t) * tau
        return shares @ tf.color(values) / shares.sum()
    return tf.color(_value(values, weights, t))
