"""OpenCL libraries that a Python environment brings with it, made known to the OpenCL loader.

The PyPI package ``intel-opencl-rt`` puts a complete CPU implementation, ``lib/libintelocl.so``,
into the environment, but nothing tells the loader. The loader inside pyopencl's wheel also reads
``*.icd`` beside itself (``pyopencl/.libs``): one line there with the library's path is enough, and
no environment variable has to be set.
"""

from __future__ import annotations

import importlib.util
import os
import site
import sys
from pathlib import Path

_LIBRARY = "libintelocl.so"
_ICD = "intel.icd"


def environment_libraries() -> list[Path]:
    """The OpenCL CPU libraries found in this Python's prefix and in the user's site, best first."""
    prefixes = [Path(sys.prefix), Path(sys.exec_prefix)]
    if site.ENABLE_USER_SITE:
        prefixes.append(Path(site.getuserbase()))
    # An environment may see the packages of another one (a path file, --system-site-packages).
    prefixes += [Path(p).parents[2] for p in sys.path
                 if Path(p).name == "site-packages" and len(Path(p).parents) > 2]
    found: list[Path] = []
    for prefix in prefixes:
        library = prefix / "lib" / _LIBRARY
        if library.is_file() and library.resolve() not in [f.resolve() for f in found]:
            found.append(library)
    return found


def loader_folder() -> Path | None:
    """The folder from which the loader inside pyopencl's wheel reads ``*.icd``.

    None where pyopencl uses the system's loader (a distribution's package, conda). pyopencl itself
    is not imported.
    """
    spec = importlib.util.find_spec("pyopencl")
    for place in (spec.submodule_search_locations or ()) if spec else ():
        folder = Path(place) / ".libs"
        if any(folder.glob("libOpenCL*")):
            return folder
    return None


def register_runtimes() -> list[Path]:
    """Make the environment's own OpenCL library visible to pyopencl's loader; idempotent.

    Returns the ``.icd`` files in force (written now or before); an empty list when there is no
    such library, or no folder to write to. Raises nothing: a read-only environment stays as it is,
    and :mod:`clvol.opencl.devices` then points the loader elsewhere.
    """
    folder = loader_folder()
    libraries = environment_libraries()
    if folder is None or not libraries:
        return []
    target = folder / _ICD
    line = os.fsencode(libraries[0]) + b"\n"
    try:
        if target.is_file() and target.read_bytes() == line:
            return [target]
        temporary = folder / f".{_ICD}.{os.getpid()}"
        temporary.write_bytes(line)
        os.replace(temporary, target)
    except OSError:
        return []
    return [target]


if __name__ == "__main__":  # `python -m clvol.opencl.runtime`, used by the Makefile
    for icd in register_runtimes():
        print(f"{icd}: {os.fsdecode(icd.read_bytes()).strip()}".encode(errors="replace").decode())
