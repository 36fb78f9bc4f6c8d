"""Volumetric noise: a small tile that repeats in space, summed over octaves (cl/noise.h).

After Engel and Ertl, "Interactive high-quality volume rendering with flexible consumer graphics
hardware" (Eurographics 2002, state of the art reports), section on volumetric effects: a noise
volume of 32^3 texels with four channels perturbs the value that is looked up, or the position at which
the volume is sampled.

The tile. Each channel is Gaussian noise of a band of one octave to either side of CENTRE cycles per
tile: a wave of k cycles has the amplitude cos(pi/2 log2(k/CENTRE)) / k between CENTRE/2 and
2 CENTRE and none outside, so octaves overlap such that their powers add up smoothly. Then texels
are ranked: each of the 256 bytes occurs 128 times in a channel. Values so spread evenly over -1 ..
1, their mean is exactly 0, their standard deviation 0.58, and 98 % of the power stays in the band:
a texel differs from its neighbour by 0.23 on average, where it would by 0.67 in white noise.

The sum is fBm(q) = sum over k < octaves of gain^k tile(2^k q + offset), q in tiles, trilinear between
texels, periodic. A term is used in two ways: "value" adds amplitude * fBm to the value by the
fourth channel, "coordinate" moves the position by amplitude * fBm of the first three. Several terms
add up, and all are evaluated at the position before any displacement.

Noise is fixed to the volume: its axes are the volume's index axes, q = frequency * (distance from
the lower corner of the domain) / (the domain's longest edge), and it moves along them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Protocol

import numpy as np

from clvol.device.memory import Perturbation, ValueMap
from clvol.errors import SceneError
from clvol.features.vocabulary import NOISE_TARGETS as TARGETS
from clvol.opencl.structs import MOST_NOISE_TERMS as MOST_TERMS
from clvol.opencl.structs import NOISE_TERM as TERM_DTYPE
from clvol.volume.grid import Grid
from clvol.volume.voxel_layout import CELL_SHIFT

TILE = 32  # texels per edge
CHANNELS = 4  # x, y, z of a displacement; the value
CENTRE = 4.0  # cycles per tile in the middle of the band
# The error of a bound in float32: a few roundings per octave.
_ROUNDING = 1.0 + 1e-5
UNMAPPED = ValueMap()
_FAR = 1e30  # what float32 holds
_PLACE_ROUNDING = 0.01  # lattice units: far more than the rounding of a position


class Noise(Protocol):
    """One term, as a scene states it: a [noise] table has these attributes."""

    @property
    def target(self) -> str:
        """"value", "coordinate", "attenuation" or "fur"."""

    @property
    def amplitude(self) -> float:
        """In units of the value, or a world length."""

    @property
    def frequency(self) -> float:
        """Tiles along the domain's longest edge."""

    @property
    def octaves(self) -> int: ...

    @property
    def gain(self) -> float: ...

    @property
    def seed(self) -> int: ...

    @property
    def velocity(self) -> Sequence[float]:
        """[3], tiles per second."""

    @property
    def root(self) -> float | None:
        """Of fur, the value where hairs begin."""

    @property
    def tip(self) -> float | None:
        """Of fur, the value where the longest end."""


