"""The reconstructed field of a volume and its gradient, at world positions.

A reconstruction is a weighted mean of voxels, its weights a product over the axes. Voxels beyond
the volume are its outermost ones. A voxel that is not finite makes NaN exactly what uses it.
"""

from __future__ import annotations

import numpy as np

from clvol.volume import Grid, Volume

_CHUNK = 1 << 14  # positions looked at together: bounds the memory of the 64 voxels of each


class GridSampler:
    """An array [z, y, x] or [z, y, x, channels] on ``grid``, reconstructed by ``filter``."""

    def __init__(self, array: np.ndarray, grid: Grid, filter: str = "linear") -> None:
        array = np.asarray(array, np.float64)
        self.array = np.where(np.isfinite(array), array, np.nan)
        self.grid = grid
        self.filter = filter
        self._to_index = grid.world_to_index()

    def index(self, world: np.ndarray) -> np.ndarray:
        """World positions [n, 3] as indices (x, y, z) [n, 3], not clamped."""
        return world @ self._to_index[:3, :3].T + self._to_index[:3, 3]

    def inside(self, world: np.ndarray, tolerance: float = 1e-3) -> np.ndarray:
        """Whether positions lie in the grid's domain, to ``tolerance`` voxels: bool [n]."""
        lower, upper = self.grid.index_bounds()
        at = self.index(world)
        return np.all((at >= lower - tolerance) & (at <= upper + tolerance), axis=1)

    def taps(self, world: np.ndarray, derivative: int | None = None):
        """(voxels [n, k] or [n, k, channels], weights [n, k]) that make up the field at [n, 3].

        ``derivative`` 0, 1 or 2: the weights of its derivative along index axis x, y or z.
        """
        at = self.index(world)
        n = len(at)
        places, weights = [], []
        for axis, size in enumerate(self.grid.size):
            place, weight = axis_taps(at[:, axis], size, self.filter, derivative == axis)
            places.append(place)
            weights.append(weight)
        (x, y, z), (wx, wy, wz) = places, weights
        voxels = self.array[z[:, :, None, None], y[:, None, :, None], x[:, None, None, :]]
        weight = wz[:, :, None, None] * wy[:, None, :, None] * wx[:, None, None, :]
        return voxels.reshape(n, -1, *self.array.shape[3:]), weight.reshape(n, -1)

    def __call__(self, world: np.ndarray, derivative: int | None = None) -> np.ndarray:
        """The field [n] or [n, channels] at world positions [n, 3]."""
        parts = [
            weighted_mean(*self.taps(world[i : i + _CHUNK], derivative), float(derivative is None))
            for i in range(0, len(world), _CHUNK)
        ]
        return np.concatenate(parts) if parts else np.zeros((0, *self.array.shape[3:]))


def weighted_mean(voxels: np.ndarray, weights: np.ndarray, total: float = 1.0) -> np.ndarray:
    """Sum over k of voxels [n, k, ...] times weights [n, k]; what has weight 0 does not count.

    ``total``: what weights add up to but for rounding, 1 or 0 (of a derivative). Counted from the voxel of the largest
    weight, so that equal voxels give exactly their value: a step of a transfer function may lie right there.
    """
    rows = np.arange(len(weights))
    base = voxels[rows, np.abs(weights).argmax(axis=1)]
    weights = weights.reshape(weights.shape + (1,) * (voxels.ndim - 2))
    with np.errstate(invalid="ignore"):
        changes = np.where(weights != 0.0, (voxels - base[:, None]) * weights, 0.0).sum(axis=1)
    return base + changes if total else changes


