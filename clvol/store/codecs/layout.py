"""Which blocks of codes are possible, and how many of their bytes a limit of stages needs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from clvol.store.codecs import CODES
from clvol.store.codecs.block_bytes import kinds_of, parts
from clvol.store.codecs.codec import Kind
from clvol.store.codecs.coded_blocks import CONSTANT, RAW, WHOLE, Codebooks, CodedBlocks
from clvol.store.codecs.rvq import parse_coded

__all__ = ["blocks_of_codec", "check_codes", "kinds_of", "parse_coded", "prefix_sizes"]


def check_codes(coded: CodedBlocks, s: int, codebooks: Codebooks, stages: int = WHOLE) -> np.ndarray:
    """int64: numbers of the blocks whose bytes are impossible, in order.

    ``stages``: the limit to which they are to be decoded; unless it is WHOLE, bytes after those that are needed may be
    missing, and are not looked at.
    """
    kinds = kinds_of(coded)
    itemsize = codebooks.values.dtype.itemsize
    good = (kinds == CONSTANT) & (coded.size == 1 + itemsize)
    good |= (kinds == RAW) & (coded.size == 1 + itemsize * s**3)
    for blocks, kind, some in blocks_of_codec(coded, kinds, s, codebooks):
        good[blocks] = kind.good(some, s, codebooks, stages)
    return np.flatnonzero(~good)


def prefix_sizes(coded: CodedBlocks, s: int, codebooks: Codebooks) -> np.ndarray:
    """int64 [k, stages + 2]: how many bytes decoding to a limit of 0, 1, ... stages needs of each block; the last
    column is the whole block. The blocks have passed ``check_codes``."""
    sizes = np.repeat(coded.size[:, None], codebooks.stages + 2, axis=1)
    for blocks, kind, some in blocks_of_codec(coded, kinds_of(coded), s, codebooks):
        if kind.prefixes is not None:
            sizes[blocks] = kind.prefixes(some, s, codebooks)
    return sizes


def blocks_of_codec(
    coded: CodedBlocks, kinds: np.ndarray, s: int, codebooks: Codebooks
) -> Iterator[tuple[np.ndarray, Kind, CodedBlocks]]:
    """The blocks of the codec's own kinds in parts of bounded memory: their numbers, their kind, and they."""
    if s < 4:
        return
    for number, kind in CODES[codebooks.codec].kinds.items():
        for blocks in parts(np.flatnonzero(kinds == number), s):
            yield blocks, kind, CodedBlocks(coded.data, coded.start[blocks], coded.size[blocks])
