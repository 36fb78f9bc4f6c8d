"""Light from all around: a map's texels, summed one by one.

Sphere: a mirror ball seen along -z, the disc inscribed in a square (OpenGL's GL_SPHERE_MAP).

Latitude-longitude: u = atan2(x, -z) / 2 pi + 0.5, v = acos(y) / pi, row 0 at +y. Cube: a vertical
strip of the faces +x -x +y -y +z -z, each as in OpenGL (seen from inside, row 0 on top).
"""

from __future__ import annotations

import numpy as np

# Face: the direction at its middle, per column and per row (s and t from -1 to 1).
_FACES = np.array([
    [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
    [[-1, 0, 0], [0, 0, 1], [0, -1, 0]],
    [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
    [[0, -1, 0], [1, 0, 0], [0, 0, -1]],
    [[0, 0, 1], [1, 0, 0], [0, -1, 0]],
    [[0, 0, -1], [-1, 0, 0], [0, -1, 0]],
], float)  # fmt: skip
_CHUNK = 256


class EnvironmentMap:
    """``texels`` [h, w, 3] linear, of a "latlong" or "cube" map, turned about world y."""

    def __init__(
        self, texels: np.ndarray, layout: str = "latlong", intensity: float = 1.0,
        rotation_degrees: float = 0.0,
    ) -> None:  # fmt: skip
        self.texels = np.asarray(texels, np.float64) * intensity
        self.layout = layout
        angle = np.radians(rotation_degrees)
        c, s = np.cos(angle), np.sin(angle)
        self._turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])  # map to world
        if layout == "sphere":
            self.texels = ball_with_rim(self.texels)
            directions, self._areas = ball_texels(self.texels.shape[0])
        else:
            directions, self._areas = latlong_texels(self.texels.shape[:2])
        if layout == "cube":
            directions, self._areas = cube_texels(self.texels.shape[1])
        self._directions = directions @ self._turn.T
        self._flat = self.texels.reshape(-1, 3)

    def diffuse(self, normals: np.ndarray) -> np.ndarray:
        """E_d [n, 3]: irradiance over pi; of a constant environment that constant."""
        return self._mean(normals, 1.0)

    def specular(self, reflected: np.ndarray, shininess: float) -> np.ndarray:
        """E_s [n, 3]: mean radiance in the lobe (R.w)^(shininess / 4)."""
        return self._mean(reflected, shininess / 4.0)

    def _mean(self, axes: np.ndarray, power: float) -> np.ndarray:
        means = [np.zeros((0, 3))]
        for i in range(0, len(axes), _CHUNK):
            lobe = np.maximum(axes[i : i + _CHUNK] @ self._directions.T, 0.0) ** power * self._areas
            means.append(lobe @ self._flat / lobe.sum(axis=1, keepdims=True))
        return np.concatenate(means)

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """What is seen in ``directions`` [n, 3]: bilinear between texel centres."""
        x, y, z = (directions @ self._turn).T
        height, width = self.texels.shape[:2]
        if self.layout == "latlong":
            u = (np.arctan2(x, -z) / (2 * np.pi) + 0.5) * width - 0.5
            v = np.arccos(np.clip(y, -1, 1)) / np.pi * height - 0.5
            return _bilinear(self.texels, u, v, wraps=True)
        if self.layout == "sphere":
            m = np.sqrt(2.0 * np.maximum(1.0 + z, 1e-300))  # OpenGL's: length of (x, y, z + 1)
            return _bilinear(self.texels, (x / m + 1) / 2 * width - 0.5, (1 - y / m) / 2 * height - 0.5, wraps=False)
        out = np.zeros((len(x), 3))
        major = np.argmax(np.abs(np.stack([x, y, z])), axis=0)
        for face, (middle, column, row) in enumerate(_FACES):
            on = (major == face // 2) & (np.stack([x, y, z], 1) @ middle > 0)
            d = np.stack([x, y, z], 1)[on]
            s, t = (d @ column) / (d @ middle), (d @ row) / (d @ middle)
            texels = self.texels[face * width : (face + 1) * width]
            u, v = ((1 + s) / 2 * width - 0.5, (1 + t) / 2 * width - 0.5)
            out[on] = _bilinear(texels, u, v, wraps=False)
        return out


def _bilinear(texels, u, v, wraps):
    height, width = texels.shape[:2]
    x, y = np.floor(u).astype(int), np.floor(v).astype(int)
    fx, fy = (u - x)[:, None], (v - y)[:, None]
    y0, y1 = np.clip(y, 0, height - 1), np.clip(y + 1, 0, height - 1)
    if wraps:
        x0, x1 = x % width, (x + 1) % width
    else:
        x0, x1 = np.clip(x, 0, width - 1), np.clip(x + 1, 0, width - 1)
    top = (1 - fx) * texels[y0, x0] + fx * texels[y0, x1]
    return (1 - fy) * top + fy * ((1 - fx) * texels[y1, x0] + fx * texels[y1, x1])


def latlong_texels(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Directions [h w, 3] of the texels' centres, and their solid angles [h w]."""
    height, width = shape
    v = (np.arange(height) + 0.5) / height * np.pi
    u = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    v, u = np.meshgrid(v, u, indexing="ij")
    directions = np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], axis=-1)
    half = 0.5 * np.pi / height
    areas = (np.cos(v - half) - np.cos(v + half)) * 2 * np.pi / width
    return directions.reshape(-1, 3), areas.reshape(-1)


def cube_texels(size: int) -> tuple[np.ndarray, np.ndarray]:
    """The same for the six faces, one below the other."""
    edges = np.linspace(-1, 1, size + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])
    t, s = np.meshgrid(middles, middles, indexing="ij")

    # The solid angle of the part of a face from its middle to (s, t).
    def corner(a, b):
        return np.arctan2(a * b, np.sqrt(a * a + b * b + 1.0))

    corners = corner(edges[:, None], edges[None, :])
    areas = corners[1:, 1:] - corners[:-1, 1:] - corners[1:, :-1] + corners[:-1, :-1]
    directions = [m + s[..., None] * c + t[..., None] * r for m, c, r in _FACES]
    directions = np.array(directions).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions, np.tile(areas.reshape(-1), 6)


def ball_texels(size: int) -> tuple[np.ndarray, np.ndarray]:
    """The same for a mirror ball: what the ball's normal at each texel mirrors of +z. A mirror ball shows equal solid
    angles in equal areas; texels around the disc have none."""
    at = (np.arange(size) + 0.5) * 2 / size - 1
    v, u = np.meshgrid(-at, at, indexing="ij")
    square = u * u + v * v
    nz = np.sqrt(np.maximum(1 - square, 0))
    directions = np.stack([2 * nz * u, 2 * nz * v, 2 * nz * nz - 1], axis=-1)
    areas = np.where(square <= 1, 4.0 * (2.0 / size) ** 2, 0.0)
    return directions.reshape(-1, 3), areas.reshape(-1)


def ball_with_rim(texels: np.ndarray) -> np.ndarray:
    """``texels`` with the nearest texel of the disc in place of each one around it."""
    size = len(texels)
    at = np.arange(size) + 0.5 - size / 2
    y, x = np.meshgrid(at, at, indexing="ij")
    inside = np.argwhere(x * x + y * y <= size * size / 4)
    out = texels.copy()
    for i, j in np.argwhere(x * x + y * y > size * size / 4):
        k, m = inside[np.argmin(((inside - [i, j]) ** 2).sum(axis=1))]
        out[i, j] = texels[k, m]
    return out
