"""Codecs by name: how the samples of a level become bytes.

A codec either compresses the bytes of samples, so that any Zarr reader can open the level, or has a ``payload``: the
level's array then holds codes instead of samples, one block per chunk, which clvol decodes. A new codec is an entry
in ``CODECS``. Its name and parameters are stored per level.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clvol.errors import VolumeError

DEFAULT = "blosc-lz4"


class Payload(Protocol):
    """Codes instead of samples, for codecs that are decoded on the device."""

    def dtype(self, samples: np.dtype) -> np.dtype:
        """The type of codes for samples of type ``samples``."""
        ...

    def encode(self, samples: np.ndarray, parameters: dict) -> np.ndarray:
        """The codes [z, y, x] of samples [z, y, x], one per sample."""
        ...

    def decode(self, codes: np.ndarray, samples: np.dtype, parameters: dict) -> np.ndarray:
        """The samples, of type ``samples``, of ``codes``: the reference for the device's kernel."""
        ...


@dataclass(frozen=True)
class Codec:
    """A codec. ``compressor`` is the Zarr codec (name, configuration) applied to the bytes of samples, or None."""

    name: str
    lossless: bool
    compressor: dict | None = None
    payload: Payload | None = None

    def stored_type(self, samples: np.dtype) -> np.dtype:
        """The type of the level's array."""
        return samples if self.payload is None else self.payload.dtype(samples)

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


def find_codec(name: str, where: str) -> Codec:
    """The codec ``name`` of the store ``where``; VolumeError if this version does not know it."""
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
