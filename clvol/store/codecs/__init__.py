"""Codecs by name: how the samples of a level become bytes.

A codec either compresses the bytes of samples, so that any Zarr reader can open the level (``CODECS``), or makes codes
of blocks, which clvol decodes (``CODES``; their layout is described in ``coded_blocks.py``). Levels of at least
``FEWEST_CODED`` samples per axis of a block hold codes; coarser ones hold samples, compressed by ``COARSE``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.errors import VolumeError

DEFAULT = "blosc-lz4"


@dataclass(frozen=True)
class Codec:
    """A codec. ``compressor`` is the Zarr codec (name, configuration) applied to the bytes of samples or of packs of
    codes, or None. ``coded``: levels hold codes of blocks. ``targets``: it can keep to a ``RateTarget``."""

    name: str
    lossless: bool
    compressor: dict | None = None
    coded: bool = False
    targets: bool = False

    def chain(self, dtype: np.dtype) -> list[dict]:
        """The Zarr codecs of a chunk of ``dtype``; the last one adds a checksum of the bytes on disk."""
        return [as_bytes(dtype), *compressing(self.compressor, dtype), CHECKSUM]


CHECKSUM = {"name": "crc32c"}
_BLOSC = {
    "name": "blosc",
    "configuration": {"cname": "lz4", "clevel": 5, "shuffle": "bitshuffle", "blocksize": 0},
}
_ZSTD = {"name": "zstd", "configuration": {"level": 3, "checksum": False}}

CODECS: dict[str, Codec] = {
    codec.name: codec
    for codec in (
        Codec("blosc-lz4", True, _BLOSC),
        Codec("zstd", True, _ZSTD),
        Codec("none", True),
    )
}

CODES: dict[str, Codec] = {
    codec.name: codec
    for codec in (
        Codec("rvq", False, _ZSTD, coded=True, targets=True),
        Codec("hvq", False, _ZSTD, coded=True, targets=True),
        Codec("vq-mean", False, _ZSTD, coded=True, targets=True),
        Codec("vq", False, _ZSTD, coded=True, targets=True),
        Codec("labels", True, _ZSTD, coded=True),
    )
}
COARSE = CODECS["zstd"]
FEWEST_CODED = 4


def find_codec(name: str, where: str) -> Codec:
    """The codec ``name`` of the store ``where``; VolumeError if this version does not know it."""
    codec = CODECS.get(name) or CODES.get(name)
    if codec is None:
        raise VolumeError(where, f"stored by a newer clvol (codec {name!r})", one_of_codecs())
    return codec


def one_of_codecs() -> str:
    return "one of " + ", ".join([*CODECS, *CODES])


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


_SMALL = {
    "name": "blosc",
    "configuration": {"cname": "zstd", "clevel": 9, "shuffle": "bitshuffle", "blocksize": 0},
}


def statistics_chain(dtype: np.dtype, small: bool = False) -> list[dict]:
    """The Zarr codecs of statistics; ``small``: beside codes, where their bytes count."""
    return [as_bytes(dtype), *compressing(_SMALL if small else _BLOSC, dtype), CHECKSUM]
