"""Where the parts of blocks are in their bytes (clvol/store/codecs/coded_blocks.py), for many blocks at once.

Nothing here trusts the bytes: every place is clipped into its block, and ``good`` says which blocks are possible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.store.codecs.coded_blocks import (
    CODED,
    CONSTANT,
    ESCAPED,
    FIXED,
    MOST_STAGES,
    RAW,
    RAW_SAMPLES,
    Codebooks,
    CodedBlocks,
)

CODES_PER_SUBBLOCK = {"vq": 1, "vq-mean": 2, "hvq": 3}  # bytes of FIXED blocks, means included
_PART = 1 << 22  # samples that are looked at together


@dataclass(frozen=True, eq=False)
class Escapes:
    """Escaped sub-blocks: ``block`` and ``sub`` say whose they are; ``at`` is the place of the byte after the head in
    the data; ``stages`` and ``bits`` of residuals, or ``raw``. int64 [n] all of them, ``raw`` bool [n]."""

    block: np.ndarray
    sub: np.ndarray
    at: np.ndarray
    stages: np.ndarray
    bits: np.ndarray
    raw: np.ndarray


@dataclass(frozen=True, eq=False)
class CodedParts:
    """The parts of k blocks of the kind CODED, of n sub-blocks each.

    good     bool [k]: the bytes are possible
    means    uint8 [k, n]
    depths   uint8 [k, n]: number of stages; 0 of escaped sub-blocks and in octants that are not split
    stages   int64 [k, stages + 1]: where the codes of each stage begin in the data; the last one ends the stages
    escapes  None if decoding ends before them
    """

    good: np.ndarray
    means: np.ndarray
    depths: np.ndarray
    stages: np.ndarray
    escapes: Escapes | None


def parse_coded(
    data: np.ndarray, start: np.ndarray, size: np.ndarray, s: int, codebooks: Codebooks, limit: int = MOST_STAGES
) -> CodedParts:
    """The parts of the CODED blocks at ``start`` of ``size`` bytes (int64 [k], within ``data``), s >= 4."""
    octants, per_octant = (s // 8) ** 3 or 1, 8 if s > 4 else 1
    end, at = start + size, start + 1

    def byte(place: np.ndarray) -> np.ndarray:
        last = (end - 1).reshape(-1, *(1,) * (place.ndim - 1))
        return data[np.minimum(place, last)]

    good = np.ones(len(start), bool)
    if s == 4:
        split = np.ones((len(start), 1), bool)
    else:
        flag_bytes = (octants + 7) // 8
        flags = np.unpackbits(byte(at[:, None] + np.arange(flag_bytes)), axis=1, bitorder="little")
        good &= ~flags[:, octants:].any(axis=1)
        split = flags[:, :octants].astype(bool)
        at = at + flag_bytes
    wide = split.sum(axis=1)
    each = np.where(split, per_octant, 1)
    before = np.cumsum(each, axis=1) - each
    within = np.where(split[:, :, None], np.arange(per_octant), 0)
    means = byte((at[:, None] + before)[:, :, None] + within)
    at = at + octants + (per_octant - 1) * wide

    if s == 4:
        depths = byte(at[:, None])[:, :, None]
        at = at + 1
    else:
        order = (np.cumsum(split, axis=1) - split)[:, :, None] * per_octant + np.arange(per_octant)
        halves = byte(at[:, None, None] + (order >> 1)) >> (order & 1) * 4 & 15
        depths = np.where(split[:, :, None], halves, 0).astype(np.uint8)
        at = at + wide * per_octant // 2
    depths, means = (part.reshape(len(start), -1) for part in (depths, means))
    escaped = depths == ESCAPED
    good &= ((depths <= codebooks.stages) | escaped).all(axis=1)
    depths = np.where(escaped, 0, depths).astype(np.uint8)
    stages = np.repeat(at[:, None], codebooks.stages + 1, axis=1)
    for j in range(codebooks.stages):
        stages[:, j + 1] = stages[:, j] + (depths > j).sum(axis=1)
    if limit < codebooks.stages:
        good &= stages[:, limit] <= end
        return CodedParts(good, means, depths, stages, None)
    good &= stages[:, -1] <= end
    escapes, after = _parse_escapes(data, end, stages[:, -1], escaped, codebooks, good)
    good &= after == end
    return CodedParts(good, means, depths, stages, escapes)


def _parse_escapes(
    data: np.ndarray, end: np.ndarray, at: np.ndarray, escaped: np.ndarray, codebooks: Codebooks, good: np.ndarray
) -> tuple[Escapes, np.ndarray]:
    """The escapes of all blocks, and where each block's end. Clears ``good`` of blocks whose escapes are impossible."""
    block, sub = np.nonzero(escaped)
    count = escaped.sum(axis=1)
    first = np.cumsum(count) - count
    heads = np.zeros(len(block), np.int64)
    places = np.zeros(len(block), np.int64)
    at = at.copy()
    for turn in range(int(count.max(initial=0))):  # the place of an escape depends on the one before it
        own = np.flatnonzero((count > turn) & good & (at < end))
        good[(count > turn) & (at >= end)] = False
        head = data[at[own]].astype(np.int64)
        raw = head == RAW_SAMPLES
        stages, bits = head & 15, head >> 4
        good[own[~raw & ((stages > codebooks.stages) | (bits > 8))]] = False
        heads[first[own] + turn] = head
        places[first[own] + turn] = at[own] + 1
        at[own] += 1 + np.where(raw, 64 * codebooks.values.dtype.itemsize, stages + 8 * bits)
    raw = heads == RAW_SAMPLES
    return Escapes(block, sub, places, np.where(raw, 0, heads & 15), np.where(raw, 0, heads >> 4), raw), at


