"""Compressed pixels: decoders of imagecodecs as a plugin of pydicom's.

pydicom asks the module for ``is_available`` and ``DECODER_DEPENDENCIES``, and calls ``decode_frame``.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

import numpy as np

PLUGIN = "imagecodecs"
_JPEG = ("1.2.840.10008.1.2.4.50", "1.2.840.10008.1.2.4.51")
_LOSSLESS = ("1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70")
_LS = ("1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81")
_J2K = ("1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91")
_HTJ2K = tuple(f"1.2.840.10008.1.2.4.{k}" for k in (201, 202, 203))
SYNTAXES = (*_JPEG, *_LOSSLESS, *_LS, *_J2K, *_HTJ2K)

DECODER_DEPENDENCIES = {uid: (PLUGIN,) for uid in SYNTAXES}
_SIZ = b"\xff\x4f\xff\x51"  # the beginning of a JPEG 2000 codestream


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
    size = _j2k_size(source) if uid in (*_J2K, *_HTJ2K) else _jpeg_size(source)
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


def _jpeg_size(source: bytes) -> tuple[int, int] | None:
    """(rows, columns) of the first frame header of a JPEG or JPEG-LS stream."""
    at = 2
    while at + 9 <= len(source) and source[at] == 0xFF:
        marker = source[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
        elif marker == 0xF7 or 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return _number(source, at + 5, 2), _number(source, at + 7, 2)
        else:
            at += 2 + max(2, _number(source, at + 2, 2))
    return None


def _j2k_size(source: bytes) -> tuple[int, int] | None:
    """(rows, columns) of a JPEG 2000 codestream, which a file of boxes may lie around."""
    at = source.find(_SIZ, 0, 4096)
    if at < 0 or len(source) < at + 24:
        return None
    x1, y1, x0, y0 = (_number(source, at + 8 + 4 * k, 4) for k in range(4))
    return y1 - y0, x1 - x0


def _number(source: bytes, at: int, count: int) -> int:
    return int.from_bytes(source[at : at + count], "big")
