"""Compressed pixels: decoders of imagecodecs as a plugin of pydicom's.

pydicom asks the module for ``is_available`` and ``DECODER_DEPENDENCIES``, and calls ``decode_frame``.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np

from clvol.volume.readers.stream_size import j2k_size, jpeg_size

PLUGIN = "imagecodecs"
_JPEG = ("1.2.840.10008.1.2.4.50", "1.2.840.10008.1.2.4.51")
_LOSSLESS = ("1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70")
_LS = ("1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81")
_J2K = ("1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91")
_HTJ2K = tuple(f"1.2.840.10008.1.2.4.{k}" for k in (201, 202, 203))
SYNTAXES = (*_JPEG, *_LOSSLESS, *_LS, *_J2K, *_HTJ2K)

DECODER_DEPENDENCIES = {uid: (PLUGIN,) for uid in SYNTAXES}


def is_available(uid: str) -> bool:
    """Whether a transfer syntax can be decoded here."""
    return uid in SYNTAXES and find_spec(PLUGIN) is not None


def use_codecs() -> None:
    """Makes the decoders known to pydicom; nothing happens the second time."""
    from pydicom.pixels import get_decoder

    for uid in SYNTAXES:
        decoder = get_decoder(uid)
        if PLUGIN not in (*decoder.available_plugins, *decoder._unavailable):
            decoder.add_plugin(PLUGIN, (__name__, "decode_frame"))


def decode_frame(source: bytes, runner: Any) -> bytes:
    """One frame's pixels, of the size that the file's header says, or ValueError."""
    import imagecodecs

    uid, source = str(runner.transfer_syntax), bytes(source)
    wanted = (runner.rows, runner.columns)
    size = j2k_size(source) if uid in (*_J2K, *_HTJ2K) else jpeg_size(source)
    if size != wanted:  # before a decoder makes room for whatever a stream says
        raise ValueError(f"a stream of {size} pixels for {wanted}")
    if uid in _JPEG:
        pixels = imagecodecs.jpeg_decode(source)
    elif uid in _LOSSLESS:
        pixels = imagecodecs.ljpeg_decode(source)
    elif uid in _LS:
        pixels = imagecodecs.jpegls_decode(source)
    elif uid in _J2K:
        pixels = imagecodecs.jpeg2k_decode(source)
    else:
        pixels = imagecodecs.htj2k_decode(source)
    if pixels.shape != wanted:
        raise ValueError(f"{pixels.shape} pixels for {wanted}")
    return pixels.astype(np.dtype(f"{pixels.dtype.kind}{runner.bits_allocated // 8}")).tobytes()
