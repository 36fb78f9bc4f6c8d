"""Packs: the bytes of neighbouring coded blocks as one chunk of a fixed size.

A pack holds ``side``^3 blocks in C order. It begins with the number of bytes of each block, as uint32 whose lowest
bytes of all blocks come first, then the second ones, and so on (the upper ones are equal, and cost nothing once
compressed); then come the blocks' bytes one after the other, and zeros up to the capacity. A place beyond the volume's
last block has no bytes.
"""

from __future__ import annotations

import numpy as np

from clvol.store.codecs.coded_blocks import CodedBlocks

_SIDES = (4, 3, 2, 1)
_INDEX = 4  # bytes per block


def side(blocks: int) -> int:
    """Blocks per axis of a pack, where a shard has ``blocks``."""
    return next(n for n in _SIDES if blocks % n == 0)


def capacity(count: int, raw: int) -> int:
    """Bytes of a pack of ``count`` blocks, each of which takes ``raw`` bytes and its kind at most."""
    return count * (_INDEX + 1 + raw)


def packed(coded: CodedBlocks, counts: tuple[int, int, int], side: int, capacity: int) -> np.ndarray:
    """The packs, uint8 [z, y, x capacity], of the blocks [z, y, x] = ``counts`` of a region in C order."""
    along = tuple(-(-n // side) for n in counts)
    out = np.zeros((*along, capacity), np.uint8)
    numbers = np.arange(len(coded)).reshape(counts)
    for place in np.ndindex(along):
        corner = tuple(slice(p * side, (p + 1) * side) for p in place)
        own = numbers[corner]
        sizes = np.zeros((side,) * 3, "<u4")
        sizes[tuple(map(slice, own.shape))] = coded.size[own]
        index = sizes.reshape(-1, 1).view(np.uint8).T.ravel()
        first = coded.start[own].ravel().tolist()
        parts = [coded.data[a : a + n] for a, n in zip(first, coded.size[own].ravel().tolist())]
        joined = np.concatenate([index, *parts])
        out[place][: len(joined)] = joined
    return out.reshape(*along[:2], -1)


def unpacked(packs: np.ndarray, pack: np.ndarray, slot: np.ndarray, side: int) -> CodedBlocks:
    """The blocks at ``slot`` (int64 [k]) of the packs number ``pack`` (int64 [k]) of ``packs`` (uint8 [n, capacity]),
    whose bytes they share. Blocks that would end beyond their pack have no bytes, which is impossible."""
    count, size = side**3, packs.shape[1]
    index = np.ascontiguousarray(packs[:, : _INDEX * count]).reshape(-1, _INDEX, count)
    sizes = np.ascontiguousarray(index.transpose(0, 2, 1)).view("<u4")[..., 0].astype(np.int64)
    ends = _INDEX * count + np.cumsum(sizes, axis=1)
    starts = ends - sizes
    sizes[ends > size] = 0  # no block has no bytes, so these are found to be impossible
    starts += np.arange(len(packs))[:, None] * size
    return CodedBlocks(packs.reshape(-1), starts[pack, slot], sizes[pack, slot])
