"""The lossless codec "labels": segmentations and masks, whose voxels are numbers of regions.

A block is the list of its labels and how they fill it, from coarse to fine: octants of 8^3 samples of one label,
sub-blocks of 4^3 of one label, and bits for the samples of the others; or runs, where they take less; or the samples
themselves, where nothing else does. After M. Piochowiak, C. Dachsbacher: Fast compressed segmentation volumes for
scientific visualization, IEEE Transactions on Visualization and Computer Graphics 30(1), 2024,
doi:10.1109/TVCG.2023.3326573, who also refine bricks from coarse to fine by a list of labels and a stream of
operations. Here operations have fixed lengths, so that a work-item decodes 64 samples at a time; entropy coding is left
to the compressor of the store.
"""

from __future__ import annotations

import numpy as np

from clvol.store.codecs.block_bytes import in_octants, parts
from clvol.store.codecs.codec import ZSTD, Codec, Kind
from clvol.store.codecs.coded_blocks import CONSTANT, ENTRIES, RAW, REGIONS, RUNS, Codebooks, CodedBlocks
from clvol.store.codecs.label_layout import (
    INDICES_OF_TYPE,
    MANY,
    MOST_LABELS,
    good_regions,
    good_runs,
    in_cells,
    index_bits,
    planes_of_type,
    regions_of,
    runs_of,
)
from clvol.store.codecs.working_values import WorkingValues

_HEAD = 2  # bytes of a kind and a number of labels
_LARGEST_TABLE = 1 << 24  # elements: blocks by labels


def label_codebooks(dtype: np.dtype) -> Codebooks:
    """What decoders take for "labels" of ``dtype`` (of one, two or four bytes): there are no codebooks."""
    none = np.zeros((0, ENTRIES, 64), np.int8)
    return Codebooks("labels", 4, none, np.zeros(0, np.int32), WorkingValues(np.dtype(dtype)))


def encode_labels(samples: np.ndarray) -> CodedBlocks:
    """The bytes of blocks of ``samples`` [k, s, s, s] of any type of one, two or four bytes, bit for bit."""
    k, s = samples.shape[:2]
    bits = np.ascontiguousarray(samples).view(f"u{samples.dtype.itemsize}")
    made = _Blocks(k, bits.dtype)
    flat = bits.reshape(k, s**3)
    constant = (flat == flat[:, :1]).all(axis=1)
    made.add(np.flatnonzero(constant), CONSTANT, [_as_bytes(flat[constant, :1])])
    for blocks in parts(np.flatnonzero(~constant), s):
        _encode_some(made, blocks, bits[blocks], s)
    return made.joined()


class _Blocks:
    """The bytes of blocks, kind by kind."""

    def __init__(self, count: int, dtype: np.dtype) -> None:
        self.dtype = dtype
        self._size = np.zeros(count, np.int64)
        self._pieces: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []  # blocks, size of each, their bytes

    def add(self, blocks: np.ndarray, kind: int, rows: list[np.ndarray]) -> None:
        """``blocks`` consist of ``kind`` and rows of bytes, uint8 [blocks, n]."""
        head = np.full((len(blocks), 1), kind, np.uint8)
        whole = np.concatenate([head, *rows], axis=1)
        self.add_joined(blocks, np.full(len(blocks), whole.shape[1]), whole.ravel())

    def add_joined(self, blocks: np.ndarray, size: np.ndarray, data: np.ndarray) -> None:
        """``blocks`` of ``size`` bytes each, which are one after another in ``data``."""
        self._size[blocks] = size
        self._pieces.append((blocks, size, data))

    def joined(self) -> CodedBlocks:
        start = np.cumsum(self._size) - self._size
        data = np.empty(int(self._size.sum()), np.uint8)
        for blocks, size, own in self._pieces:
            first = np.cumsum(size) - size
            data[np.repeat(start[blocks] - first, size) + np.arange(len(own))] = own
        return CodedBlocks(data, start, self._size)


def _as_bytes(bits: np.ndarray) -> np.ndarray:
    """uint8 [k, n] of unsigned integers [k, m], little-endian."""
    little = np.ascontiguousarray(bits.astype(bits.dtype.newbyteorder("<"), copy=False))
    return little.view(np.uint8).reshape(len(bits), bits.shape[1] * bits.dtype.itemsize)


