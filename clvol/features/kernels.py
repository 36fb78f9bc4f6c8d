"""Separable reconstruction kernels, as polynomials between whole voxels (cl/kernel_filter.h).

A kernel is a symmetric function of the distance in voxels, 0 beyond its reach. On the way from one voxel to the next
each voxel's weight is a smooth function of the place; weights are divided by their sum, so that constants stay, and
each is a polynomial of degree 11 through Chebyshev-Lobatto nodes. That is off by less than 5e-8 for the kernels here.
Derivatives are those of the polynomials, and so exactly those of the field that is rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from clvol.errors import SceneError
from clvol.features.vocabulary import FILTER_REACH, LARGEST_SLOPES, LARGEST_WEIGHTS
from clvol.scene.integration import Integration

Kernel = Callable[[np.ndarray], np.ndarray]

COEFFICIENTS = 12  # of a polynomial, lowest power first
MOST_TAPS = 3  # voxels on either side
LEAST_ERROR = 1e-3  # of a table's weights: a kernel that polynomials miss by more is refused
_NOTHING = 1e-14  # a sinc at whole distances, but for rounding
_PLACES = np.linspace(0.0, 1.0, 1025)


def _mitchell(x: np.ndarray) -> np.ndarray:
    """Mitchell and Netravali (1988) with B = C = 1/3."""
    near = (7.0 * x**3 - 12.0 * x**2 + 16.0 / 3.0) / 6.0
    far = (-7.0 / 3.0 * x**3 + 12.0 * x**2 - 20.0 * x + 32.0 / 3.0) / 6.0
    return np.where(x < 1.0, near, np.where(x < 2.0, far, 0.0))


def _lanczos(reach: int) -> Kernel:
    """The sinc, windowed by the middle lobe of a wider one (Duchon 1979)."""
    return lambda x: np.where(x < reach, np.sinc(x) * np.sinc(x / reach), 0.0)


def _windowed_sinc(x: np.ndarray) -> np.ndarray:
    """The sinc, windowed by a raised cosine over three voxels (Marschner and Lobb 1994)."""
    return np.where(x < 3.0, np.sinc(x) * (0.5 + 0.5 * np.cos(np.pi * x / 3.0)), 0.0)


KERNELS: dict[str, Kernel] = {
    "mitchell": _mitchell, "lanczos2": _lanczos(2), "lanczos3": _lanczos(3), "windowed-sinc": _windowed_sinc,
}  # fmt: skip


def kernel_of(integration: Integration) -> Kernel | None:
    """The kernel of the filter, as a function of distances in voxels; None for filters that are none."""
    if integration.filter != "table":
        return KERNELS.get(integration.filter)
    values = np.asarray(integration.filter_table, np.float64)
    from_zero = np.concatenate([values[:0:-1], values])
    reach = float(integration.filter_reach)
    spline = _spline(np.linspace(-reach, reach, from_zero.size), from_zero)
    return lambda x: np.where(np.abs(x) < reach, spline(np.abs(x)), 0.0)


def _spline(at: np.ndarray, values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    from scipy.interpolate import CubicSpline  # takes a tenth of a second

    return CubicSpline(at, values)


def weights(kernel: Kernel, reach: int, u: np.ndarray) -> np.ndarray:
    """The weights float64 [2 reach, n] at ``u`` [n] between two voxels, of the voxels from reach - 1 before the first
    of them on. They add up to 1."""
    taps = np.arange(1 - reach, reach + 1)
    found = np.array([kernel(np.abs(u - tap)) for tap in taps])
    found[np.abs(found) < _NOTHING] = 0.0
    return found / found.sum(axis=0)


def polynomials(kernel: Kernel, reach: int) -> np.ndarray:
    """float64 [reach, COEFFICIENTS]: the weights of the ``reach`` voxels before the place, in u, farthest first; those
    behind have the same in 1 - u."""
    n = COEFFICIENTS - 1
    nodes = 0.5 - 0.5 * np.cos(np.pi * np.arange(n + 1) / n)
    values = weights(kernel, reach, nodes)[:reach]
    powers = np.vander(nodes, n + 1, increasing=True)
    return np.linalg.solve(powers, values.T).T


def filter_terms(integration: Integration) -> np.ndarray | None:
    """float32 [MOST_TAPS, COEFFICIENTS]: ``View.filter_terms``; None for other filters."""
    kernel = kernel_of(integration)
    if kernel is None:
        return None
    reach = FILTER_REACH[integration.filter] + 1
    terms = np.zeros((MOST_TAPS, COEFFICIENTS), np.float32)
    terms[:reach] = polynomials(kernel, reach)
    return terms


def kernel_error(integration: Integration) -> float:
    """The largest error of a weight of the filter."""
    kernel = kernel_of(integration)
    if kernel is None:
        return 0.0
    reach = FILTER_REACH[integration.filter] + 1
    powers = np.vander(_PLACES, COEFFICIENTS, increasing=True)
    return float(np.abs(polynomials(kernel, reach) @ powers.T - weights(kernel, reach, _PLACES)[:reach]).max())


def check_kernel(integration: Integration, origin: str) -> None:
    """SceneError for a table that is no kernel: weights without a sum, too large ones, or kinks."""
    if integration.filter != "table":
        return
    kernel, where, reach = kernel_of(integration), f"{origin}: integration.filter_table", MOST_TAPS
    assert kernel is not None
    total = np.array([kernel(np.abs(_PLACES - tap)) for tap in range(1 - reach, reach + 1)]).sum(axis=0)
    if not (total > 1e-3).all():
        raise SceneError(where, f"weights that add up to {total.min():.3g} somewhere", "sums above 0, such as 1")
    found = weights(kernel, reach, _PLACES)
    largest = float(np.abs(found).sum(axis=0).max())
    if largest > LARGEST_WEIGHTS:
        raise SceneError(where, f"weights whose magnitudes add up to {largest:.3g}", f"at most {LARGEST_WEIGHTS}")
    slopes = float(np.abs(np.gradient(found, _PLACES, axis=1)).sum(axis=0).max())
    if slopes > LARGEST_SLOPES:
        what = f"weights whose derivatives' magnitudes add up to {slopes:.3g}"
        raise SceneError(where, what, f"at most {LARGEST_SLOPES}")
    error = kernel_error(integration)
    if error > LEAST_ERROR:
        what = f"a kernel that polynomials of degree {COEFFICIENTS - 1} miss by {error:.2g}"
        raise SceneError(where, what, f"at most {LEAST_ERROR:g}: a kernel that is smooth between whole distances")


def described(integration: Integration) -> str:
    """What the filter is, and how well it is met, in words."""
    taps: Sequence[int] = (2 * (FILTER_REACH[integration.filter] + 1),) * 3
    size = " by ".join(map(str, taps))
    return f"of {size} voxels, weights to within {max(kernel_error(integration), 1e-7):.0e}"
