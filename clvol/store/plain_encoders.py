"""Encoders that learn nothing: of labels, and of voxels that codes would not make smaller."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clvol.store.codecs.coded_blocks import CONSTANT, RAW, CodedBlocks
from clvol.store.codecs.encoding import Training
from clvol.store.codecs.labels import encode_labels, label_codebooks

_WITHOUT_CODES = "without_codes"  # of a policy: all blocks are stored as they are


class LabelEncoder:
    """A ``BlockEncoder`` of the codec "labels" for samples of ``dtype``."""

    def __init__(self, dtype: np.dtype) -> None:
        self.training = Training(label_codebooks(dtype))

    def encode(self, samples: np.ndarray) -> CodedBlocks:
        return encode_labels(samples)


class RawEncoder:
    """A ``BlockEncoder`` that stores constant blocks as such, and the samples of all others."""

    def __init__(self, training: Training) -> None:
        self.training = training

    def encode(self, samples: np.ndarray) -> CodedBlocks:
        little = np.ascontiguousarray(samples.astype(samples.dtype.newbyteorder("<"), copy=False))
        flat = little.reshape(len(samples), -1).view(np.uint8).reshape(len(samples), -1, samples.dtype.itemsize)
        constant = (flat == flat[:, :1]).all(axis=(1, 2))
        parts = [_block(*block) for block in zip(constant.tolist(), flat)]
        size = np.array([len(part) for part in parts], np.int64)
        return CodedBlocks(np.concatenate(parts), np.cumsum(size) - size, size)


def _block(constant: bool, samples: np.ndarray) -> np.ndarray:
    kind = np.array([CONSTANT if constant else RAW], np.uint8)
    return np.concatenate([kind, samples[0] if constant else samples.ravel()])


def without_codes(training: Training) -> Training:
    """``training`` for a ``RawEncoder``: with as few stages as the codec has, which compress to nothing."""
    books = training.codebooks
    stages = 0 if books.codec == "rvq" else books.stages
    empty = replace(books, entries=np.zeros_like(books.entries[:stages]), shifts=books.shifts[:stages])
    return Training(empty, {**training.policy, _WITHOUT_CODES: True})


def is_without_codes(training: Training) -> bool:
    """Whether ``training`` is one of ``without_codes``."""
    return training.policy.get(_WITHOUT_CODES) is True


def raw_block(block: np.ndarray) -> np.ndarray:
    """The bytes of a block whose samples are stored."""
    little = block.astype(block.dtype.newbyteorder("<"), copy=False)
    return _block(False, np.frombuffer(little.tobytes(), np.uint8))

