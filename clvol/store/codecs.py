"""Codecs by name: how a level's samples become bytes.

A codec compresses the bytes of samples, and then any Zarr reader opens the level; or it has a
``payload``: what the level's array holds is not samples but codes, one block's in one chunk, which
clvol itself decodes. A new codec is an entry in ``CODECS``. Its name and parameters stand in the
store, a level at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clvol.errors import VolumeError

DEFAULT = "blosc-lz4"


class Payload(Protocol):
    """Codes in place of samples, for codecs that the device decodes."""

    def dtype(self, samples: np.dtype) -> np.dtype:
        """The type of codes for samples of that type."""
        ...

    def encode(self, samples: np.ndarray, parameters: dict) -> np.ndarray:
        """Codes [z, y, x] for samples [z, y, x], as many as there are samples."""
        ...

    def decode(self, codes: np.ndarray, samples: np.dtype, parameters: dict) -> np.ndarray:
        """The samples, of that type, that ``codes`` stand for: the twin of the device's kernel."""
        ...


@dataclass(frozen=True)
class Codec:
    """``compressor``: the Zarr codec (name, configuration) that follows the one that makes bytes;
    None for none."""

    name: str
    lossless: bool
    compressor: dict | None = None
    payload: Payload | None = None

    def stored_type(self, samples: np.dtype) -> np.dtype:
        """What the level's array holds."""
        return samples if self.payload is None else self.payload.dtype(samples)

    def chain(self, dtype: np.dtype) -> list[dict]:
        """The Zarr codecs of a chunk of ``dtype``; the last adds a checksum that covers what is on
        disk."""
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


def find_codec(name: str, where: str) -> Codec:
    """The codec ``name`` that the store ``where`` says it is stored with."""
    if name not in CODECS:
        raise VolumeError(where, f"stored by a newer clvol (codec {name!r})", one_of_codecs())
    return CODECS[name]


def one_of_codecs() -> str:
    return "one of " + ", ".join(CODECS)


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


def statistics_chain(dtype: np.dtype) -> list[dict]:
    """The Zarr codecs of statistics."""
    return [as_bytes(dtype), *compressing(_BLOSC, dtype), CHECKSUM]
