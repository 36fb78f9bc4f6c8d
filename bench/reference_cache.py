"""The exact picture that errors are measured against, kept from run to run.

The key holds all that the picture depends on: voxels, grid, transfer function, camera, size,
pixels, tolerance, and the sources of the reference itself.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from clvol.scene.resolve import ResolvedScene

TOLERANCE = 1e-7
_ROOT = Path(__file__).resolve().parent.parent
_SOURCES = (
    "cl/reference*",
    "clvol/render/reference*.py",
    "clvol/opencl/reference*.py",
    "clvol/scene/camera.py",
)


@dataclass(frozen=True, eq=False)
class Exact:
    """``rgba`` float64 [n, 4] at ``pixels`` int64 [n, 2] (row, column)."""

    pixels: np.ndarray
    rgba: np.ndarray

    def rmse(self, rgba: np.ndarray) -> float:
        """Over pixels and all four channels, linear premultiplied; ``rgba`` is [h, w, 4]."""
        return float(np.sqrt(np.mean(self._difference(rgba) ** 2)))

    def max_abs(self, rgba: np.ndarray) -> float:
        return float(np.abs(self._difference(rgba)).max())

    def _difference(self, rgba: np.ndarray) -> np.ndarray:
        rows, columns = self.pixels.T
        return rgba[rows, columns].astype(np.float64) - self.rgba


def chosen_pixels(size: int, most: int, seed: int = 20) -> np.ndarray:
    """All pixels of a square picture, or ``most`` of them at random; int64 [n, 2], ordered."""
    count = size * size
    flat = np.arange(count)
    if most < count:
        flat = np.sort(np.random.default_rng(seed).choice(count, most, replace=False))
    return np.stack(np.divmod(flat, size), axis=1)


def exact_picture(
    resolved: ResolvedScene,
    device: Any,
    folder: Path,
    most_pixels: int,
    say: Callable[[str], None] = lambda text: None,
) -> Exact:
    """``render_reference`` at ``chosen_pixels``, from ``folder`` where it was made before."""
    from clvol.integrators.reference.picture import render_reference

    pixels = chosen_pixels(resolved.image.width, most_pixels)
    path = folder / f"{_key(resolved, pixels)}.npy"
    if path.is_file():
        return Exact(pixels, np.load(path, allow_pickle=False))
    say(f"exact picture, {len(pixels)} pixels (kept for later runs)")
    rgba, _, counters = render_reference(resolved, device, tolerance=TOLERANCE, pixels=pixels)
    if counters["failed_rays"]:
        share = counters["failed_rays"] / len(pixels)
        say(f"exact picture: {share:.2%} of the rays missed the tolerance {TOLERANCE:g},"
            f" largest error estimate {counters['error_estimate']:.1g}")
    folder.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(f".{os.getpid()}.tmp")
    with open(temporary, "wb") as file:
        np.save(file, rgba)
    os.replace(temporary, path)
    return Exact(pixels, rgba)


def _key(resolved: ResolvedScene, pixels: np.ndarray) -> str:
    volume, function, camera = resolved.volume, resolved.transfer_function, resolved.camera
    grid, integration = volume.grid, resolved.integration
    numbers = (
        volume.data.dtype.str, grid.shape, grid.spacing, tuple(grid.origin),
        np.asarray(grid.direction).tolist(), function.opacity_unit, camera.model_dump_json(),
        resolved.image.width, resolved.image.height, TOLERANCE, integration.filter,
        integration.classification == "pre",
    )  # fmt: skip
    digest = hashlib.sha256(repr(numbers).encode())
    for array in (volume.data, function.values, function.opacities, function.colors, pixels):
        digest.update(np.ascontiguousarray(array))
    for pattern in _SOURCES:
        for path in sorted(_ROOT.glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:24]
