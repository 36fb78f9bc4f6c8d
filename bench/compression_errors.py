"""How far decoded voxels lie from the original ones, and where a curve of rate against error reaches an error."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bench.curves import Reach, reach

_LAYERS = 16  # that are compared at a time, so that little memory is taken


@dataclass(frozen=True)
class VoxelError:
    """Over all finite voxels: ``psnr`` in dB over the volume's range (inf if all are equal), ``largest`` as a share of
    the range."""

    psnr: float
    largest: float


def voxel_error(decoded: np.ndarray, voxels: np.ndarray, value_range: tuple[float, float]) -> VoxelError:
    """Of ``decoded`` [z, y, x], beside ``voxels``, whose finite values span ``value_range``. ValueError for arrays
    of different shapes or types."""
    if decoded.shape != voxels.shape or decoded.dtype != voxels.dtype:
        raise ValueError(f"decoded {decoded.dtype} {decoded.shape} beside {voxels.dtype} {voxels.shape}")
    squares, largest, count = 0.0, 0.0, 0
    for z in range(0, len(voxels), _LAYERS):
        theirs = voxels[z : z + _LAYERS].astype(np.float64)
        apart = np.abs(decoded[z : z + _LAYERS] - theirs)[np.isfinite(theirs)]
        if apart.size:
            squares, largest = squares + float(np.sum(apart * apart)), max(largest, float(apart.max()))
        count += apart.size
    span = (value_range[1] - value_range[0]) or 1.0
    psnr = math.inf if squares == 0.0 else -10.0 * math.log10(squares / count / span**2)
    return VoxelError(psnr, largest / span)


def bits_per_voxel(nbytes: int, voxels: int) -> float:
    return 8.0 * nbytes / voxels


def bits_at_psnr(points: Iterable[tuple[float, float]], psnr: float) -> Reach:
    """At how many bits per voxel the curve through ``points`` (bits per voxel, PSNR) reaches ``psnr``: straight lines
    in dB over the logarithm of the rate. ``seconds`` of the answer is that rate."""
    return reach([(bits, 10.0 ** (-found / 20.0)) for bits, found in points], 10.0 ** (-psnr / 20.0))


def bits_at_error(points: Iterable[tuple[float, float]], largest: float) -> Reach:
    """The same of ``points`` (bits per voxel, largest error)."""
    return reach(points, largest)
