"""Decoding in numpy: the voxels that every device gives, bit for bit (clvol/store/codecs/coded_blocks.py)."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from clvol.errors import VolumeError
from clvol.store.codecs.coded_blocks import CODED, CONSTANT, FIXED, MOST_STAGES, RAW, Codebooks, CodedBlocks
from clvol.store.codecs.layout import CodedParts, Escapes, check_codes, kinds_of, parse_coded, parts
from clvol.store.codecs.working_values import LARGEST

Array: TypeAlias = np.ndarray

_NO_MEAN = 1 << 15  # in the place of a mean where a codec has none


def decode_blocks(coded: CodedBlocks, s: int, codebooks: Codebooks, stages: int = MOST_STAGES) -> Array:
    """Voxels [k, s, s, s] of the type ``codebooks.values.dtype``; s = 1, 2, 4, 8, 16 or 32.

    ``stages``: the limit of stages, of which no more bytes need to be there. VolumeError names blocks whose bytes are
    impossible.
    """
    fault = codebooks.fault()
    if fault is not None:
        raise VolumeError("codebooks", fault, "codebooks of one of clvol's codecs")
    damaged = check_codes(coded, s, codebooks, stages)
    if len(damaged):
        first = ", ".join(map(str, damaged[:5]))
        raise VolumeError("codes", f"impossible bytes of {len(damaged)} blocks (block {first})", "undamaged codes")
    kinds = kinds_of(coded)
    voxels = np.empty((len(coded), s, s, s), codebooks.values.dtype)
    for kind, decode in ((CONSTANT, _constant), (RAW, _raw), (CODED, _coded), (FIXED, _fixed)):
        for blocks in parts(np.flatnonzero(kinds == kind), s):
            voxels[blocks] = decode(coded, blocks, s, codebooks, stages)
    return voxels


def _samples(data: Array, at: Array, count: int, dtype: np.dtype) -> Array:
    """``count`` samples from each place ``at``: [len(at), count]."""
    found = data[at[:, None] + np.arange(count * dtype.itemsize)]
    return found.view(dtype.newbyteorder("<")).astype(dtype, copy=False)


def _constant(coded: CodedBlocks, blocks: Array, s: int, codebooks: Codebooks, limit: int) -> Array:
    found = _samples(coded.data, coded.start[blocks] + 1, 1, codebooks.values.dtype)
    return np.broadcast_to(found[:, :, None, None], (len(blocks), s, s, s))


def _raw(coded: CodedBlocks, blocks: Array, s: int, codebooks: Codebooks, limit: int) -> Array:
    found = _samples(coded.data, coded.start[blocks] + 1, s**3, codebooks.values.dtype)
    return found.reshape(-1, s, s, s)


def _fixed(coded: CodedBlocks, blocks: Array, s: int, codebooks: Codebooks, limit: int) -> Array:
    side, per_axis = codebooks.side, s // codebooks.side
    count = per_axis**3
    at = coded.start[blocks, None] + 1 + np.arange(count)
    working = np.full((len(blocks), count), _NO_MEAN, np.int32)
    if codebooks.codec != "vq":
        working = (coded.data[at].astype(np.int32) << 8) + 128
        at = at + count
    working = np.repeat(working[:, :, None], side**3, axis=2)
    for j in range(min(limit, codebooks.stages)):
        working += _shifted(codebooks, j)[coded.data[at]]
        at = at + count
    voxels = codebooks.values.decoded(working).reshape(-1, *(per_axis,) * 3, *(side,) * 3)
    return voxels.transpose(0, 1, 4, 2, 5, 3, 6).reshape(-1, s, s, s)


def _coded(coded: CodedBlocks, blocks: Array, s: int, codebooks: Codebooks, limit: int) -> Array:
    found = parse_coded(coded.data, coded.start[blocks], coded.size[blocks], s, codebooks, limit)
    working = np.repeat((found.means.astype(np.int32) << 8)[:, :, None] + 128, 64, axis=2)
    for j in range(min(limit, codebooks.stages)):
        _add_stage(working, coded.data, found, j, codebooks)
    if found.escapes is None:
        voxels = codebooks.values.decoded(working)
    else:
        voxels = _with_escapes(working, coded.data, found.escapes, codebooks)
    octants = s // 8 or 1
    half = 2 if s > 4 else 1
    voxels = voxels.reshape(-1, octants, octants, octants, half, half, half, 4, 4, 4)
    return voxels.transpose(0, 1, 4, 7, 2, 5, 8, 3, 6, 9).reshape(-1, s, s, s)


def _add_stage(working: Array, data: Array, found: CodedParts, j: int, codebooks: Codebooks) -> None:
    deep = found.depths > j
    block, sub = np.nonzero(deep)
    order = (np.cumsum(deep, axis=1) - 1)[block, sub]
    working[block, sub] += _shifted(codebooks, j)[data[found.stages[block, j] + order]]


def _with_escapes(working: Array, data: Array, escapes: Escapes, codebooks: Codebooks) -> Array:
    """The voxels, with codes and residuals of escaped sub-blocks; changes ``working``."""
    values = codebooks.values
    for j in range(codebooks.stages):
        own = np.flatnonzero(escapes.stages > j)
        working[escapes.block[own], escapes.sub[own]] += _shifted(codebooks, j)[data[escapes.at[own] + j]]
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
    voxels[escapes.block[own], escapes.sub[own]] = _samples(data, escapes.at[own], 64, values.dtype)
    return voxels


def _residuals(data: Array, escapes: Escapes) -> Array:
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


def _shifted(codebooks: Codebooks, j: int) -> Array:
    """int32 [ENTRIES, side^3]: what stage j adds to working values."""
    return codebooks.entries[j].astype(np.int32) << int(codebooks.shifts[j])
