"""Blocks whose sub-blocks all have the same stages: the kind FIXED of "vq", "vq-mean" and "hvq"."""

from __future__ import annotations

import numpy as np

from clvol.store.codecs.codec import Kind
from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks

NO_MEAN = 1 << 15  # in the place of (mean << 8) + 128 where a codec has no means


def fixed_kind(has_means: bool) -> Kind:
    """The kind FIXED of a codec whose sub-blocks have a mean, or not, and a code per stage."""

    def size(s: int, codebooks: Codebooks, limit: int) -> int:
        return 1 + (has_means + min(limit, codebooks.stages)) * (s // codebooks.side) ** 3

    def good(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
        whole = size(s, codebooks, codebooks.stages)
        return (coded.size >= size(s, codebooks, limit)) & (coded.size <= whole)

    def prefixes(coded: CodedBlocks, s: int, codebooks: Codebooks) -> np.ndarray:
        sizes = [size(s, codebooks, limit) for limit in range(codebooks.stages + 2)]
        return np.repeat(np.array([sizes], np.int64), len(coded), axis=0)

    def decode(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
        side, per_axis = codebooks.side, s // codebooks.side
        count = per_axis**3
        at = coded.start[:, None] + 1 + np.arange(count)
        working = np.full((len(coded), count), NO_MEAN, np.int32)
        if has_means:
            working = (coded.data[at].astype(np.int32) << 8) + 128
            at = at + count
        working = np.repeat(working[:, :, None], side**3, axis=2)
        for j in range(min(limit, codebooks.stages)):
            working += codebooks.shifted(j)[coded.data[at]]
            at = at + count
        voxels = codebooks.values.decoded(working).reshape(-1, *(per_axis,) * 3, *(side,) * 3)
        return voxels.transpose(0, 1, 4, 2, 5, 3, 6).reshape(-1, s, s, s)

    return Kind(good, decode, prefixes)
