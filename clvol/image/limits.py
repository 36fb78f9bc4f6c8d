"""The limit on the memory that reading a picture takes, checked from its header before anything is allocated."""

from __future__ import annotations

from clvol.errors import UsageError
from clvol.volume.memory import DEFAULT_SHARE, available_memory, show_bytes

DEFAULT_CAP = 1 << 30
"""The default limit in bytes for reading one picture, enough for a PNG of 8192 x 5461 pixels."""

RGBA_BYTES = 16  # per pixel of float32 RGBA


def check_picture(where: str, width: int, height: int, nbytes: int, cap: int | None) -> None:
    """Raises UsageError if reading a picture of this size takes more bytes than ``cap`` (None: the default limit).
    ``nbytes``: the size of the pixels as the file stores them, and of the float32 RGBA that they become."""
    limit, source = cap, "the memory cap"
    if limit is None:
        limit, source = DEFAULT_CAP, "without --memory-cap"
        share = int(DEFAULT_SHARE * available_memory())
        if share < limit:
            limit, source = share, f"{DEFAULT_SHARE:.0%} of the available memory"
    if nbytes > limit:
        what = f"the picture of {width} x {height} pixels needs {show_bytes(nbytes)}"
        raise UsageError(where, what, f"at most {show_bytes(limit)} ({source})")
