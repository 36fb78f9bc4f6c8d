"""Synthetic volumes of each kind that a first picture is chosen for, small and deterministic."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import clvol

N = 40


def _grid() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    z, y, x = np.mgrid[:N, :N, :N].astype(np.float32) - (N - 1) / 2
    return z, y, x, np.sqrt(x * x + y * y + z * z)


def distance_field() -> clvol.Volume:
    return clvol.Volume(_grid()[3] - 12.0)


def labels() -> clvol.Volume:
    z, y, x, r = _grid()
    array = np.zeros((N, N, N), np.uint16)
    for k, value in enumerate((3, 17, 18, 250, 999)):
        cx, cy, cz = 9 * np.cos(1.3 * k), 9 * np.sin(1.3 * k), 3.0 * k - 6
        array[(x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 < 36] = value
    return clvol.Volume(array)


def mask() -> clvol.Volume:
    z, y, x, _ = _grid()
    ring = (np.sqrt(x * x + y * y) - 11) ** 2 + z * z < 20
    return clvol.Volume((ring * 255).astype(np.uint8))


def solid() -> clvol.Volume:
    """A ball with a soft edge and a little noise, as micro-CT shows it; brighter by 800 than its background of 400."""
    noise = np.random.default_rng(3).normal(0, 8, (N, N, N))
    ball = np.clip(13.5 - _grid()[3], 0, 1) * 800
    return clvol.Volume((400 + ball + noise).astype(np.uint16))


def dark_solid() -> clvol.Volume:
    return clvol.Volume((3000 - solid().data.astype(int)).astype(np.uint16))


def two_materials() -> clvol.Volume:
    """A dense core in a shell that is half as bright."""
    r = _grid()[3]
    noise = np.random.default_rng(4).normal(0, 1.5, r.shape)
    array = 80 * np.clip(16.5 - r, 0, 1) + 120 * np.clip(8.5 - r, 0, 1) + noise
    return clvol.Volume(np.clip(array, 0, 255).astype(np.uint8))


def vessels() -> clvol.Volume:
    z, y, x, _ = _grid()
    near = np.minimum((x - 8 * np.sin(z / 6)) ** 2 + (y - 8 * np.cos(z / 6)) ** 2, x * x + (z - y) ** 2 / 2)
    return clvol.Volume((255 * np.clip(2.3 - np.sqrt(near), 0, 1)).astype(np.uint8))


def smooth() -> clvol.Volume:
    z, y, x, r = _grid()
    return clvol.Volume(np.exp(-((r / 14) ** 2)) * (1 + 0.3 * np.sin(x / 5)) * 1e-5)


def two_signs() -> clvol.Volume:
    z, y, x, r = _grid()
    return clvol.Volume(x * y * np.exp(-r / 4))


def microscopy() -> clvol.Volume:
    random = np.random.default_rng(5)
    z, y, x = np.mgrid[:24, :64, :64]
    light = np.zeros(z.shape)
    for _ in range(25):
        cz, cy, cx = random.uniform(4, 20), *random.uniform(8, 56, 2)
        light += random.uniform(40, 250) * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 16 - (z - cz) ** 2 / 8)
    return clvol.Volume((10 * random.poisson(light + 12)).astype(np.uint16), spacing=(0.2, 0.2, 0.5))


def hounsfield(offset: int = 0, dtype: type = np.int16) -> clvol.Volume:
    """A body: fat, muscle, a bone, in air."""
    z, y, x, _ = _grid()
    noise = np.random.default_rng(6).normal(0, 12, (N, N, N))
    body = (x / 17) ** 2 + (y / 12) ** 2
    array = np.where(body < 1, -100.0, -1000.0)
    array[body < 0.8] = 45.0
    array[(x / 4) ** 2 + ((y - 4) / 4) ** 2 < 1] = 900.0
    return clvol.Volume((array + noise + offset).clip(np.iinfo(dtype).min, None).astype(dtype))


def noise() -> clvol.Volume:
    return clvol.Volume(np.random.default_rng(2).normal(0, 1, (N, N, N)).astype(np.float32))


def holes() -> clvol.Volume:
    """A temperature with NaN where there is land."""
    z, y, x, r = _grid()
    array = (20 - 0.3 * np.abs(y) + 2 * np.sin(x / 9)).astype(np.float32)
    array[(x / 9) ** 2 + (y / 12) ** 2 < 1] = np.nan
    return clvol.Volume(array)


KINDS: dict[str, Callable[[], clvol.Volume]] = {
    "distance field": distance_field, "labels": labels, "mask": mask, "object": solid, "vessels": vessels,
    "smooth field": smooth, "signed field": two_signs, "microscopy": microscopy, "CT": hounsfield, "noise": noise,
}  # fmt: skip


def one_voxel() -> clvol.Volume:
    array = np.zeros((20, 24, 28), np.uint8)
    array[8, 12, 20] = 200
    return clvol.Volume(array)


HARD: dict[str, Callable[[], clvol.Volume]] = {
    "all NaN": lambda: clvol.Volume(np.full((6, 6, 6), np.nan, np.float32)),
    "constant": lambda: clvol.Volume(np.full((8, 8, 8), 7, np.uint8)),
    "one voxel": lambda: clvol.Volume(np.ones((1, 1, 1), np.float32)),
    "one bright voxel": one_voxel,
    "one slice": lambda: clvol.Volume(np.random.default_rng(1).random((1, 16, 16)).astype(np.float32)),
    "a line": lambda: clvol.Volume(np.arange(12, dtype=np.float32).reshape(1, 1, 12)),
    "two voxels": lambda: clvol.Volume(np.array([[[0, 5]]], np.uint8)),
    "infinities": lambda: clvol.Volume(np.where(_grid()[3] < 9, np.inf, _grid()[3]).astype(np.float32)),
    "huge": lambda: clvol.Volume(np.where(_grid()[3] < 9, 1e300, -1e300)),
    "tiny": lambda: clvol.Volume(np.where(_grid()[3] < 9, 3e-300, 1e-300)),
    "far from zero": lambda: clvol.Volume(1e9 + np.where(_grid()[3] < 9, 1e-3, 0.0)),
    "one NaN": lambda: clvol.Volume(np.where(_grid()[3] < 1, np.nan, 0.0).astype(np.float32)),
}
