"""How a pixel weighs the rays around its middle.

The filters are products of one function of the distance to the right and one of that down. "box": the pixel itself.
"tent": linear, a pixel wide to either side. "gaussian": standard deviation half a pixel, cut at 1.5 pixels.
"mitchell": the cubic of Mitchell and Netravali, "Reconstruction filters in computer graphics", SIGGRAPH 1988, with
B = C = 1/3, 2 pixels wide to either side.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def _box(x: np.ndarray) -> np.ndarray:
    return (np.abs(x) < 0.5).astype(np.float64)


def _tent(x: np.ndarray) -> np.ndarray:
    return np.maximum(1.0 - np.abs(x), 0.0)


def _gaussian(x: np.ndarray) -> np.ndarray:
    return np.where(np.abs(x) < 1.5, np.exp(-2.0 * x * x), 0.0)


def _mitchell(x: np.ndarray) -> np.ndarray:
    x = np.abs(x)
    near = (7.0 * x**3 - 12.0 * x**2 + 16.0 / 3.0) / 6.0
    far = (-7.0 / 3.0 * x**3 + 12.0 * x**2 - 20.0 * x + 32.0 / 3.0) / 6.0
    return np.where(x < 1.0, near, np.where(x < 2.0, far, 0.0))


FILTERS: dict[str, tuple[Callable[[np.ndarray], np.ndarray], int]] = {
    "box": (_box, 0), "tent": (_tent, 1), "gaussian": (_gaussian, 1), "mitchell": (_mitchell, 2),
}  # fmt: skip
"""By name, and how many pixels beside a pixel count."""


class FilteredPicture:
    """A picture that is added up from pictures of one ray per pixel each, in double precision.

    ``name``: of the filter. Pixels beyond the picture's border do not count.
    """

    def __init__(self, name: str, height: int, width: int) -> None:
        self._function, self._reach = FILTERS[name]
        self._sum = np.zeros((height, width, 4))
        self._weights = np.zeros((height, width, 1))

    def add(self, rgba: np.ndarray, offset: np.ndarray) -> None:
        """``rgba`` float32 [height, width, 4], of the rays ``offset`` [2] (right, down) from the pixels' middles."""
        height, width = rgba.shape[:2]
        for dy in range(-self._reach, self._reach + 1):
            for dx in range(-self._reach, self._reach + 1):
                weight = float(self._function(np.array(dx + offset[0])) * self._function(np.array(dy + offset[1])))
                if weight == 0.0 or abs(dx) >= width or abs(dy) >= height:
                    continue
                to = np.s_[max(-dy, 0) : height - max(dy, 0), max(-dx, 0) : width - max(dx, 0)]
                of = np.s_[max(dy, 0) : height - max(-dy, 0), max(dx, 0) : width - max(-dx, 0)]
                self._sum[to] += rgba[of] if weight == 1.0 else np.multiply(rgba[of], weight, dtype=np.float64)
                self._weights[to] += weight

    def take(self) -> np.ndarray:
        """float32 [height, width, 4]. Where all rays found the same, exactly that."""
        mean = self._sum / self._weights
        if self._reach > 1:  # whose negative weights overshoot
            mean = np.maximum(mean, 0.0)
            mean[..., 3] = np.minimum(mean[..., 3], 1.0)
        return mean.astype(np.float32)
