"""The codec "rvq": residual vector quantisation, whose depth is chosen per sub-block. The one to use for what is lossy.

A sub-block of 4^3 samples is its mean and a sum of entries of codebooks, as many as pay: B.-H. Juang, A. H. Gray:
Multiple stage vector quantization for speech coding, ICASSP 1982; for volumes R. Parys, G. Knittel: Giga-voxel
rendering from compressed data on a display wall, WSCG 2009, who decode small subvolumes and render them front to back.
What is added here: octants of 8^3 samples of one value, depths by the Lagrangian of error and bytes, and packed
residuals or raw samples where a bound on the error, or voxels that are not finite, demand them. Stages are stored one
after another, and residuals after all of them, so that a prefix of a block's bytes is the block at a lower quality.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.store.codecs.block_bytes import bytes_before, in_block_order, samples_at, split_octants
from clvol.store.codecs.codec import ZSTD, Codec, Kind
from clvol.store.codecs.coded_blocks import CODED, ESCAPED, MOST_STAGES, RAW_SAMPLES, WHOLE, Codebooks, CodedBlocks
from clvol.store.codecs.working_values import LARGEST

_IS_RAW = np.arange(256) == RAW_SAMPLES  # by the byte of a head
_STAGES_OF_HEAD = np.where(_IS_RAW, 0, np.arange(256) & 15)
_BITS_OF_HEAD = np.where(_IS_RAW, 0, np.arange(256) >> 4)


@dataclass(frozen=True, eq=False)
class Escapes:
    """Escaped sub-blocks: ``block`` and ``sub`` say whose they are; ``at`` is the place of their residuals or samples
    in the data; ``bits`` of residuals, or ``raw``. int64 [n] all of them, ``raw`` bool [n]."""

    block: np.ndarray
    sub: np.ndarray
    at: np.ndarray
    bits: np.ndarray
    raw: np.ndarray


@dataclass(frozen=True, eq=False)
class CodedParts:
    """The parts of k blocks of the kind CODED, of n sub-blocks each.

    good     bool [k]: the bytes are possible
    means    uint8 [k, n]
    depths   uint8 [k, n]: number of stages; 0 in octants that are not split
    stages   int64 [k, stages + 1]: where the codes of each stage begin in the data; the last one ends the stages
    escapes  None if decoding ends before their residuals
    """

    good: np.ndarray
    means: np.ndarray
    depths: np.ndarray
    stages: np.ndarray
    escapes: Escapes | None


def parse_coded(
    data: np.ndarray, start: np.ndarray, size: np.ndarray, s: int, codebooks: Codebooks, limit: int = WHOLE
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
    heads = np.zeros(depths.shape, np.uint8)
    number = np.cumsum(escaped, axis=1)
    block, sub = np.nonzero(escaped)
    if len(block):
        heads[block, sub] = byte(at[:, None] + number - 1)[block, sub]
        at = at + number[:, -1]
    depths = np.where(escaped, _STAGES_OF_HEAD[heads], depths).astype(np.uint8)
    good &= ((depths <= codebooks.stages) & (_BITS_OF_HEAD[heads] <= 8)).all(axis=1)
    depths = np.minimum(depths, codebooks.stages)
    stages = np.repeat(at[:, None], codebooks.stages + 1, axis=1)
    for j in range(codebooks.stages):
        stages[:, j + 1] = stages[:, j] + (depths > j).sum(axis=1)
    if limit <= codebooks.stages:
        good &= stages[:, limit] <= end
        return CodedParts(good, means, depths, stages, None)
    lengths = np.where(escaped, _tail_lengths(codebooks)[heads], 0)
    ends = stages[:, -1:] + np.cumsum(lengths, axis=1)
    good &= ends[:, -1] == end
    own = heads[block, sub]
    at = (ends - lengths)[block, sub]
    escapes = Escapes(block, sub, at, _BITS_OF_HEAD[own].astype(np.int64), own == RAW_SAMPLES)
    return CodedParts(good, means, depths, stages, escapes)


def _tail_lengths(codebooks: Codebooks) -> np.ndarray:
    """int64 [256]: bytes of the residuals or samples of an escaped sub-block, by the byte of its head."""
    lengths = 8 * _BITS_OF_HEAD.astype(np.int64)
    lengths[RAW_SAMPLES] = 64 * codebooks.values.dtype.itemsize
    return lengths


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
    escaped = escapes.any(axis=1)[depths].any(axis=1)
    good &= escaped | ((at <= end) if limit <= codebooks.stages else (at == end))
    own = np.flatnonzero(good & escaped)
    if len(own):
        some = CodedBlocks(coded.data, coded.start[own], coded.size[own])
        good[own] = _parsed(some, s, codebooks, limit).good
    return good


def _prefixes(coded: CodedBlocks, s: int, codebooks: Codebooks) -> np.ndarray:
    sizes = _parsed(coded, s, codebooks, 0).stages - coded.start[:, None]
    return np.concatenate([sizes, coded.size[:, None]], axis=1)


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
    """The voxels of ``working`` [n, 64], with residuals of the escaped sub-blocks ``places``; changes ``working``."""
    values = codebooks.values
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
        packed = data[escapes.at[own, None] + np.arange(8 * bits)]
        single = np.unpackbits(packed, axis=1, bitorder="little").reshape(-1, 64, bits)
        weights = 1 << np.arange(bits, dtype=np.int32)
        weights[-1] = -weights[-1]
        residuals[own] = single @ weights
    return residuals


CODEC = Codec("rvq", False, ZSTD, {CODED: Kind(_good, _decode, _prefixes)}, targets=True)
