"""Where a field without noise takes iso-values along rays: the roots of its polynomial in each cell."""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from reference.surfaces import Crossings, crossings, in_order

_DEGREES = {"linear": 3, "cubic": 9, "catmull-rom": 9}
_OTHER = 24  # of kernels that are no polynomials: to within rounding
_BISECTIONS = 60
_AT_START = 1e-9  # world length
_BEYOND = 1e-9  # of a jump: world length


def medium_crossings(
    medium, origin, direction, t0, t1, isovalues, *, known_side=None, **how
) -> Crossings:
    """The crossings of a ``Medium``'s value between t0 and t1 [n]: exact, or with noise between
    samples. Parameters as of ``crossings``."""
    if medium.noise:
        arguments = medium.value, origin, direction, t0, t1, isovalues
        return crossings(*arguments, known_side=known_side, **how)
    field = getattr(medium.field, "of_surfaces", medium.field)
    return cell_crossings(field, origin, direction, t0, t1, isovalues, known_side=known_side)


def cell_crossings(field, origin, direction, t0, t1, isovalues, *, known_side=None) -> Crossings:
    """Every change of side of a ``Field`` between t0 and t1 [n] on rays from world ``origin`` [n, 3]
    along unit ``direction`` [n, 3], in order. ``isovalues`` [k]; ``known_side`` int [n, k]: 1 or -1
    where it is known which side a ray starts on (it starts on that surface), else 0. A cell
    that uses a value that is not finite has none."""
    ends = _cell_ends(field, origin, direction, t0, t1)
    ray, place = np.nonzero(ends[:, 1:] > ends[:, :-1])
    a, b = ends[ray, place], ends[ray, place + 1]
    if field.filter == "nearest":
        found = _jumps(field, origin, direction, ray, a, b, isovalues)
    else:
        found = _roots(field, origin, direction, ray, a, b, isovalues, known_side)
    return in_order(len(origin), *found, isovalues)


def _cell_ends(field, origin, direction, t0, t1) -> np.ndarray:
    """[n, m + 1], ascending: t0, where the rays go from cell to cell, and t1 as often as there is room."""
    index = field.value.index
    first, last = index(origin + t0[:, None] * direction), index(origin + t1[:, None] * direction)
    shift = 0.5 if field.filter == "nearest" else 0.0  # cells are around voxels
    columns = [t0[:, None], t1[:, None]]
    for i0, i1 in zip((first + shift).T, (last + shift).T):
        low, high = np.minimum(i0, i1), np.maximum(i0, i1)
        count = int(np.max(np.ceil(high) - np.floor(low), initial=0))
        planes = np.floor(low)[:, None] + 1 + np.arange(count)
        span = np.where(i1 == i0, 1.0, i1 - i0)[:, None]
        t = t0[:, None] + (planes - i0[:, None]) / span * (t1 - t0)[:, None]
        # A ray that starts in a face, but for rounding, starts in the cell that it enters there.
        inside = (planes < high[:, None]) & (t > t0[:, None] + _AT_START)
        columns.append(np.where(inside, np.minimum(t, t1[:, None]), t1[:, None]))
    return np.sort(np.concatenate(columns, axis=1), axis=1)


def _jumps(field, origin, direction, ray, a, b, isovalues):
    """(rays, places, surfaces, rising) of jumps between neighbouring voxels."""
    value = field.value(origin[ray] + (0.5 * (a + b))[:, None] * direction[ray])
    beyond = a + np.minimum(_BEYOND, 0.5 * (b - a))  # whose gradient the surface has
    pairs = (ray[1:] == ray[:-1]) & np.isfinite(value[1:]) & np.isfinite(value[:-1])
    found = []
    for k, isovalue in enumerate(isovalues):
        jump = np.nonzero(pairs & ((value[1:] >= isovalue) != (value[:-1] >= isovalue)))[0]
        found.append((ray[jump], beyond[jump + 1], np.full(len(jump), k), value[jump + 1] >= isovalue))
    return [np.concatenate(part) for part in zip(*found)]


def _roots(field, origin, direction, ray, a, b, isovalues, known_side):
    """The same of a field that is continuous, and on each stretch from a to b a polynomial."""
    degree = _DEGREES.get(field.filter, _OTHER)
    nodes = chebyshev.chebpts1(degree + 1)
    t = a[:, None] + 0.5 * (nodes + 1.0) * (b - a)[:, None]
    at = origin[ray][:, None, :] + t[..., None] * direction[ray][:, None, :]
    values = field.value(at.reshape(-1, 3)).reshape(t.shape)
    curve = values @ np.linalg.inv(chebyshev.chebvander(nodes, degree)).T
    # Two cells must agree on the side of the face between them: one value for both.
    faces = [field.value(origin[ray] + end[:, None] * direction[ray]) for end in (a, b)]
    reach = np.abs(curve[:, 1:]).sum(axis=1)
    is_first = np.concatenate([[True], ray[1:] != ray[:-1]])[: len(ray)]
    candidate = np.zeros(len(ray), bool)
    for isovalue in isovalues:
        candidate |= np.abs(curve[:, 0] - isovalue) <= reach * (1 + 1e-9)
        candidate |= (faces[0] >= isovalue) != (faces[1] >= isovalue)
    candidate &= np.isfinite(reach)
    brackets = []
    for p in np.nonzero(candidate)[0]:
        cuts = _turns(curve[p])
        v = chebyshev.chebval(cuts, curve[p])
        for end, values in zip((0, -1), faces):
            v[end] = values[p] if np.isfinite(values[p]) else v[end]
        for k, isovalue in enumerate(isovalues):
            above = v >= isovalue
            if known_side is not None and is_first[p] and known_side[ray[p], k]:
                above[0] = known_side[ray[p], k] > 0
            for i in np.nonzero(above[1:] != above[:-1])[0]:
                brackets.append((p, cuts[i], cuts[i + 1], k, above[i + 1]))
    p, low, high, k, rising = (np.array(part) for part in zip(*brackets)) if brackets else _NONE
    level = np.asarray(isovalues, np.float64)[k]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_after = (_along(curve[p], middle) >= level) == rising
        low, high = np.where(is_after, low, middle), np.where(is_after, middle, high)
    return ray[p], a[p] + 0.5 * (high + 1.0) * (b - a)[p], k, rising


_NONE = np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0, int), np.zeros(0, bool)


def _turns(curve: np.ndarray) -> np.ndarray:
    """-1, where the curve (a Chebyshev series on -1 .. 1) turns, and 1."""
    slope = chebyshev.chebder(curve)
    if np.abs(slope[0]) > np.abs(slope[1:]).sum():
        return np.array([-1.0, 1.0])
    slope = chebyshev.chebtrim(slope, 1e-13 * np.abs(slope).max())
    roots = chebyshev.chebroots(slope).real
    return np.concatenate([[-1.0], np.sort(roots[np.abs(roots) < 1.0]), [1.0]])


def _along(curves: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Row by row the Chebyshev series ``curves`` [n, k] at ``x`` [n] (Clenshaw)."""
    ahead, second = np.zeros(len(x)), np.zeros(len(x))
    for c in curves.T[:0:-1]:
        ahead, second = c + 2.0 * x * ahead - second, ahead
    return curves[:, 0] + x * ahead - second
