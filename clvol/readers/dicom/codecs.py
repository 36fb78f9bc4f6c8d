"""Decoding compressed pixels frame by frame with imagecodecs.

pydicom finds the frames. Its own decoders can enter an endless loop on damaged JPEG 2000 streams, and need further
packages.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from clvol.readers.stream_size import j2k_size, jpeg_size

_JPEG = ("1.2.840.10008.1.2.4.50", "1.2.840.10008.1.2.4.51")
_LOSSLESS = ("1.2.840.10008.1.2.4.57", "1.2.840.10008.1.2.4.70")
_LS = ("1.2.840.10008.1.2.4.80", "1.2.840.10008.1.2.4.81")
_J2K = ("1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91")
_HTJ2K = tuple(f"1.2.840.10008.1.2.4.{k}" for k in (201, 202, 203))
SYNTAXES = (*_JPEG, *_LOSSLESS, *_LS, *_J2K, *_HTJ2K)
_TAGS = ["PixelData", "ExtendedOffsetTable", "ExtendedOffsetTableLengths"]


def decoded_frames(path: Any, header: Any, indices: Sequence[int]) -> Iterator[np.ndarray]:
    """Stored pixels [y, x] of the given frames of a file whose transfer syntax is in SYNTAXES."""
    from pydicom import dcmread
    from pydicom.encaps import get_frame

    data = dcmread(path, specific_tags=_TAGS)
    table = data.get("ExtendedOffsetTable"), data.get("ExtendedOffsetTableLengths")
    count = int(header.get("NumberOfFrames") or 1)
    wanted = int(header.Rows), int(header.Columns)
    for index in indices:
        source = get_frame(
            data.PixelData,
            index,
            number_of_frames=count,
            extended_offsets=None if None in table else table,
        )
        pixels = _decoded(bytes(source), str(header.file_meta.TransferSyntaxUID), wanted)
        size = max(1, int(header.BitsAllocated) // 8)
        stored = pixels.astype(np.dtype(f"{pixels.dtype.kind}{size}"))
        yield stored.view(f"{'i' if header.get('PixelRepresentation') else 'u'}{size}")


def _decoded(source: bytes, uid: str, wanted: tuple[int, int]) -> np.ndarray:
    """The pixels of one frame; ValueError unless they have the size in the file's header."""
    import imagecodecs

    size = j2k_size(source) if uid in (*_J2K, *_HTJ2K) else jpeg_size(source)
    if size != wanted:  # before a decoder allocates what the stream claims
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
    return pixels
