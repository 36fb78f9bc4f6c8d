"""Sources of blocks that are codes."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from clvol.store.codecs.coded_blocks import RAW, Codebooks, CodedBlocks
from clvol.store.source import BlockSource

FEWEST = 4  # samples per axis of a block of codes


class CodedSource(BlockSource, Protocol):
    """A ``BlockSource`` whose blocks, of every level of four and more samples per axis, are codes."""

    codebooks: Codebooks

    def read_codes(self, level: int, blocks: np.ndarray) -> CodedBlocks:
        """The bytes of ``blocks`` (numbers, int64 [k]) at ``level``, in that order; possible codes. VolumeError names
        the block that cannot be read."""
        ...


def codes_at(source: CodedSource, level: int, blocks: np.ndarray) -> CodedBlocks:
    """The bytes of ``blocks`` at ``level``. Blocks of fewer samples per axis than codes have are as they are (RAW)."""
    if source.blocks.samples(level) >= FEWEST:
        return source.read_codes(level, blocks)
    bytes_each = source.blocks.samples(level) ** 3 * source.dtype.itemsize
    each = np.ascontiguousarray(source.read(level, blocks)).reshape(-1).view(np.uint8).reshape(len(blocks), bytes_each)
    data = np.concatenate([np.full((len(blocks), 1), RAW, np.uint8), each], axis=1)
    size = np.full(len(blocks), data.shape[1], np.int64)
    return CodedBlocks(data.ravel(), np.cumsum(size) - size, size)


def is_coded(source: BlockSource) -> bool:
    """Whether ``source`` has codes at all levels that can."""
    if getattr(source, "codebooks", None) is None or not hasattr(source, "read_codes"):
        return False
    layout = getattr(source, "layout", None)
    deep = [level for level in range(source.blocks.levels) if source.blocks.samples(level) >= FEWEST]
    return layout is None or all(layout.codecs[level].coded for level in deep)
