"""Checks of how much memory a volume needs, before any of it is allocated."""

from __future__ import annotations

import os
from pathlib import Path

from clvol.errors import VolumeError

DEFAULT_SHARE = 0.75
"""Default share of the machine's available memory that one volume may take."""


def available_memory() -> int:
    """Bytes that are available without swapping, in the machine or in the control group, whichever is less."""
    figures = [_machine_memory()]
    for limit, used in (
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        (
            "/sys/fs/cgroup/memory/memory.limit_in_bytes",
            "/sys/fs/cgroup/memory/memory.usage_in_bytes",
        ),
    ):
        try:
            figures.append(max(0, int(Path(limit).read_text()) - int(Path(used).read_text())))
        except (OSError, ValueError):  # no such control group, or "max"
            continue
    return min(figures)


def _machine_memory() -> int:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_memory(where: str, nbytes: int, cap: int | None, mapped: bool = False) -> None:
    """VolumeError if a volume of ``nbytes`` bytes exceeds the cap.

    ``cap`` None means DEFAULT_SHARE of the available memory, except for ``mapped`` files, which take no memory of
    their own and may then have any size.
    """
    if cap is None:
        if mapped:
            return
        limit = int(DEFAULT_SHARE * available_memory())
        source = f"{DEFAULT_SHARE:.0%} of the available memory"
    else:
        limit, source = int(cap), "the memory cap"
    if nbytes > limit:
        raise VolumeError(
            where,
            f"the volume needs {show_bytes(nbytes)}",
            f"at most {show_bytes(limit)} ({source})",
        )


def show_bytes(nbytes: int) -> str:
    """A readable byte count: exact below 10 KiB, three digits and a binary unit above."""
    if nbytes < 10 * 1024:
        return f"{nbytes} bytes"
    value, units = float(nbytes), ["KiB", "MiB", "GiB", "TiB", "PiB", "EiB"]
    for unit in units:
        value /= 1024.0
        if value < 1024.0 or unit == units[-1]:
            return f"{value:.3g} {unit}" if value < 1000 else f"{value:.0f} {unit}"
    raise AssertionError("unreachable")
