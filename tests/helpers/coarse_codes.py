"""An encoder in a few lines, for tests of what becomes of codes: each 4^3 voxels are their mean."""

from __future__ import annotations

import numpy as np

from clvol.store.codecs.coded_blocks import CODED, CONSTANT, ENTRIES, RAW, Codebooks, CodedBlocks
from clvol.store.codecs.encoding import Training
from clvol.store.codecs.working_values import working_values


class CoarseTrainer:
    """A ``Trainer`` and a ``BlockEncoder``. ``trained``: the codecs and targets that were requested."""

    def __init__(self) -> None:
        self.trained: list[tuple] = []

    def train(self, source, value_range, codec, target, seed=0, progress=None) -> Training:
        self.trained.append((codec, target, seed))
        books = Codebooks(
            "rvq", 4, np.zeros((1, ENTRIES, 64), np.int8), np.zeros(1, np.int32),
            working_values(source.dtype, value_range),
        )  # fmt: skip
        if progress is not None:
            progress(1, 1)
        return Training(books)

    def encoder(self, training: Training) -> CoarseTrainer:
        self.training = training
        return self

    def encode(self, samples: np.ndarray) -> CodedBlocks:
        blocks = [self._block(block) for block in samples]
        size = np.array([len(block) for block in blocks], np.int64)
        return CodedBlocks(np.concatenate(blocks), np.cumsum(size) - size, size)

    def _block(self, block: np.ndarray) -> np.ndarray:
        if (block == block.flat[0]).all():
            return np.frombuffer(bytes([CONSTANT]) + block.flat[0].tobytes(), np.uint8)
        if not np.isfinite(block).all():
            return np.frombuffer(bytes([RAW]) + block.tobytes(), np.uint8)
        s = block.shape[0]
        working = self.training.codebooks.values.encoded(block)
        octants = working.reshape(s // 8, 2, 4, s // 8, 2, 4, s // 8, 2, 4).transpose(0, 3, 6, 1, 4, 7, 2, 5, 8)
        means = np.round(octants.reshape(-1, 64).mean(axis=1) / 256).clip(0, 255).astype(np.uint8)
        flags = np.full(max((s // 8) ** 3 // 8, 1), 0xFF, np.uint8)
        return np.concatenate([[CODED], flags, means, np.zeros(len(means) // 2, np.uint8)]).astype(np.uint8)