@lru_cache(maxsize=8)
def noise_tile(seed: int) -> np.ndarray:
    """uint8 [32, 32, 32, 4] (z, y, x, channel), read-only; byte b stands for b / 127.5 - 1.

    ``seed``: any integer. The tile depends on nothing else.
    """
    cycles = np.fft.fftfreq(TILE, 1.0 / TILE)
    k = np.sqrt(sum(axis**2 for axis in np.meshgrid(cycles, cycles, cycles, indexing="ij")))
    octave = np.log2(np.maximum(k, 1e-9) / CENTRE)
    band = np.where(np.abs(octave) < 1, np.cos(0.5 * np.pi * octave) / np.maximum(k, 1.0), 0.0)
    white = _white(seed)
    tile = np.empty((TILE, TILE, TILE, CHANNELS), np.uint8)
    for channel in range(CHANNELS):
        smooth = np.fft.ifftn(np.fft.fftn(white[channel]) * band).real
        ranks = np.empty(TILE**3, np.int64)
        ranks[np.argsort(smooth, axis=None, kind="stable")] = np.arange(TILE**3)
        tile[..., channel] = (ranks * 256 // TILE**3).reshape(TILE, TILE, TILE)
    tile.setflags(write=False)
    return tile


def _white(seed: int) -> np.ndarray:
    """float64 [channel, z, y, x], uniform in [0, 1): splitmix64 (Steele et al. 2014), whose numbers
    do not depend on the version of a library."""
    state = np.arange(CHANNELS * TILE**3, dtype=np.uint64)
    state += np.uint64(seed % 2**44 << 20)  # 2^20 numbers for each seed
    golden = np.uint64(0x9E3779B97F4A7C15)
    mixed = (state + np.uint64(1)) * golden
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    mixed ^= mixed >> np.uint64(31)
    return (mixed >> np.uint64(11)).astype(np.float64).reshape(CHANNELS, TILE, TILE, TILE) / 2**53


def tile_words(tile: np.ndarray) -> np.ndarray:
    """uint32 [32^3] for the device: channel c of a texel in bits 8 c .. 8 c + 7."""
    words = tile.astype(np.uint32) << (8 * np.arange(CHANNELS, dtype=np.uint32))
    return np.bitwise_or.reduce(words, axis=-1).ravel()


def fractal_noise(tile: np.ndarray, noise: Noise, position: np.ndarray, time: float = 0.0):
    """The numpy reference of cl/noise.h, in double precision: float64 [..., 4], the fBm of every channel.

    ``position`` [..., 3]: (x, y, z) in tiles (frequency included, velocity not). ``time``: seconds.
    """
    position = np.asarray(position, np.float64)
    offset = _offset(noise, time)
    total = np.zeros((*position.shape[:-1], CHANNELS))
    for octave in range(noise.octaves):
        total += noise.gain**octave * _trilinear(tile, position * 2.0**octave + offset)
    return total


def perturbed(
    noises: Iterable[Noise], grid: Grid, place: np.ndarray, time: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """The effect of all ``noises`` at ``place`` [..., 3]: the position to sample instead (float64 [..., 3])
    and the number to add to the value there (float64 [...]). Positions are index coordinates (x, y, z) of
    ``grid``.
    """
    place = np.asarray(place, np.float64)
    moved, added = place.copy(), np.zeros(place.shape[:-1])
    for noise in noises:
        position = (place - grid.index_bounds()[0]) * _tiles_an_index(noise, grid)
        sums = fractal_noise(noise_tile(noise.seed), noise, position, time)
        if noise.target == "value":
            added += noise.amplitude * sums[..., 3]
        else:
            moved += noise.amplitude * sums[..., :3] / np.asarray(grid.spacing)
    return moved, added


def value_bound(noise: Noise) -> float:
    """The most that ``noise`` adds to, or subtracts from, a value: 0 for noise that moves positions."""
    return _bound(noise, slice(3, 4)) if noise.target == "value" else 0.0


def displacement_bound(noise: Noise) -> float:
    """The farthest that ``noise`` moves a position along any index axis, world length: 0 for noise that
    changes values."""
    return _bound(noise, slice(0, 3)) if noise.target == "coordinate" else 0.0


def perturbation(
    noises: Iterable[Noise], grid: Grid, value_gain: float = 1.0, cell_shift: int = CELL_SHIFT
) -> Perturbation:
    """Bounds of the effect of all ``noises`` together, for leaping over cells of 2^``cell_shift`` lattice units."""
    noises = list(noises)
    moved = sum(displacement_bound(noise) for noise in noises) / np.asarray(grid.spacing)
    # Lattice units, limited to the size of the largest volumes.
    cells = np.ceil(np.minimum(moved + _PLACE_ROUNDING, 2.0**31) / (1 << cell_shift))
    x, y, z = (int(n) for n in np.where(moved > 0, cells, 0).astype(np.int64))
    return Perturbation(sum(value_bound(noise) for noise in noises) * value_gain, (x, y, z))


def _bound(noise: Noise, channels: slice) -> float:
    """Interpolation stays within the texels; in the worst case all octaves peak at one position."""
    peak = np.abs(noise_tile(noise.seed)[..., channels] / 127.5 - 1.0).max()
    octaves = sum(abs(noise.gain) ** k for k in range(noise.octaves))
    return abs(noise.amplitude) * float(peak) * octaves * _ROUNDING


def device_noise(
    noises: Sequence[Noise], grid: Grid, time: float = 0.0, to_kernel: ValueMap = UNMAPPED
) -> tuple[np.ndarray, int, int]:
    """(terms, values, coordinates) for cl/noise.h: TERM_DTYPE [MOST_TERMS], those that change
    values first, then those that move places, then those of attenuation and of fur, and the number of each of the
    first two. Only ``time`` changes them from frame to frame.

    ``to_kernel``: from values to those that kernels compute with. Terms
    refer to the tiles of ``device_tiles`` for the same noises. SceneError for more than MOST_TERMS.
    """
    if len(noises) > MOST_TERMS:
        raise SceneError("scene: noise", f"got {len(noises)}", f"at most {MOST_TERMS} terms")
    terms = np.zeros(MOST_TERMS, TERM_DTYPE)
    ordered = sorted(noises, key=lambda noise: TARGETS[noise.target])
    seeds = _seeds(noises)
    for term, noise in zip(terms, ordered):
        term["scale"][:3] = _tiles_an_index(noise, grid)
        term["gain"] = noise.gain
        term["offset"][:3] = _offset(noise, time)
        if noise.target == "value":
            term["value_amplitude"] = noise.amplitude * to_kernel.gain
        elif noise.target == "attenuation":
            term["value_amplitude"] = noise.amplitude
        elif noise.target == "fur":
            term["value_amplitude"] = noise.amplitude
            term["amplitude"][:2] = _ends(noise, to_kernel)
        else:
            term["amplitude"][:3] = noise.amplitude / np.asarray(grid.spacing)
        term["octaves"], term["first_texel"] = noise.octaves, seeds.index(noise.seed) * TILE**3
    values = sum(noise.target == "value" for noise in noises)
    return terms, values, sum(noise.target == "coordinate" for noise in noises)


def device_tiles(noises: Iterable[Noise]) -> np.ndarray:
    """uint32 [n 32^3]: the tiles of all seeds of ``noises``, one after another."""
    return np.concatenate([tile_words(noise_tile(seed)) for seed in _seeds(noises)])


def _ends(fur: Noise, to_kernel: ValueMap) -> tuple[float, float]:
    """Root, and 1 / (root - tip), in values that kernels compute with."""
    if fur.root is None or fur.tip is None:
        raise ValueError("fur without ends")
    root, tip = (float(np.clip(to_kernel(value), -_FAR, _FAR)) for value in (fur.root, fur.tip))
    return root, float(np.clip(1.0 / (root - tip), -_FAR, _FAR)) if root != tip else _FAR


def _seeds(noises: Iterable[Noise]) -> list[int]:
    return list(dict.fromkeys(noise.seed for noise in noises))


def _tiles_an_index(noise: Noise, grid: Grid) -> np.ndarray:
    """float64 [3]: tiles from one voxel to the next along x, y, z."""
    lower, upper = grid.index_bounds()
    spacing = np.asarray(grid.spacing)
    return noise.frequency * spacing / ((upper - lower) * spacing).max()


def _offset(noise: Noise, time: float) -> np.ndarray:
    """float64 [3], 0 .. 1: how far noise has moved after ``time``, modulo whole tiles."""
    moved = np.array([math.fmod(float(speed) * time, 1.0) for speed in noise.velocity])
    return moved - np.floor(moved)


def _trilinear(tile: np.ndarray, position: np.ndarray) -> np.ndarray:
    """float64 [..., 4], -1 .. 1, at ``position`` [..., 3] in tiles. Texel i sits at i / 32."""
    texel = (position - np.floor(position)) * TILE
    low = np.floor(texel).astype(np.int64)
    f = texel - low
    total = np.zeros((*position.shape[:-1], CHANNELS))
    for corner in range(8):
        step = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        x, y, z = np.moveaxis((low + step) % TILE, -1, 0)
        weight = np.where(step == 1, f, 1.0 - f).prod(axis=-1)
        total += weight[..., None] * tile[z, y, x]
    return total / 127.5 - 1.0
