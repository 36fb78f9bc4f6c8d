"""The bytes of blocks from what was chosen for them (the layout of ``clvol.store.codecs.coded_blocks``), vectorised."""

from __future__ import annotations

import numpy as np

from clvol.store.codecs.coded_blocks import CODED, CONSTANT, ESCAPED, FIXED, RAW, RAW_SAMPLES, CodedBlocks

# Sub-blocks of an octant in z-order are its 2^3 sub-blocks in C order; octants of a block are in C order.


def in_octants(cells: np.ndarray, subs: int) -> np.ndarray:
    """Cells [k, n, n, n] of blocks, one per sub-block, as [octants, subs]; anything may follow the four axes."""
    k, n, rest = len(cells), cells.shape[1], cells.shape[4:]
    if subs == 1:
        return cells.reshape(k * n**3, 1, *rest)
    per_axis = n // 2
    split = cells.reshape(k, per_axis, 2, per_axis, 2, per_axis, 2, *rest)
    following = tuple(range(7, 7 + len(rest)))
    return split.transpose(0, 1, 3, 5, 2, 4, 6, *following).reshape(k * per_axis**3, 8, *rest)


def samples_of(blocks: np.ndarray, octant: np.ndarray, sub: np.ndarray) -> np.ndarray:
    """The samples [n, 64] of the sub-blocks ``sub`` of ``octant`` (both [n]) of blocks [k, s, s, s]."""
    edge = blocks.shape[1]
    per_axis = max(1, edge // 8)
    block, inside = np.divmod(octant, per_axis**3)
    z, y, x = np.unravel_index(inside, (per_axis,) * 3)
    corner = np.stack([8 * z + 4 * (sub >> 2), 8 * y + 4 * (sub >> 1 & 1), 8 * x + 4 * (sub & 1)])
    place = np.arange(64)
    z, y, x = corner[:, :, None] + np.stack([place >> 4, place >> 2 & 3, place & 3])[:, None]
    return blocks[block[:, None], z, y, x]


class _Writer:
    """Bytes of many blocks, written piece after piece: each block has its own next place."""

    def __init__(self, sizes: np.ndarray) -> None:
        self.size = sizes.astype(np.int64)
        self.start = np.cumsum(self.size) - self.size
        self.data = np.zeros(int(self.size.sum()), np.uint8)
        self.next = self.start.copy()

    def rows(self, blocks: np.ndarray, rows: np.ndarray) -> None:
        """The bytes ``rows`` [n, m], a row for each of ``blocks``."""
        self.data[self.next[blocks, None] + np.arange(rows.shape[1])] = rows
        self.next[blocks] += rows.shape[1]

    def pieces(self, blocks: np.ndarray, values: np.ndarray) -> None:
        """One row of ``values`` ([n] or [n, m]) after another for the blocks named by ``blocks`` [n], ascending."""
        if not len(blocks):
            return
        width = 1 if values.ndim == 1 else values.shape[1]
        self.varied(blocks, np.full(len(blocks), width), values.reshape(-1))

    def varied(self, blocks: np.ndarray, lengths: np.ndarray, data: np.ndarray) -> None:
        """As ``pieces``, with ``lengths`` [n] of bytes one after another in ``data``."""
        counts = np.bincount(blocks, lengths, minlength=len(self.size)).astype(np.int64)
        before = np.cumsum(counts) - counts  # in `data`
        moved = np.repeat((self.next - before)[blocks], lengths)
        self.data[moved + np.arange(len(data))] = data
        self.next += counts

    def blocks(self) -> CodedBlocks:
        return CodedBlocks(self.data, self.start, self.size)


def as_bytes(samples: np.ndarray) -> np.ndarray:
    """uint8 [n, m]: the bytes of ``samples`` [n, ...], little-endian."""
    little = np.ascontiguousarray(samples, samples.dtype.newbyteorder("<"))
    return little.reshape(len(samples), int(np.prod(samples.shape[1:]))).view(np.uint8)


def packed_bits(values: np.ndarray, bits: int) -> np.ndarray:
    """uint8 [n, m bits / 8]: ``values`` [n, m] in two's complement, the lowest bit first."""
    single = (values[:, :, None] >> np.arange(bits) & 1).astype(np.uint8)
    return np.packbits(single.reshape(len(values), -1), axis=1, bitorder="little")


def _write_plain(writer: _Writer, kinds: np.ndarray, samples: np.ndarray, constants: np.ndarray) -> None:
    """Constant and raw blocks whole, and the kind of all."""
    writer.rows(np.arange(len(kinds)), kinds[:, None])
    constant, raw = np.flatnonzero(kinds == CONSTANT), np.flatnonzero(kinds == RAW)
    writer.rows(constant, as_bytes(constants[constant, None]))
    writer.rows(raw, as_bytes(samples[raw]))


def _plain_sizes(kinds: np.ndarray, samples: np.ndarray) -> np.ndarray:
    itemsize = samples.dtype.itemsize
    voxels = int(np.prod(samples.shape[1:]))
    return np.select([kinds == CONSTANT, kinds == RAW], [1 + itemsize, 1 + voxels * itemsize], 1).astype(np.int64)


def pack_fixed(
    kinds: np.ndarray, samples: np.ndarray, constants: np.ndarray, parts: list[np.ndarray]
) -> CodedBlocks:
    """Blocks of which those of kind FIXED consist of ``parts``, each uint8 [k, m]."""
    sizes = _plain_sizes(kinds, samples)
    fixed = np.flatnonzero(kinds == FIXED)
    sizes[fixed] += sum(part.shape[1] for part in parts)
    writer = _Writer(sizes)
    _write_plain(writer, kinds, samples, constants)
    for part in parts:
        writer.rows(fixed, part[fixed])
    return writer.blocks()


def pack_coded(
    kinds: np.ndarray, samples: np.ndarray, constants: np.ndarray, means: np.ndarray, split: np.ndarray,
    depths: np.ndarray, codes: np.ndarray, escapes: np.ndarray, escaped: np.ndarray, residuals: np.ndarray,
) -> CodedBlocks:  # fmt: skip
    """Blocks of which those of kind CODED consist of stages ("rvq").

    ``means`` uint8 [octants, subs + 1], ``split`` bool [octants], ``depths`` and ``escapes`` uint8 [octants, subs],
    ``codes`` uint8 [octants, subs, stages]. ``escaped`` int64 [n]: flat places of escaped sub-blocks of CODED blocks,
    ascending; ``residuals`` int32 [n, 64], where ``escapes`` asks for them.
    """
    k, (octants, subs) = len(kinds), depths.shape
    per_block = octants // k
    block = np.repeat(np.arange(k), per_block)
    split = split & (kinds == CODED)[block]
    coded = np.flatnonzero(kinds == CODED)
    whole = ~split & (kinds == CODED)[block]

    # Sub-blocks of split octants, in order.
    own = np.flatnonzero(split)
    depth = depths[own].reshape(-1)
    code = codes[own].reshape(len(depth), codes.shape[-1])
    place = np.repeat(block[own], subs)
    heads = escapes.reshape(-1)[escaped]
    head = escapes[own].reshape(-1)
    stages = np.where(depth == ESCAPED, np.where(head == RAW_SAMPLES, 0, head & 15), depth)

    lengths, tails = _tails(samples, subs, heads, escaped, residuals)
    escaped_block = block[escaped // subs]

    flags = (per_block + 7) // 8 if subs == 8 else 0
    sizes = _plain_sizes(kinds, samples)
    sizes[coded] += flags
    bytes_split = 12 if subs == 8 else 2  # means and depths
    sizes += np.bincount(block, split * bytes_split + whole, minlength=k).astype(np.int64)
    sizes += np.bincount(place, stages, minlength=k).astype(np.int64)
    sizes += np.bincount(escaped_block, 1 + lengths, minlength=k).astype(np.int64)

    writer = _Writer(sizes)
    _write_plain(writer, kinds, samples, constants)
    if flags:
        bits = np.packbits(split.reshape(k, per_block), axis=1, bitorder="little")
        writer.rows(coded, bits[coded])
    number = np.where(split, subs, whole.astype(np.int64))
    kept = np.where(split[:, None], np.arange(subs + 1) < subs, whole[:, None] & (np.arange(subs + 1) == subs))
    some = np.flatnonzero(number)
    writer.varied(block[some], number[some], means[kept])
    if subs == 8:
        pairs = depth.reshape(-1, 2)
        writer.pieces(place[::2], pairs[:, 0] | pairs[:, 1] << 4)
    else:
        writer.pieces(place, depth)
    writer.pieces(escaped_block, heads)
    for stage in range(int(stages.max(initial=0))):
        deep = np.flatnonzero(stages > stage)
        writer.pieces(place[deep], code[deep, stage])
    writer.varied(escaped_block, lengths, tails)
    return writer.blocks()


def _tails(
    samples: np.ndarray, subs: int, heads: np.ndarray, escaped: np.ndarray, residuals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lengths int64 [n] and bytes of the residuals or samples of escaped sub-blocks, one after another."""
    raw = heads == RAW_SAMPLES
    bits = np.where(raw, 0, heads >> 4).astype(np.int64)
    lengths = 8 * bits
    lengths[raw] = 64 * samples.dtype.itemsize
    start = np.cumsum(lengths) - lengths
    data = np.zeros(int(lengths.sum()), np.uint8)
    for width in range(1, 9):
        own = np.flatnonzero(bits == width)
        if len(own):
            data[start[own, None] + np.arange(8 * width)] = packed_bits(residuals[own], width)
    own = np.flatnonzero(raw)
    if len(own):
        octant, sub = np.divmod(escaped[own], subs)
        rows = as_bytes(samples_of(samples, octant, sub))
        data[start[own, None] + np.arange(rows.shape[1])] = rows
    return lengths, data
