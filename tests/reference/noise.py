"""Fractal noise from one periodic tile: sum of gain^k noise(2^k frequency p + velocity time)."""

from __future__ import annotations

import numpy as np

from clvol.volume import Grid


def tile_noise(tile: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Four channels [n, 4] in -1 ... 1 of a uint8 ``tile`` [z, y, x, 4] at ``p`` [n, 3] (x, y, z),
    in tiles: trilinear between texels at whole multiples of 1 / size, periodic."""
    levels = np.asarray(tile, np.float64) / 127.5 - 1.0
    size = np.array(levels.shape[2::-1])
    at = p * size
    base = np.floor(at)
    f = at - base
    total = np.zeros((len(p), 4))
    for corner in range(8):
        step = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        x, y, z = np.mod(base.astype(np.int64) + step, size).T
        total += np.prod(np.where(step, f, 1.0 - f), axis=1)[:, None] * levels[z, y, x]
    return total


def fractal_noise(
    noise, tile: np.ndarray, grid: Grid, world: np.ndarray, time: float
) -> np.ndarray:
    """fBm [n, 4] at world positions: ``noise`` has frequency, octaves, gain, velocity.

    Noise is fixed to the volume: p and the displacement are along its index axes.
    """
    lower, upper = grid.index_bounds()
    to_index = grid.world_to_index()
    index = world @ to_index[:3, :3].T + to_index[:3, 3]
    longest = float(((upper - lower) * grid.spacing).max())
    p = (index - lower) * grid.spacing / longest
    offset = np.asarray(noise.velocity, float) * time
    return sum(
        noise.gain**k * tile_noise(tile, 2.0**k * noise.frequency * p + offset)
        for k in range(noise.octaves)
    )
