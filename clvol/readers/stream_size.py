"""The number of pixels that a JPEG or JPEG 2000 stream claims, read before a decoder allocates memory."""

from __future__ import annotations

_SIZ = b"\xff\x4f\xff\x51"  # the beginning of a JPEG 2000 codestream
LOOKED_AT = 1 << 18  # bytes of a stream within which its size must be


def jpeg_size(source: bytes) -> tuple[int, int] | None:
    """(rows, columns) of the first frame header of a JPEG or JPEG-LS stream; None without one."""
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


def j2k_size(source: bytes) -> tuple[int, int] | None:
    """(rows, columns) of a JPEG 2000 codestream, which may be inside the boxes of a file."""
    at = source.find(_SIZ, 0, LOOKED_AT)
    if at < 0 or len(source) < at + 24:
        return None
    x1, y1, x0, y0 = (_number(source, at + 8 + 4 * k, 4) for k in range(4))
    return y1 - y0, x1 - x0


def _number(source: bytes, at: int, count: int) -> int:
    return int.from_bytes(source[at : at + count], "big")
