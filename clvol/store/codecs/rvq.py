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


def _parsed(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> CodedParts:
    return parse_coded(coded.data, coded.start, coded.size, s, codebooks, limit)


def _good(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    return _parsed(coded, s, codebooks, limit).good


def _prefixes(coded: CodedBlocks, s: int, codebooks: Codebooks) -> np.ndarray:
    sizes = _parsed(coded, s, codebooks, 0).stages - coded.start[:, None]
    sizes[:, -1] = coded.size
    return sizes


def _decode(coded: CodedBlocks, s: int, codebooks: Codebooks, limit: int) -> np.ndarray:
    found = _parsed(coded, s, codebooks, limit)
    working = np.repeat((found.means.astype(np.int32) << 8)[:, :, None] + 128, 64, axis=2)
    for j in range(min(limit, codebooks.stages)):
        _add_stage(working, coded.data, found, j, codebooks)
    if found.escapes is None:
        voxels = codebooks.values.decoded(working)
    else:
        voxels = _with_escapes(working, coded.data, found.escapes, codebooks)
    return in_block_order(voxels, s)


def _add_stage(working: np.ndarray, data: np.ndarray, found: CodedParts, j: int, codebooks: Codebooks) -> None:
    deep = found.depths > j
    block, sub = np.nonzero(deep)
    order = (np.cumsum(deep, axis=1) - 1)[block, sub]
    working[block, sub] += codebooks.shifted(j)[data[found.stages[block, j] + order]]


def _with_escapes(working: np.ndarray, data: np.ndarray, escapes: Escapes, codebooks: Codebooks) -> np.ndarray:
    """The voxels, with codes and residuals of escaped sub-blocks; changes ``working``."""
    values = codebooks.values
    for j in range(codebooks.stages):
        own = np.flatnonzero(escapes.stages > j)
        working[escapes.block[own], escapes.sub[own]] += codebooks.shifted(j)[data[escapes.at[own] + j]]
    residuals = _residuals(data, escapes) * codebooks.residual_step
    places = escapes.block, escapes.sub
    if values.is_float:
        working[places] = np.clip(np.clip(working[places], 0, LARGEST) + residuals, 0, LARGEST)
        voxels = values.decoded(working)
    else:
        voxels = values.decoded(working)
        sums = voxels[places].astype(np.int32) + residuals
        voxels[places] = np.clip(sums, values.low, values.low + values.span).astype(values.dtype)
    own = np.flatnonzero(escapes.raw)
    voxels[escapes.block[own], escapes.sub[own]] = samples_at(data, escapes.at[own], 64, values.dtype)
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
