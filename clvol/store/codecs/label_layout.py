"""Where the parts of blocks of labels are in their bytes, what they decode to, and which of them are possible
(clvol/store/codecs/coded_blocks.py), for many blocks at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.store.codecs.block_bytes import bytes_before, in_block_order, samples_at, split_octants
from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks

MOST_LABELS = 256  # of a block that is not raw
INDICES_OF_TYPE = np.array([1, 2, 4, 0])
MANY = 3  # the type of sub-blocks of more than four labels


def index_bits(labels: np.ndarray) -> np.ndarray:
    """Bits of an index into as many ``labels``: 1, 2, 4 or 8."""
    return np.select([labels <= 2, labels <= 4, labels <= 16], [1, 2, 4], 8)


def planes_of_type(types: np.ndarray, bits: np.ndarray) -> np.ndarray:
    """Planes of sub-blocks of ``types`` [k, n] in blocks whose indices have ``bits`` [k]."""
    return np.where(types == MANY, bits[:, None], types)


@dataclass(frozen=True, eq=False)
class Regions:
    """Blocks [k] of the kind REGIONS, of n sub-blocks each. ``labels``: how many a block has; they are at ``at``;
    ``numbers`` uint8 [k, n, 64]: which of them each sample has. ``good`` bool [k]: the bytes are possible."""

    good: np.ndarray
    labels: np.ndarray
    at: np.ndarray
    numbers: np.ndarray


def parse_regions(data: np.ndarray, start: np.ndarray, size: np.ndarray, s: int, itemsize: int) -> Regions:
    """The REGIONS blocks at ``start`` of ``size`` bytes, int64 [k], s >= 4."""
    end, each = start + size, 8 if s > 4 else 1
    byte = bytes_before(data, end)
    labels = byte(start + 1).astype(np.int64) + 1
    palette = start + 2
    split, at, good = split_octants(byte, palette + labels * itemsize, s)
    k, octants = split.shape
    wide = split.sum(axis=1)

    order = (np.cumsum(split, axis=1) - split)[:, :, None] * each + np.arange(each)
    types = byte(at[:, None, None] + (order >> 2)) >> (order & 3) * 2 & 3
    types = np.where(split[:, :, None], types, 0)
    if s == 4:
        good &= byte(at) <= MANY
    at = at + (2 * wide if s > 4 else 1)

    bits = index_bits(labels)
    own = np.where(split[:, :, None], INDICES_OF_TYPE[types], 0)
    in_octant = np.where(split, own.sum(axis=2), 1)
    first = (np.cumsum(in_octant, axis=1) - in_octant)[:, :, None] + np.cumsum(own, axis=2) - own
    first, types = first.reshape(k, -1), types.reshape(k, -1)
    total = in_octant.sum(axis=1)
    picks = np.arange(4) if types.any() else np.arange(1)
    place = (first[:, :, None] + picks) * bits[:, None, None]
    indices = byte(at[:, None, None] + (place >> 3)) >> (place & 7) & ((1 << bits) - 1)[:, None, None]
    used = (picks < INDICES_OF_TYPE[types][:, :, None]) & (indices >= labels[:, None, None])
    good &= ~used.any(axis=(1, 2))
    at = at + (total * bits + 7) // 8

    planes = np.where(np.repeat(split, each, axis=1), planes_of_type(types, bits), 0)
    numbers, after = _numbers(data, at, end, planes, good)
    good &= after == end
    many = types == MANY
    good &= ~(many & (numbers.max(axis=2) >= labels[:, None])).any(axis=1)
    chosen = np.repeat(indices[:, :, :1].astype(np.uint8), 64, axis=2)
    block, sub = np.nonzero((types > 0) & ~many)
    chosen[block, sub] = np.take_along_axis(indices[block, sub].astype(np.uint8), numbers[block, sub].astype(int), 1)
    chosen[many] = numbers[many]
    return Regions(good, labels, palette, chosen)


def _numbers(
    data: np.ndarray, at: np.ndarray, end: np.ndarray, planes: np.ndarray, good: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers uint8 [k, n, 64] of samples from ``planes`` [k, n] at ``at``, and where what follows begins. Blocks whose
    planes are not within their bytes are not ``good`` any more."""
    count = planes.sum(axis=1)
    good &= at + 2 * count <= end
    own = np.where(good[:, None], planes, 0)
    count = own.sum(axis=1)
    block, sub = np.divmod(np.repeat(np.arange(own.size), own.ravel()), own.shape[1])
    order = np.arange(len(block)) - (np.cumsum(count) - count)[block]
    head = at[block] + 2 * order
    mixed = np.unpackbits(data[head][:, None], axis=1, bitorder="little").astype(bool)
    bits = -np.unpackbits(data[head + 1][:, None], axis=1, bitorder="little")  # 0 or 255 for each cell
    cells = mixed.sum(axis=1)
    cells_of = np.bincount(block, cells, minlength=len(at)).astype(np.int64)
    after = at + 2 * count + cells_of
    good &= after <= end
    plane, cell = np.nonzero(mixed & good[block][:, None])
    cells_of[~good] = 0
    nth = np.arange(len(plane)) - (np.cumsum(cells_of) - cells_of)[block[plane]]
    bits[plane, cell] = data[(at + 2 * count)[block[plane]] + nth]
    first = np.concatenate([[0], np.cumsum(own.ravel())[:-1]]).reshape(own.shape)[block, sub]
    numbers = np.zeros((*planes.shape, 64), np.uint8)
    samples = np.unpackbits(bits, axis=1, bitorder="little")
    nth_plane = np.arange(len(block)) - first
    for p in range(int(planes.max(initial=0))):
        those = np.flatnonzero(nth_plane == p)
        numbers[block[those], sub[those]] |= from_cells(samples[those]) << p
    return numbers, after


