"""Volumes, blocks and trained encoders for the tests of encoders."""

from __future__ import annotations

import numpy as np

from clvol.encoding.codebook import rounded, shift_for
from clvol.encoding.policy import Policy
from clvol.encoding.trainer import CodeTrainer
from clvol.store.codecs.coded_blocks import Codebooks, RateTarget
from clvol.store.codecs.encoding import Training
from clvol.store.codecs.working_values import working_values
from clvol.store.voxel_source import VolumeSource
from clvol.volume.volume import Volume

CODECS = ("vq", "vq-mean", "hvq", "rvq")
TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.float32)


def smooth(shape=(40, 36, 33), seed=0) -> np.ndarray:
    """A smooth field 0 ... 1 with an edge and a little noise."""
    rng = np.random.default_rng(seed)
    z, y, x = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
    field = 0.5 + 0.3 * np.sin(7 * z + 3 * x) * np.cos(5 * y) + 0.2 * (x + y > 1.1)
    return np.clip(field + rng.normal(0, 0.004, shape), 0, 1)


def as_type(field: np.ndarray, dtype) -> np.ndarray:
    if np.dtype(dtype).kind == "f":
        return (field * 3e3 - 700).astype(dtype)
    info = np.iinfo(dtype)
    return np.rint(info.min + field * (int(info.max) - info.min)).astype(dtype)


def range_of(voxels: np.ndarray) -> tuple[float, float]:
    finite = voxels[np.isfinite(voxels)]
    return (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)


def blocks_of(voxels: np.ndarray, edge: int, mode="edge") -> np.ndarray:
    padded = np.pad(voxels, [(0, -n % edge) for n in voxels.shape], mode=mode)
    z, y, x = (n // edge for n in padded.shape)
    return padded.reshape(z, edge, y, edge, x, edge).transpose(0, 2, 4, 1, 3, 5).reshape(-1, edge, edge, edge)


def trained(context, voxels: np.ndarray, codec: str, **target: float):
    trainer = CodeTrainer(context)
    training = trainer.train(VolumeSource(Volume(voxels)), range_of(voxels), codec, RateTarget(**target), seed=3)
    return training, trainer.encoder(training)


def by_hand(voxels: np.ndarray, policy: Policy, stages: int) -> Training:
    """A training for "rvq" of ``stages``, more than are worth it for a small volume: the codewords of a stage are what
    some sub-blocks have left. Of the second stage few codewords are used."""
    values = working_values(voxels.dtype, range_of(voxels))
    blocks = blocks_of(values.encoded(voxels), 4).reshape(-1, 64)
    left = blocks - ((blocks.sum(axis=1) >> 14 << 8) + 128)[:, None]
    rng, entries, shifts = np.random.default_rng(5), [], []
    for stage in range(stages):
        words = left[rng.choice(len(left), 200 if stage == 1 else 256, replace=False)]
        shifts.append(shift_for(words))
        entries.append(rounded(words, shifts[-1]))
        wide = entries[-1].astype(np.int64) << shifts[-1]
        scores = 2 * left @ wide.T - (wide * wide).sum(axis=1)
        left = left - wide[scores.argmax(axis=1)]
    books = Codebooks("rvq", 4, np.array(entries), np.array(shifts, np.int32), values, policy.residual_step)
    return Training(books, policy.to_json())
