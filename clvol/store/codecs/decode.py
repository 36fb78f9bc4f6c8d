"""Decoding in numpy: the voxels that every device gives, bit for bit (clvol/store/codecs/coded_blocks.py)."""

from __future__ import annotations

import numpy as np

from clvol.errors import VolumeError
from clvol.store.codecs.block_bytes import kinds_of, parts, samples_at
from clvol.store.codecs.coded_blocks import CONSTANT, RAW, WHOLE, Codebooks, CodedBlocks
from clvol.store.codecs.layout import blocks_of_codec, check_codes


def decode_blocks(coded: CodedBlocks, s: int, codebooks: Codebooks, stages: int = WHOLE) -> np.ndarray:
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
    kinds, dtype = kinds_of(coded), codebooks.values.dtype
    voxels = np.empty((len(coded), s, s, s), dtype)
    constant = np.flatnonzero(kinds == CONSTANT)
    voxels[constant] = samples_at(coded.data, coded.start[constant] + 1, 1, dtype)[:, :, None, None]
    for blocks in parts(np.flatnonzero(kinds == RAW), s):
        voxels[blocks] = samples_at(coded.data, coded.start[blocks] + 1, s**3, dtype).reshape(-1, s, s, s)
    for blocks, kind, some in blocks_of_codec(coded, kinds, s, codebooks):
        voxels[blocks] = kind.decode(some, s, codebooks, stages)
    return voxels
