"""Iso-surfaces: where a ray meets them, and where it goes on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SUBDIVISIONS = 64  # places within a segment between which a change of side is looked for
_BISECTIONS = 48


@dataclass
class Crossings:
    """In order along each of n rays: ``t`` [n, k], inf where there is none; the ``surface``'s
    number [n, k] and whether the value is ``rising`` [n, k]."""

    t: np.ndarray
    surface: np.ndarray
    rising: np.ndarray


def crossings(
    value, origin, direction, t0, t1, isovalues, *, known_side=None, subdivisions=SUBDIVISIONS
) -> Crossings:
    """Every change of side between t0 and t1 [n], found by bisection.

    ``value``: the field [m] at world positions [m, 3]. A place is above a surface where the value
    is at least the iso-value. ``known_side`` int [n, surfaces]: 1 or -1 where it is known which
    side a ray starts on (it starts on that surface), else 0.
    """
    n, found = len(origin), []
    u = np.arange(subdivisions + 1) / subdivisions
    t = t0[:, None] + (t1 - t0)[:, None] * u
    t[:, -1] = t1
    at = origin[:, None, :] + t[..., None] * direction[:, None, :]
    values = value(at.reshape(-1, 3)).reshape(t.shape)
    for k, isovalue in enumerate(isovalues):
        above = values >= isovalue
        if known_side is not None:
            above[:, 0] = np.where(known_side[:, k] != 0, known_side[:, k] > 0, above[:, 0])
        finite = np.isfinite(values)
        changes = (above[:, 1:] != above[:, :-1]) & finite[:, 1:] & finite[:, :-1]
        ray, place = np.nonzero(changes)
        low, high = t[ray, place], t[ray, place + 1]
        rising = above[ray, place + 1]
        for _ in range(_BISECTIONS if len(ray) else 0):
            middle = 0.5 * (low + high)
            is_after = (value(origin[ray] + middle[:, None] * direction[ray]) >= isovalue) == rising
            low, high = np.where(is_after, low, middle), np.where(is_after, middle, high)
        found.append((ray, high, np.full(len(ray), k), rising))
    ray, at, surface, rising = (np.concatenate(part) for part in zip(*found))
    return in_order(n, ray, at, surface, rising, isovalues)


def in_order(n: int, ray, at, surface, rising, isovalues) -> Crossings:
    """Those of n rays, each of the crossings on ``ray`` and ``at`` a place; of two at one place the
    lower iso-value comes first where the value rises, the higher one where it falls."""
    level = np.asarray(isovalues, np.float64)[surface]
    order = np.lexsort((np.where(rising, level, -level), at, ray))
    ray, at, surface, rising = ray[order], at[order], surface[order], rising[order]
    counts = np.bincount(ray, minlength=n)
    slot = np.arange(len(ray)) - np.repeat(np.cumsum(counts) - counts, counts)
    shape = (n, int(counts.max(initial=0)))
    out = Crossings(np.full(shape, np.inf), np.zeros(shape, int), np.zeros(shape, bool))
    out.t[ray, slot], out.surface[ray, slot], out.rising[ray, slot] = at, surface, rising
    return out


def bent(
    direction: np.ndarray, gradient: np.ndarray, index: np.ndarray, rising: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(unit direction beyond a surface [n, 3], whether it was reflected [n]) by Snell's law.

    ``index`` [n]: of what lies above the surface, relative to below. Without a gradient a ray goes
    straight on.
    """
    length = np.linalg.norm(gradient, axis=1)
    known = np.isfinite(length) & (length > 0)
    normal = -gradient / np.where(known, length, 1.0)[:, None]
    toward = -np.sum(normal * direction, axis=1)
    normal = np.where((toward < 0)[:, None], -normal, normal)
    cosine = np.abs(toward)
    ratio = np.where(rising, 1.0 / index, index)
    left = 1.0 - ratio**2 * (1.0 - cosine**2)
    reflected = left < 0
    refraction = (
        ratio[:, None] * direction
        + (ratio * cosine - np.sqrt(np.maximum(left, 0.0)))[:, None] * normal
    )
    reflection = direction + 2.0 * cosine[:, None] * normal
    out = np.where(reflected[:, None], reflection, refraction)
    out = np.where(known[:, None], out, direction)
    return out / np.linalg.norm(out, axis=1, keepdims=True), reflected & known