def _encode_some(made: _Blocks, blocks: np.ndarray, bits: np.ndarray, s: int) -> None:
    """Encodes blocks [k, s, s, s] that are not constant."""
    distinct, number = _numbered(bits.reshape(len(bits), -1))
    if len(blocks) > 1 and len(blocks) * len(distinct) > _LARGEST_TABLE:
        half = len(blocks) // 2
        _encode_some(made, blocks[:half], bits[:half], s)
        _encode_some(made, blocks[half:], bits[half:], s)
        return
    rows = np.arange(len(bits))[:, None]
    present = np.zeros((len(bits), len(distinct)), bool)
    present[rows, number] = True
    labels = present.sum(axis=1)
    few = np.flatnonzero(labels <= MOST_LABELS)
    raw = np.full(len(bits), 1 + bits[0].nbytes)
    ranks = (np.cumsum(present[few], axis=1) - 1).astype(np.uint8)
    own = ranks[np.arange(len(few))[:, None], number[few]].reshape(-1, s, s, s)  # indices of the block's labels
    palette = _as_bytes(distinct[np.nonzero(present[few])[1]][:, None]).ravel()
    heads = _Heads(labels[few], palette, bits.dtype.itemsize)
    regions = _regions(heads, own) if s >= 4 and len(few) else None
    runs = _runs(heads, own) if s >= 4 and len(few) else None

    size = np.full((3, len(bits)), np.iinfo(np.int64).max)
    size[0] = raw
    for row, found in ((1, regions), (2, runs)):
        if found is not None:
            size[row, few] = found[0]
    best = size.argmin(axis=0)
    kept = np.flatnonzero(best == 0)
    made.add(blocks[kept], RAW, [_as_bytes(bits[kept].reshape(len(kept), s**3))])
    for row, found in ((1, regions), (2, runs)):
        if found is not None:
            kept_few = best[few] == row
            made.add_joined(blocks[few][kept_few], found[0][kept_few], found[1][np.repeat(kept_few, found[0])])


