"""How much memory a volume may take, known before any of it is allocated."""

from __future__ import annotations

import os
from pathlib import Path

from clvol.errors import VolumeError

DEFAULT_SHARE = 0.75
"""Share of the machine's available memory that one volume may take unless the caller says."""


def available_memory() -> int:
    """Bytes to be had without swapping: the machine's, or the control group's if less."""
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
    """VolumeError if a volume of ``nbytes`` bytes is over the cap.

    ``cap`` None means DEFAULT_SHARE of the available memory; that default does not hold for files
    that are ``mapped``, which take no memory of their own. A cap that is given holds for all.
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
    """A byte count for people: exact below 10 KiB, three digits and a binary unit above."""
    if nbytes < 10 * 1024:
        return f"{nbytes} bytes"
    value, units = float(nbytes), ["KiB", "MiB", "GiB", "TiB", "PiB", "EiB"]
    for unit in units:
        value /= 1024.0
        if value < 1024.0 or unit == units[-1]:
            return f"{value:.3g} {unit}" if value < 1000 else f"{value:.0f} {unit}"
    raise AssertionError("unreachable")