def kinds_of(coded: CodedBlocks) -> np.ndarray:
    """uint8 [k]: the first byte of each block, or 255 where a block is not within the data."""
    inside = (coded.start >= 0) & (coded.size > 0) & (coded.size <= len(coded.data) - coded.start)
    kinds = np.full(len(coded), 255, np.uint8)
    kinds[inside] = coded.data[coded.start[inside]]
    return kinds


def fixed_size(s: int, codebooks: Codebooks, limit: int = MOST_STAGES) -> int:
    """Bytes of a FIXED block, or of its prefix that decoding to ``limit`` stages needs."""
    left_out = max(codebooks.stages - limit, 0)
    return 1 + (CODES_PER_SUBBLOCK[codebooks.codec] - left_out) * (s // codebooks.side) ** 3


def check_codes(coded: CodedBlocks, s: int, codebooks: Codebooks, stages: int = MOST_STAGES) -> np.ndarray:
    """int64: numbers of the blocks whose bytes are impossible, in order.

    ``stages``: the limit to which they are to be decoded; with fewer than the codebooks have, bytes after those that
    are needed may be missing, and are not looked at.
    """
    kinds = kinds_of(coded)
    good = np.zeros(len(coded), bool)
    itemsize = codebooks.values.dtype.itemsize
    good |= (kinds == CONSTANT) & (coded.size == 1 + itemsize)
    good |= (kinds == RAW) & (coded.size == 1 + itemsize * s**3)
    if s >= 4 and codebooks.codec in CODES_PER_SUBBLOCK:
        least, whole = fixed_size(s, codebooks, stages), fixed_size(s, codebooks)
        good |= (kinds == FIXED) & (coded.size >= least) & (coded.size <= whole)
    if s >= 4 and codebooks.codec == "rvq":
        for blocks in parts(np.flatnonzero(kinds == CODED), s):
            good[blocks] = parse_coded(coded.data, coded.start[blocks], coded.size[blocks], s, codebooks, stages).good
    return np.flatnonzero(~good)


def prefix_sizes(coded: CodedBlocks, s: int, codebooks: Codebooks) -> np.ndarray:
    """int64 [k, stages + 1]: how many bytes decoding to a limit of 0, 1, ... stages needs of each block; the last
    column is the whole block. The blocks have passed ``check_codes``."""
    sizes = np.repeat(coded.size[:, None], codebooks.stages + 1, axis=1)
    kinds = kinds_of(coded)
    for limit in range(codebooks.stages):
        if codebooks.codec in CODES_PER_SUBBLOCK:
            sizes[kinds == FIXED, limit] = fixed_size(s, codebooks, limit)
    for blocks in parts(np.flatnonzero(kinds == CODED), s):
        found = parse_coded(coded.data, coded.start[blocks], coded.size[blocks], s, codebooks, 0)
        sizes[blocks, :-1] = (found.stages - coded.start[blocks, None])[:, :-1]
    return sizes


def parts(blocks: np.ndarray, s: int) -> list[np.ndarray]:
    """``blocks`` in parts of bounded memory."""
    each = max(_PART // s**3, 1)
    return [blocks[first : first + each] for first in range(0, len(blocks), each)]