def _numbered(bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The different values, ascending, and for each value which of them it is."""
    if bits.dtype.itemsize > 2:
        distinct, number = np.unique(bits, return_inverse=True)
        return distinct, number.reshape(bits.shape)
    there = np.zeros(1 << 8 * bits.dtype.itemsize, bool)
    there[bits] = True
    return np.flatnonzero(there).astype(bits.dtype), (np.cumsum(there) - 1).astype(np.int32)[bits]


class _Heads:
    """Kinds and lists of labels of blocks: ``labels`` int64 [k] of them, and all their bytes one after another."""

    def __init__(self, labels: np.ndarray, palette: np.ndarray, itemsize: int) -> None:
        self.labels, self.palette = labels, palette
        self.size = _HEAD + labels * itemsize

    def put(self, out: np.ndarray, start: np.ndarray, kind: int) -> None:
        out[start] = kind
        out[start + 1] = self.labels - 1
        size = self.size - _HEAD
        out[np.repeat(start + _HEAD - (np.cumsum(size) - size), size) + np.arange(len(self.palette))] = self.palette


def _put_bits(out: np.ndarray, byte: np.ndarray, shift: np.ndarray, values: np.ndarray) -> None:
    """Adds ``values << shift`` to the bytes ``byte`` of ``out``, whose bits there are 0."""
    np.bitwise_or.at(out, byte, (values << shift).astype(np.uint8))


def _regions(heads: _Heads, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sizes int64 [k] and bytes of REGIONS blocks of the indices ``own`` uint8 [k, s, s, s] of their labels."""
    k, s = own.shape[:2]
    each = 8 if s > 4 else 1
    subs = in_octants(own)
    types, four = _types(subs)
    same = (subs == subs[:, :, :1]).all(axis=2).reshape(k, -1, each)
    split = np.ones((k, 1), bool)
    if s > 4:
        first = subs[:, :, 0].reshape(k, -1, 8)
        split = ~(same.all(axis=2) & (first == first[:, :, :1]).all(axis=2))
    wide = np.repeat(split, each, axis=1)  # [k, n]
    bits = index_bits(heads.labels)
    flag_bytes = (split.shape[1] + 7) // 8 if s > 4 else 0
    type_bytes = 2 * split.sum(axis=1) if s > 4 else np.ones(k, np.int64)

    # Indices: those of an octant that is not split stand with its first sub-block.
    leading = np.tile(np.arange(each) == 0, split.shape[1])
    counts = np.where(wide, INDICES_OF_TYPE[types], leading)
    before = np.cumsum(counts, axis=1) - counts
    index_bytes = (counts.sum(axis=1) * bits + 7) // 8
    planes, mixed, ones, cells = _planes(subs, types, four, np.where(wide, planes_of_type(types, bits), 0))
    of_block = np.repeat(np.arange(k), planes)
    mixed_of_block = np.bincount(of_block, mixed.sum(axis=1), minlength=k).astype(np.int64)

    size = heads.size + flag_bytes + type_bytes + index_bytes + 2 * planes + mixed_of_block
    start = np.cumsum(size) - size
    out = np.zeros(int(size.sum()), np.uint8)
    heads.put(out, start, REGIONS)
    at = start + heads.size
    if flag_bytes:
        out[at[:, None] + np.arange(flag_bytes)] = np.packbits(split, axis=1, bitorder="little")
        at = at + flag_bytes
    block, sub = np.nonzero(wide)
    order = (np.cumsum(wide, axis=1) - 1)[block, sub]
    _put_bits(out, at[block] + (order >> 2), (order & 3) * 2, types[block, sub])
    at = at + type_bytes
    for pick in range(4):
        block, sub = np.nonzero(counts > pick)
        place = (before[block, sub] + pick) * bits[block]
        _put_bits(out, at[block] + (place >> 3), place & 7, four[block, sub, pick].astype(np.int64))
    at = at + index_bytes
    head = at[of_block] + 2 * (np.arange(len(of_block)) - (np.cumsum(planes) - planes)[of_block])
    out[head] = np.packbits(mixed, axis=1, bitorder="little")[:, 0]
    out[head + 1] = np.packbits(ones, axis=1, bitorder="little")[:, 0]
    plane, cell = np.nonzero(mixed)
    nth = np.arange(len(plane)) - (np.cumsum(mixed_of_block) - mixed_of_block)[of_block[plane]]
    out[(at + 2 * planes)[of_block[plane]] + nth] = cells[plane, cell]
    return size, out


def _planes(
    subs: np.ndarray, types: np.ndarray, four: np.ndarray, count: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The planes of all blocks, ``count`` [k, n] of each sub-block: how many a block has, int64 [k]; and of each plane
    which cells are mixed, which consist of ones, bool [planes, 8], and the bits of cells, uint8 [planes, 8]."""
    first = (np.cumsum(count.ravel()) - count.ravel()).reshape(count.shape)
    cells = np.empty((int(count.sum()), 8), np.uint8)
    for p in range(int(count.max(initial=0))):
        block, sub = np.nonzero(count > p)
        samples = subs[block, sub]
        local = (samples[:, :, None] > four[block, sub][:, None, :3]).sum(axis=2)  # its place among four ascending
        numbers = np.where((types[block, sub] == MANY)[:, None], samples, local)
        cells[first[block, sub] + p] = np.packbits(in_cells(numbers) >> p & 1, axis=1, bitorder="little")
    return count.sum(axis=1), (cells != 0) & (cells != 255), cells == 255, cells


def _types(subs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Types int64 [k, n] of sub-blocks of indices uint8 [k, n, 64]; and uint8 [k, n, 4], ascending: their one, two, or
    three or four indices, of which the last is repeated."""
    low, high = subs.min(axis=2), subs.max(axis=2)
    inner = (subs != low[:, :, None]) & (subs != high[:, :, None])
    second = np.where(inner, subs, 255).min(axis=2)
    third = np.where(inner, subs, 0).max(axis=2)
    two = ~inner.any(axis=2)
    between = inner & (subs != second[:, :, None]) & (subs != third[:, :, None])
    types = np.where(low == high, 0, np.where(two, 1, np.where(between.any(axis=2), MANY, 2)))
    second, third = (np.where(two, high, inside) for inside in (second, third))
    three = ~two & (second == third)
    return types, np.stack([low, second, np.where(three, high, third), high], axis=2)


def _runs(heads: _Heads, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Likewise of RUNS blocks."""
    flat = own.reshape(len(own), -1)
    begins = np.ones(flat.shape, bool)
    begins[:, 1:] = flat[:, 1:] != flat[:, :-1]
    block, place = np.nonzero(begins)
    length = np.diff(block * flat.shape[1] + place, append=flat.size) - 1
    count = np.bincount(block, minlength=len(own))
    size = heads.size + 2 + 3 * count
    start = np.cumsum(size) - size
    out = np.zeros(int(size.sum()), np.uint8)
    heads.put(out, start, RUNS)
    at = start + heads.size
    out[at], out[at + 1] = count - 1 & 255, count - 1 >> 8
    order = np.arange(len(block)) - (np.cumsum(count) - count)[block]
    at = at + 2
    out[at[block] + 2 * order], out[at[block] + 2 * order + 1] = length & 255, length >> 8
    out[at[block] + 2 * count[block] + order] = flat[block, place]
    return size, out


CODEC = Codec("labels", True, ZSTD, {REGIONS: Kind(good_regions, regions_of), RUNS: Kind(good_runs, runs_of)})
