"""Sources of blocks of random codes, for tests."""

from __future__ import annotations

import numpy as np
from reference.plain_codes import write
from reference.random_codes import packed, random_block, random_codebooks

from clvol import Volume
from clvol.store.codecs.coded_blocks import WHOLE, Codebooks, CodedBlocks
from clvol.store.codecs.decode import decode_blocks
from clvol.store.geometry import BlockGrid
from clvol.store.resolutions import array_statistics


class RandomCodes:
    """A ``CodedSource``: every level of its own random codes, from a seed. ``depths`` int [blocks]: what ``read``
    cuts blocks at full resolution to; None: to nothing."""

    def __init__(self, shape, dtype: str, seed: int = 1, edge: int = 16, codec: str = "rvq", stages: int = 5) -> None:
        self.name, self.blocks = "random codes", BlockGrid(shape, edge)
        rng = np.random.default_rng(seed)
        self.codebooks: Codebooks = random_codebooks(rng, codec, dtype, stages)
        self.dtype = self.codebooks.values.dtype
        self.depths: np.ndarray | None = None
        self._codes: dict[int, CodedBlocks] = {}
        for level in range(self.blocks.levels):
            s = self.blocks.samples(level)
            blocks = [write(random_block(rng, s, self.codebooks), s, self.codebooks) for _ in range(self.blocks.count)]
            self._codes[level] = packed(blocks)
        z, y, x = self.blocks.counts
        whole = self.read(0, np.arange(self.blocks.count)).reshape(z, y, x, edge, edge, edge)
        voxels = whole.transpose(0, 3, 1, 4, 2, 5).reshape(edge * z, edge * y, edge * x)
        self.volume = Volume(np.ascontiguousarray(voxels[: shape[0], : shape[1], : shape[2]]))
        self.grid, self.value_range = self.volume.grid, self.volume.value_range
        self.nan_count, self.inf_count = self.volume.nan_count, self.volume.inf_count

    def read_codes(self, level: int, blocks) -> CodedBlocks:
        codes, blocks = self._codes[level], np.asarray(blocks)
        return CodedBlocks(codes.data, codes.start[blocks], codes.size[blocks])

    def read(self, level: int, blocks) -> np.ndarray:
        s, blocks = self.blocks.samples(level), np.asarray(blocks)
        out = np.empty((len(blocks), s, s, s), self.dtype)
        limits = np.full(len(blocks), WHOLE)
        if level == 0 and self.depths is not None:
            limits = self.depths[blocks]
        for limit in np.unique(limits):
            own = np.flatnonzero(limits == limit)
            out[own] = decode_blocks(self.read_codes(level, blocks[own]), s, self.codebooks, int(limit))
        ends = np.array(self.blocks.level_shape(level)) - self.blocks.places(blocks) * s
        for block, end in zip(out, np.minimum(ends, s)):
            index = np.ix_(*(np.minimum(np.arange(s), n - 1) for n in end))
            block[...] = block[index].copy()
        return out

    def statistics(self):
        yield from array_statistics(self.volume.data, self.blocks)
