"""Sizes of memory as text: "96 MiB", "2GB", "1048576"."""

from __future__ import annotations

import re

_UNITS = {"": 1, "b": 1}
_UNITS |= {f"{p}b": 1000**i for i, p in enumerate("kmgt", 1)}
_UNITS |= {f"{p}ib": 1024**i for i, p in enumerate("kmgt", 1)}
_SIZE = re.compile(r"\s*(\d{1,18}(?:\.\d{1,9})?)\s*([A-Za-z]*)\s*", re.ASCII)


def parse_size(text: str) -> int:
    """The number of bytes (> 0) in ``text``; ValueError if it is not a number with a unit from B to TiB."""
    match = _SIZE.fullmatch(text)
    size = 0 if match is None else int(float(match[1]) * _UNITS.get(match[2].lower(), 0))
    if size < 1:
        raise ValueError("not a size")
    return size


def format_size(size: int) -> str:
    """``size`` bytes in readable form, such as "96.0 MiB"."""
    number: float = size
    for unit in ("B", "KiB", "MiB", "GiB"):
        if number < 1024 or unit == "GiB":
            break
        number /= 1024
    return f"{size} B" if unit == "B" else f"{number:.1f} {unit}"
