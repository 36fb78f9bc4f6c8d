"""The codec "rvq": residual vector quantisation, whose depth is chosen per sub-block. The one to use for what is lossy.

A sub-block of 4^3 samples is its mean and a sum of entries of codebooks, as many as pay: B.-H. Juang, A. H. Gray:
Multiple stage vector quantization for speech coding, ICASSP 1982; for volumes R. Parys, G. Knittel: Giga-voxel
rendering from compressed data on a display wall, WSCG 2009, who decode small subvolumes and render them front to back.
What is added here: octants of 8^3 samples of one value, depths by the Lagrangian of error and bytes, and packed
residuals or raw samples where a bound on the error, or voxels that are not finite, demand them. Stages are stored one
after another, so that a prefix of a block's bytes is the block at a lower quality.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.store.codecs.block_bytes import bytes_before, in_block_order, samples_at, split_octants
from clvol.store.codecs.codec import ZSTD, Codec, Kind
from clvol.store.codecs.coded_blocks import CODED, ESCAPED, MOST_STAGES, RAW_SAMPLES, Codebooks, CodedBlocks
from clvol.store.codecs.working_values import LARGEST


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
    per_octant = 8 if s > 4 else 1
    end = start + size
    byte = bytes_before(data, end)
    split, at, good = split_octants(byte, start + 1, s)
    octants = split.shape[1]
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
    depths, means = (part.reshape(len(start), octants * per_octant) for part in (depths, means))
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
    codes = np.arange(256)
    stages, bits, raw = codes & 15, codes >> 4, codes == RAW_SAMPLES
    lengths = np.where(raw, 1 + 64 * codebooks.values.dtype.itemsize, 1 + stages + 8 * bits)  # by the first byte
    impossible = ~raw & ((stages > codebooks.stages) | (bits > 8))

    # The place of an escape depends on the one before it, so a turn takes one of each block, the longest lists first.
    order = np.argsort(-count, kind="stable")
    left = len(order) - np.searchsorted(np.sort(count), np.arange(int(count.max(initial=0))), side="right")
    first, places, last = (np.cumsum(count) - count)[order], at[order], end[order] - 1
    found = np.zeros(len(block), np.int64)
    heads = np.zeros(len(block), np.uint8)
    for turn, those in enumerate(left.tolist()):
        head = data[np.minimum(places[:those], last[:those])]
        found[first[:those] + turn] = places[:those] + 1
        heads[first[:those] + turn] = head
        places[:those] += lengths[head]
    good[block[impossible[heads]]] = False
    at = np.empty_like(places)
    at[order] = places
    is_raw = raw[heads]
    stages, bits = np.where(is_raw, 0, stages[heads]), np.where(is_raw, 0, bits[heads])
    return Escapes(block, sub, found, stages, bits, is_raw), at


def _parsed(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> CodedParts:
    return parse_coded(coded.data, coded.start, coded.size, s, codebooks, limit)


def _good(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    """As ``_parsed(...).good``, in a fraction of the time where no sub-block is escaped."""
    end, each = coded.start + coded.size, 8 if s > 4 else 1
    byte = bytes_before(coded.data, end)
    split, at, good = split_octants(byte, coded.start + 1, s)
    wide = split.sum(axis=1)
    at = at + split.shape[1] + (each - 1) * wide
    count = (wide * each + 1) // 2
    picks = np.arange((split.shape[1] * each + 1) // 2)
    depths = np.where(picks < count[:, None], byte(at[:, None] + picks), 0)

    halves = np.arange(256)[:, None] >> np.array([0, 4]) & 15  # of a byte of depths
    escapes = halves == ESCAPED
    impossible = ((halves > codebooks.stages) & ~escapes).any(axis=1)
    if s == 4:
        impossible |= halves[:, 1] > 0
    codes = np.where(escapes, 0, np.minimum(halves, limit)).sum(axis=1)
    good &= ~impossible[depths].any(axis=1)
    at = at + count + codes[depths].sum(axis=1)
    if limit < codebooks.stages:
        return good & (at <= end)
    escaped = escapes.any(axis=1)[depths].any(axis=1)
    good &= (at == end) | escaped
    own = np.flatnonzero(good & escaped)
    possible = np.ones(len(own), bool)
    of_subs = escapes[depths[own]].reshape(len(own), -1) if len(own) else np.zeros((0, 1), bool)
    _, after = _parse_escapes(coded.data, end[own], at[own], of_subs, codebooks, possible)
    good[own] = possible & (after == end[own])
    return good


def _prefixes(coded: CodedBlocks, s: int, codebooks: Codebooks) -> np.ndarray:
    sizes = _parsed(coded, s, codebooks, 0).stages - coded.start[:, None]
    sizes[:, -1] = coded.size
    return sizes


def _decode(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    found = _parsed(coded, s, codebooks, limit)
    # Deepest first, so that the sub-blocks of each stage are the first ones.
    depths = found.depths.ravel()
    order = np.argsort(MOST_STAGES - depths, kind="stable")
    sums = np.repeat((found.means.astype(np.int32).ravel()[order] << 8)[:, None] + 128, 64, axis=1)
    for j in range(min(limit, codebooks.stages)):
        deep = found.depths > j
        place = found.stages[:, j, None] + np.cumsum(deep, axis=1) - 1
        own = order[: np.count_nonzero(deep)]
        sums[: len(own)] += codebooks.shifted(j)[coded.data[place.ravel()[own]]]
    if found.escapes is None:
        sorted_voxels = codebooks.values.decoded(sums)
    else:
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        places = rank[found.escapes.block * found.depths.shape[1] + found.escapes.sub]
        sorted_voxels = _with_escapes(sums, places, coded.data, found.escapes, codebooks)
    voxels = np.empty_like(sorted_voxels)
    voxels[order] = sorted_voxels
    return in_block_order(voxels, s)


def _with_escapes(
    working: np.ndarray, places: np.ndarray, data: np.ndarray, escapes: Escapes, codebooks: Codebooks
) -> np.ndarray:
    """The voxels of ``working`` [n, 64], with codes and residuals of the escaped sub-blocks ``places``; changes
    ``working``."""
    values = codebooks.values
    for j in range(codebooks.stages):
        own = np.flatnonzero(escapes.stages > j)
        working[places[own]] += codebooks.shifted(j)[data[escapes.at[own] + j]]
    residuals = _residuals(data, escapes) * codebooks.residual_step
    if values.is_float:
        working[places] = np.clip(np.clip(working[places], 0, LARGEST) + residuals, 0, LARGEST)
        voxels = values.decoded(working)
    else:
        voxels = values.decoded(working)
        sums = voxels[places].astype(np.int32) + residuals
        voxels[places] = np.clip(sums, values.low, values.low + values.span).astype(values.dtype)
    own = np.flatnonzero(escapes.raw)
    voxels[places[own]] = samples_at(data, escapes.at[own], 64, values.dtype)
    return voxels


def _residuals(data: np.ndarray, escapes: Escapes) -> np.ndarray:
    """int32 [n, 64], 0 where there are none."""
    residuals = np.zeros((len(escapes.at), 64), np.int32)
    for bits in range(1, 9):
        own = np.flatnonzero(escapes.bits == bits)
        packed = data[(escapes.at + escapes.stages)[own, None] + np.arange(8 * bits)]
        single = np.unpackbits(packed, axis=1, bitorder="little").reshape(-1, 64, bits)
        weights = 1 << np.arange(bits, dtype=np.int32)
        weights[-1] = -weights[-1]
        residuals[own] = single @ weights
    return residuals


CODEC = Codec("rvq", False, ZSTD, {CODED: Kind(_good, _decode, _prefixes)}, targets=True)
