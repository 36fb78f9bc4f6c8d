"""A report on the caches on the user's machine and their problems, for ``clvol doctor``."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from clvol.errors import DeviceError
from clvol.opencl.folders import cache_folder, scratch_folder, why_no_cache
from clvol.opencl.program_store import ENDING, is_whole, program_folder


@dataclass(frozen=True)
class CacheReport:
    """``folder``: the cache folder, None where there is none; ``pocl_folder``: that of PoCL's programs, if it
    differs; ``temporary``: that of temporary files; ``programs``: the number of cached programs, which take
    ``size`` bytes; ``problems``: one line each."""

    folder: str | None
    pocl_folder: str | None = None
    temporary: str | None = None
    programs: int = 0
    size: int = 0
    problems: list[str] = field(default_factory=list)


def report_caches() -> CacheReport:
    """Checks every cached program, and removes damaged ones. Raises nothing."""
    problems: list[str] = []
    folder = cache_folder()
    programs, pocl = program_folder(), program_folder(pocl=True)
    if folder is None:
        problems.append(why_no_cache())
    elif why := _why_not_writable(folder):
        problems.append(f"{folder} cannot be written ({why})")
    if pocl not in (None, programs) and (why := _why_not_writable(pocl)):
        problems.append(f"{pocl} cannot be written ({why})")
    count = size = 0
    for place in dict.fromkeys((programs, pocl)):
        if place is not None:
            held, held_size, damaged = _look_at(place)
            count, size = count + held, size + held_size
            if damaged:
                files = "1 program" if damaged == 1 else f"{damaged} programs"
                problems.append(f"{place}: {files} damaged; they are compiled anew")
    temporary = None
    try:
        temporary = str(scratch_folder().parent)
    except DeviceError as error:
        problems.append(str(error))
    shown = None if pocl == programs or pocl is None else str(pocl)
    return CacheReport(None if folder is None else str(folder), shown, temporary, count, size, problems)


def _why_not_writable(folder: Path) -> str:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(65536))
            file.flush()
    except OSError as error:
        return error.strerror or type(error).__name__
    return ""


def _look_at(folder: Path) -> tuple[int, int, int]:
    """The number of intact programs, their bytes, and the number of damaged ones."""
    whole = size = damaged = 0
    try:
        paths = [entry.path for entry in os.scandir(folder) if entry.name.endswith(ENDING)]
    except OSError:
        return 0, 0, 0
    for path in paths:
        try:
            if is_whole(path):
                whole += 1
                size += os.path.getsize(path)
            else:
                damaged += 1
                os.unlink(path)
        except OSError:
            continue
    return whole, size, damaged
