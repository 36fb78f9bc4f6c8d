"""A trainer that needs no device, for tests of the store: few codes, taken from the voxels as they come.

It keeps to ``max_voxel_error``, and makes every kind of block. Its rates are nothing to compare with.
"""

from __future__ import annotations

import numpy as np

from clvol.store.codecs.coded_blocks import (
    CODED,
    CONSTANT,
    ENTRIES,
    ESCAPED,
    FIXED,
    RAW,
    RAW_SAMPLES,
    SHAPES,
    Codebooks,
    CodedBlocks,
)
from clvol.store.codecs.encoding import Training
from clvol.store.codecs.working_values import working_values

_CODES = 24


class StubTrainer:
    """``calls`` counts trainings."""

    def __init__(self) -> None:
        self.calls = 0

    def train(self, source, value_range, codec, target, seed=0, progress=None) -> Training:
        self.calls += 1
        side, fewest, _ = SHAPES[codec]
        stages = fewest or 1
        values = working_values(source.dtype, value_range)
        nz, ny, nx = source.shape
        rng = np.random.default_rng(seed)
        vectors = []
        for k in range(_CODES):
            if progress is not None:
                progress(k, _CODES)
            z, y, x = (int(rng.integers(0, max(n - side, 0) + 1)) for n in (nz, ny, nx))
            box = source.box(z, min(z + side, nz), y, min(y + side, ny), x, min(x + side, nx))
            box = np.pad(box, [(0, side - n) for n in box.shape], mode="edge")
            working = values.encoded(box).ravel()
            vectors.append(working - (32768 if codec == "vq" else int(working.mean())))
        entries = np.zeros((stages, ENTRIES, side**3), np.int8)
        shift = 8 if codec == "vq" else 7
        entries[0, : len(vectors)] = np.clip(np.array(vectors) >> shift, -128, 127)
        books = Codebooks(codec, side, entries, np.full(stages, shift, np.int32), values, 1)
        bound = None
        if target.max_voxel_error is not None:
            bound = target.max_voxel_error * (value_range[1] - value_range[0])
        return Training(books, {"bound": bound, "raw": True})  # a key that encoders have

    def encoder(self, training: Training) -> StubEncoder:
        return StubEncoder(training)


class StubEncoder:
    def __init__(self, training: Training) -> None:
        self.training = training

    def encode(self, samples: np.ndarray) -> CodedBlocks:
        parts = [self._block(block) for block in samples]
        size = np.array([len(part) for part in parts], np.int64)
        return CodedBlocks(np.concatenate(parts), np.cumsum(size) - size, size)

    def _block(self, block: np.ndarray) -> np.ndarray:
        books = self.training.codebooks
        s, side = len(block), books.side
        if (block == block.flat[0]).all():
            return _bytes([CONSTANT], block.ravel()[:1])
        if not np.isfinite(block).all():
            return _bytes([RAW], block)
        if books.codec == "rvq":
            half = 2 if s > 4 else 1
            octants = s // 8 or 1
            cut = block.reshape(octants, half, 4, octants, half, 4, octants, half, 4)
            voxels = cut.transpose(0, 3, 6, 1, 4, 7, 2, 5, 8).reshape(-1, 64)
        else:
            n = s // side
            voxels = block.reshape(n, side, n, side, n, side).transpose(0, 2, 4, 1, 3, 5).reshape(-1, side**3)
        working = books.values.encoded(voxels)
        means = working.mean(axis=1).astype(int) >> 8
        base = np.full(len(voxels), 32768) if books.codec == "vq" else (means << 8) + 128
        added = books.entries[0, :_CODES].astype(int) << int(books.shifts[0])
        found = base[:, None, None] + added
        codes = np.abs(found - working[:, None]).sum(axis=2).argmin(axis=1)
        decoded = books.values.decoded(found[np.arange(len(codes)), codes])
        bound = self.training.policy["bound"]
        wrong = np.zeros(len(codes), bool)
        if bound is not None:
            wrong = np.abs(decoded.astype(float) - voxels.astype(float)).max(axis=1) > bound * 0.999
        if books.codec == "vq":
            whole = _bytes([FIXED], codes.astype(np.uint8))
        elif books.codec == "vq-mean":
            whole = _bytes([FIXED], means.astype(np.uint8), codes.astype(np.uint8))
        elif books.codec == "hvq":
            whole = _bytes([FIXED], means.astype(np.uint8), codes.astype(np.uint8), np.zeros(len(codes), np.uint8))
        else:
            return self._coded(s, voxels, means, codes, wrong)
        return _bytes([RAW], block) if wrong.any() else whole

    def _coded(self, s: int, voxels: np.ndarray, means: np.ndarray, codes: np.ndarray, wrong: np.ndarray) -> np.ndarray:
        depths = np.where(wrong, ESCAPED, 1).astype(np.uint8)
        flags = [] if s == 4 else np.packbits(np.ones((s // 8) ** 3, np.uint8), bitorder="little")
        halves = depths if s == 4 else depths[::2] | depths[1::2] << 4
        heads = [RAW_SAMPLES] * int(wrong.sum())
        return _bytes(
            [CODED], flags, means.astype(np.uint8), halves, heads, codes[~wrong].astype(np.uint8), *voxels[wrong]
        )


def _bytes(*parts) -> np.ndarray:
    arrays = [np.asarray(part, np.uint8) if isinstance(part, list) else np.ascontiguousarray(part) for part in parts]
    return np.concatenate([np.frombuffer(array.tobytes(), np.uint8) for array in arrays])