def axis_taps(
    x: np.ndarray, size: int, filter: str, derivative: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Voxels int [n, k] along one axis of ``size``, and weights [n, k], at indices ``x`` [n]."""
    x = np.clip(x, 0.0, size - 1.0)
    if filter == "nearest":
        place = np.minimum(np.floor(x + 0.5), size - 1).astype(int)[:, None]
        return place, np.full(place.shape, 0.0 if derivative else 1.0)
    base = np.clip(np.floor(x), 0, max(size - 2, 0)).astype(int)
    u = x - base
    first, weights = _WEIGHTS[filter, derivative]
    w = np.stack(np.broadcast_arrays(*weights(u)), axis=1)
    taps = base[:, None] + first + np.arange(w.shape[1])
    return np.clip(taps, 0, size - 1), w


def _spline(u):
    v = 1.0 - u
    return v**3 / 6, 2 / 3 - u**2 + u**3 / 2, 2 / 3 - v**2 + v**3 / 2, u**3 / 6


def _spline_slope(u):
    v = 1.0 - u
    return -(v**2) / 2, -2 * u + 1.5 * u**2, 2 * v - 1.5 * v**2, u**2 / 2


def _catmull_rom(u):
    return (
        -u / 2 + u**2 - u**3 / 2,
        1 - 2.5 * u**2 + 1.5 * u**3,
        u / 2 + 2 * u**2 - 1.5 * u**3,
        -(u**2) / 2 + u**3 / 2,
    )


def _catmull_rom_slope(u):
    return (
        -0.5 + 2 * u - 1.5 * u**2,
        -5 * u + 4.5 * u**2,
        0.5 + 4 * u - 4.5 * u**2,
        -u + 1.5 * u**2,
    )


def _kernel(function, reach):
    """Weights of a kernel of the distance, which are divided by their sum."""
    def weights(u):
        found = [function(np.abs(u - tap)) for tap in range(1 - reach, reach + 1)]
        found = [np.where(np.abs(w) < 1e-14, 0.0, w) for w in found]
        total = sum(found)
        return tuple(w / total for w in found)

    return weights


def _slope_of(weights, h=1e-5):
    """The derivative of weights, by differences of fourth order; kernels have one at whole places, too."""
    def slopes(u):
        parts = [weights(u + k * h) for k in (-2, -1, 1, 2)]
        return tuple((a - 8 * b + 8 * c - d) / (12 * h) for a, b, c, d in zip(*parts))

    return slopes


def mitchell(x):
    """Mitchell and Netravali 1988, equation 8, with B = C = 1/3."""
    b = c = 1.0 / 3.0
    near = (12 - 9 * b - 6 * c) * x**3 + (-18 + 12 * b + 6 * c) * x**2 + 6 - 2 * b
    far = (-b - 6 * c) * x**3 + (6 * b + 30 * c) * x**2 + (-12 * b - 48 * c) * x + 8 * b + 24 * c
    return np.where(x < 1, near, np.where(x < 2, far, 0.0)) / 6


def _windowed(window):
    return lambda x: np.sinc(x) * window(x)


_LANCZOS2 = _windowed(lambda x: np.where(x < 2, np.sinc(x / 2), 0.0))
_LANCZOS3 = _windowed(lambda x: np.where(x < 3, np.sinc(x / 3), 0.0))
_HANN3 = _windowed(lambda x: np.where(x < 3, np.cos(np.pi * x / 6) ** 2, 0.0))

# (filter, derivative): the first voxel from the one below, and the weights at u = 0 ... 1 above it.
_WEIGHTS = {
    ("linear", False): (0, lambda u: (1.0 - u, u)),
    ("linear", True): (0, lambda u: (-1.0, np.ones_like(u))),
    ("cubic", False): (-1, _spline),
    ("cubic", True): (-1, _spline_slope),
    ("catmull-rom", False): (-1, _catmull_rom),
    ("catmull-rom", True): (-1, _catmull_rom_slope),
}
for _name, _function, _reach in (
    ("mitchell", mitchell, 2), ("lanczos2", _LANCZOS2, 2), ("lanczos3", _LANCZOS3, 3), ("windowed-sinc", _HANN3, 3),
):  # fmt: skip
    _WEIGHTS[_name, False] = (1 - _reach, _kernel(_function, _reach))
    _WEIGHTS[_name, True] = (1 - _reach, _slope_of(_kernel(_function, _reach)))


def spline_coefficients(voxels: np.ndarray, spacing=(1.0, 1.0, 1.0)) -> np.ndarray:
    """Coefficients [z, y, x] whose cubic B-spline (outermost ones repeated) meets the voxels.

    For voxels that are not finite the nearest finite ones stand in; they are NaN again afterwards.
    """
    finite = np.isfinite(voxels)
    c = np.zeros_like(voxels)
    if finite.any():
        from scipy.ndimage import distance_transform_edt

        nearest = distance_transform_edt(
            ~finite, sampling=spacing[::-1], return_distances=False, return_indices=True
        )
        c = voxels[tuple(nearest)]
    for axis in range(3):
        lines = np.moveaxis(c, axis, 0)
        n = len(lines)
        matrix = np.eye(n) * 4 / 6 + (np.eye(n, k=1) + np.eye(n, k=-1)) / 6
        matrix[0, 0] += 1 / 6
        matrix[-1, -1] += 1 / 6
        solved = np.linalg.solve(matrix, lines.reshape(n, -1)).reshape(lines.shape)
        c = np.moveaxis(solved, 0, axis)
    return np.where(finite, c, np.nan)


def voxel_gradients(voxels: np.ndarray, grid: Grid, operator: str) -> np.ndarray:
    """The derivative of the value per world length at every voxel: [z, y, x, 3], world axes.

    "central": differences over two voxels, one-sided at the faces, 0 along an axis of one voxel.
    "sobel": the same, of voxels smoothed by [1, 2, 1] / 4 along the other two axes.
    """
    per_index = []
    for axis in (2, 1, 0):  # x, y, z
        smooth = voxels
        if operator == "sobel":
            for other in {0, 1, 2} - {axis}:
                smooth = _smoothed(smooth, other)
        per_index.append(_difference(smooth, axis))
    return np.stack(per_index, axis=-1) @ grid.world_to_index()[:3, :3]


def _difference(voxels: np.ndarray, axis: int) -> np.ndarray:
    v = np.moveaxis(voxels, axis, 0)
    n = len(v)
    with np.errstate(invalid="ignore"):
        d = [(v[min(i + 1, n - 1)] - v[max(i - 1, 0)]) / max(min(i + 1, n - 1) - max(i - 1, 0), 1)
             for i in range(n)]  # fmt: skip
    return np.moveaxis(np.array(d), 0, axis)


def _smoothed(voxels: np.ndarray, axis: int) -> np.ndarray:
    v = np.moveaxis(voxels, axis, 0)
    n = len(v)
    s = [(v[max(i - 1, 0)] + 2.0 * v[i] + v[min(i + 1, n - 1)]) / 4.0 for i in range(n)]
    return np.moveaxis(np.array(s), 0, axis)


class Field:
    """A volume's reconstruction under a filter, and its gradient under an operator."""

    def __init__(
        self, volume: Volume, filter: str, operator: str = "central", prefilter: bool = False
    ) -> None:
        voxels = np.asarray(volume.data, np.float64)
        voxels = np.where(np.isfinite(voxels), voxels, np.nan)
        self.grid = volume.grid
        self.filter = filter
        if filter == "cubic" and prefilter:
            voxels = spline_coefficients(voxels, volume.grid.spacing)
        self.value = GridSampler(voxels, volume.grid, filter)
        self._is_analytic = (filter, True) in _WEIGHTS and filter != "linear"
        if not self._is_analytic:
            gradients = voxel_gradients(voxels, volume.grid, operator)
            self._gradient = GridSampler(gradients, volume.grid, filter)

    def gradient(self, world: np.ndarray) -> np.ndarray:
        """Derivative of the value per world length [n, 3] (world axes) at positions [n, 3]."""
        if not self._is_analytic:
            return self._gradient(world)
        per_index = np.stack([self.value(world, axis) for axis in range(3)], axis=-1)
        return per_index @ self.grid.world_to_index()[:3, :3]
