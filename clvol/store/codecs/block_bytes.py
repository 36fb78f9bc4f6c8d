"""Reading the bytes of many blocks at once, without trusting them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from clvol.store.codecs.coded_blocks import CodedBlocks

_PART = 1 << 20  # samples that are looked at together

ByteAt: TypeAlias = "Callable[[np.ndarray], np.ndarray]"


def bytes_before(data: np.ndarray, end: np.ndarray) -> ByteAt:
    """A function that reads bytes at places int64 [k, ...]; places from ``end`` int64 [k] on give the last byte."""

    def byte(place: np.ndarray) -> np.ndarray:
        return data[np.minimum(place, (end - 1).reshape(-1, *(1,) * (place.ndim - 1)))]

    return byte


def split_octants(byte: ByteAt, at: np.ndarray, s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flags at ``at``: which octants are split, bool [k, octants]; where what follows begins; and whether they are
    possible, bool [k]."""
    if s == 4:
        return np.ones((len(at), 1), bool), at, np.ones(len(at), bool)
    octants = (s // 8) ** 3
    count = (octants + 7) // 8
    flags = np.unpackbits(byte(at[:, None] + np.arange(count)), axis=1, bitorder="little")
    return flags[:, :octants].astype(bool), at + count, np.asarray(~flags[:, octants:].any(axis=1))


def kinds_of(coded: CodedBlocks) -> np.ndarray:
    """uint8 [k]: the first byte of each block, or 255 where a block is not within the data."""
    inside = (coded.start >= 0) & (coded.size > 0) & (coded.size <= len(coded.data) - coded.start)
    kinds = np.full(len(coded), 255, np.uint8)
    kinds[inside] = coded.data[coded.start[inside]]
    return kinds


def parts(blocks: np.ndarray, s: int) -> list[np.ndarray]:
    """``blocks`` in parts of bounded memory."""
    each = max(_PART // s**3, 1)
    return [blocks[first : first + each] for first in range(0, len(blocks), each)]


def samples_at(data: np.ndarray, at: np.ndarray, count: int, dtype: np.dtype) -> np.ndarray:
    """``count`` samples of ``dtype`` from each place ``at`` int64 [k] on: [k, count]."""
    found = data[at[:, None] + np.arange(count * dtype.itemsize)]
    return found.view(dtype.newbyteorder("<")).astype(dtype, copy=False)


def in_block_order(subblocks: np.ndarray, s: int) -> np.ndarray:
    """Samples [k, s, s, s] of sub-blocks of 4^3 [k, n, 64], which are in octants."""
    octants, half = (s // 8, 2) if s > 4 else (1, 1)
    parted = subblocks.reshape(-1, octants, octants, octants, half, half, half, 4, 4, 4)
    return parted.transpose(0, 1, 4, 7, 2, 5, 8, 3, 6, 9).reshape(-1, s, s, s)


def in_octants(samples: np.ndarray) -> np.ndarray:
    """The inverse of ``in_block_order``: [k, n, 64] of samples [k, s, s, s]."""
    s = samples.shape[-1]
    octants, half = (s // 8, 2) if s > 4 else (1, 1)
    parted = samples.reshape(-1, octants, half, 4, octants, half, 4, octants, half, 4)
    return parted.transpose(0, 1, 4, 7, 2, 5, 8, 3, 6, 9).reshape(len(samples), -1, 64)
