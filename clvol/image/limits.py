"""How much memory a picture that is read may take, known from its header before any is allocated."""

from __future__ import annotations

from clvol.errors import UsageError
from clvol.volume.memory import DEFAULT_SHARE, available_memory, show_bytes

DEFAULT_CAP = 1 << 30
"""Bytes that a picture may take while it is read, unless the caller says: 8192 x 5461 pixels of a PNG."""

RGBA_BYTES = 16  # a pixel as it is worked with


def check_picture(where: str, width: int, height: int, nbytes: int, cap: int | None) -> None:
    """UsageError if reading a picture of that size takes more bytes than the cap. ``nbytes``: what
    the pixels take as the file holds them and as they are worked with."""
    limit, source = cap, "the memory cap"
    if limit is None:
        limit, source = DEFAULT_CAP, "without --memory-cap"
        share = int(DEFAULT_SHARE * available_memory())
        if share < limit:
            limit, source = share, f"{DEFAULT_SHARE:.0%} of the available memory"
    if nbytes > limit:
        what = f"the picture of {width} x {height} pixels needs {show_bytes(nbytes)}"
        raise UsageError(where, what, f"at most {show_bytes(limit)} ({source})")