def from_cells(samples: np.ndarray) -> np.ndarray:
    """Samples [n, 64] of sub-blocks in C order, of samples in the order of cells of 2^3."""
    return samples.reshape(-1, 2, 2, 2, 2, 2, 2).transpose(0, 1, 4, 2, 5, 3, 6).reshape(-1, 64)


def in_cells(samples: np.ndarray) -> np.ndarray:
    """The inverse of ``from_cells``."""
    return samples.reshape(-1, 2, 2, 2, 2, 2, 2).transpose(0, 1, 3, 5, 2, 4, 6).reshape(-1, 64)


def _palette(data: np.ndarray, at: np.ndarray, labels: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """The labels of blocks, [k, most of them]; those that a block lacks repeat its last."""
    picks = np.minimum(np.arange(labels.max()), labels[:, None] - 1)
    return samples_at(data, (at[:, None] + picks * dtype.itemsize).ravel(), 1, dtype).reshape(picks.shape)


def good_regions(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    """As ``Kind.good``, of REGIONS blocks."""
    return parse_regions(coded.data, coded.start, coded.size, s, codebooks.values.dtype.itemsize).good


def regions_of(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    """As ``Kind.decode``, of REGIONS blocks."""
    dtype = codebooks.values.dtype
    found = parse_regions(coded.data, coded.start, coded.size, s, dtype.itemsize)
    palette = _palette(coded.data, found.at, found.labels, dtype)
    voxels = palette[np.arange(len(coded))[:, None, None], found.numbers]
    return in_block_order(voxels, s)


def parse_runs(
    data: np.ndarray, start: np.ndarray, size: np.ndarray, s: int, itemsize: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """``good`` bool [k] of RUNS blocks; and of the runs of good ones, one after another, the block, the length and the
    index of the label, int64 [runs] each."""
    end = start + size
    byte = bytes_before(data, end)
    labels = byte(start + 1).astype(np.int64) + 1
    at = start + 2 + labels * itemsize
    count = byte(at).astype(np.int64) + (byte(at + 1).astype(np.int64) << 8) + 1
    at = at + 2
    good = at + 3 * count == end
    own = np.flatnonzero(good)
    block = np.repeat(own, count[own])
    order = np.arange(len(block)) - np.repeat(np.cumsum(count[own]) - count[own], count[own])
    place = at[block] + 2 * order
    length = data[place].astype(np.int64) + (data[place + 1].astype(np.int64) << 8) + 1
    index = data[at[block] + 2 * count[block] + order].astype(np.int64)
    good &= np.bincount(block, length, minlength=len(start)) == s**3
    good[block[index >= labels[block]]] = False
    kept = good[block]
    return good, block[kept], length[kept], index[kept]


def good_runs(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    """As ``Kind.good``, of RUNS blocks."""
    return parse_runs(coded.data, coded.start, coded.size, s, codebooks.values.dtype.itemsize)[0]


def runs_of(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    """As ``Kind.decode``, of RUNS blocks."""
    dtype = codebooks.values.dtype
    _, block, length, index = parse_runs(coded.data, coded.start, coded.size, s, dtype.itemsize)
    label = samples_at(coded.data, coded.start[block] + 2 + index * dtype.itemsize, 1, dtype)[:, 0]
    return np.repeat(label, length).reshape(-1, s, s, s)
