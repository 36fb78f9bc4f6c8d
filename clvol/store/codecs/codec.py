"""What a codec is: how its samples become bytes, and for those of codes, how the kinds of its blocks are decoded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks


@dataclass(frozen=True)
class Kind:
    """A kind of block: functions of blocks [k] of that kind, all within their data.

    ``good(coded, s, codebooks, limit)``: bool [k], whether bytes are possible. ``decode(coded, s, codebooks, limit)``:
    voxels [k, s, s, s] of good ones. ``prefixes(coded, s, codebooks)``: int64 [k, stages + 2], bytes that each limit
    needs, and all; None if limits change nothing.
    """

    good: Callable[[CodedBlocks, int, Codebooks, int], np.ndarray]
    decode: Callable[[CodedBlocks, int, Codebooks, int], np.ndarray]
    prefixes: Callable[[CodedBlocks, int, Codebooks], np.ndarray] | None = None


@dataclass(frozen=True)
class Codec:
    """A codec. ``compressor`` is the Zarr codec (name, configuration) applied to the bytes of samples or of packs of
    codes, or None. ``kinds``: of blocks, besides constant and raw ones, by number; none if levels hold samples.
    ``targets``: it can keep to a ``RateTarget``."""

    name: str
    lossless: bool
    compressor: dict | None = None
    kinds: dict[int, Kind] = field(default_factory=dict)
    targets: bool = False

    @property
    def coded(self) -> bool:
        """Levels hold codes of blocks."""
        return bool(self.kinds)

    def chain(self, dtype: np.dtype) -> list[dict]:
        """The Zarr codecs of a chunk of ``dtype``; the last one adds a checksum of the bytes on disk."""
        return [as_bytes(dtype), *compressing(self.compressor, dtype), CHECKSUM]


CHECKSUM = {"name": "crc32c"}
BLOSC = {
    "name": "blosc",
    "configuration": {"cname": "lz4", "clevel": 5, "shuffle": "bitshuffle", "blocksize": 0},
}
ZSTD = {"name": "zstd", "configuration": {"level": 3, "checksum": False}}
_SMALL = {
    "name": "blosc",
    "configuration": {"cname": "zstd", "clevel": 7, "shuffle": "shuffle", "blocksize": 0},
}


def as_bytes(dtype: np.dtype) -> dict:
    if dtype.itemsize == 1:
        return {"name": "bytes"}
    return {"name": "bytes", "configuration": {"endian": "little"}}


def compressing(compressor: dict | None, dtype: np.dtype) -> list[dict]:
    if compressor is None:
        return []
    if compressor["name"] == "blosc":
        compressor = {
            "name": "blosc",
            "configuration": {**compressor["configuration"], "typesize": dtype.itemsize},
        }
    return [compressor]


def statistics_chain(dtype: np.dtype, small: bool = False) -> list[dict]:
    """The Zarr codecs of statistics; ``small``: beside codes, where their bytes count."""
    return [as_bytes(dtype), *compressing(_SMALL if small else BLOSC, dtype), CHECKSUM]
