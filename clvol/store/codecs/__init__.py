"""Codecs by name: how the samples of a level become bytes.

A codec either compresses the bytes of samples, so that any Zarr reader can open the level (``CODECS``), or makes codes
of blocks, which clvol decodes (``CODES``; their layout is described in ``coded_blocks.py``). Levels of at least
``FEWEST_CODED`` samples per axis of a block hold codes; coarser ones hold samples, compressed by ``COARSE``.

A new codec of codes is a file like ``rvq.py`` with its ``CODEC``, an entry below and in ``coded_blocks.SHAPES``, its
kinds of blocks in the text of ``coded_blocks.py``, a branch of ``decode_codes`` in cl/decode_codes.cl, and an encoder
(``clvol.encoding``). tests/reference/plain_codes.py writes and reads its blocks byte by byte.
"""

from __future__ import annotations

from clvol.errors import VolumeError
from clvol.store.codecs import hvq, labels, rvq, vq, vq_mean
from clvol.store.codecs.codec import BLOSC, ZSTD, Codec, statistics_chain

__all__ = ["CODECS", "CODES", "COARSE", "DEFAULT", "FEWEST_CODED", "LABELS", "Codec", "find_codec", "one_of_codecs",
           "statistics_chain"]  # fmt: skip

DEFAULT = "blosc-lz4"
LABELS = labels.CODEC.name

CODECS: dict[str, Codec] = {
    codec.name: codec for codec in (Codec(DEFAULT, True, BLOSC), Codec("zstd", True, ZSTD), Codec("none", True))
}
CODES: dict[str, Codec] = {codec.name: codec for codec in (rvq.CODEC, hvq.CODEC, vq_mean.CODEC, vq.CODEC, labels.CODEC)}
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
