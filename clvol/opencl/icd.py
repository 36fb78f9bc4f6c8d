"""Which OpenCL platforms are registered with the loader (ICDs), and the environment by which the loader is restricted.

A platform that crashes or hangs is kept out of this process by pointing the loader (``OCL_ICD_VENDORS``) at a folder
that registers only the others.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from pathlib import Path

from clvol.opencl.binding import load_pyopencl
from clvol.opencl.children import ORIGINAL_VENDORS, VENDORS, write_selection
from clvol.opencl.folders import cache_folder, scratch_folder
from clvol.opencl.reports import Icd
from clvol.opencl.runtime import environment_libraries, loader_folder

_HOME = "PYOPENCL_HOME"
_original_vendors = ORIGINAL_VENDORS
_original_home: str | None = None


def registered_icds(vendors: str | None = None) -> list[Icd]:
    """The entries that the loader reads: ``vendors`` (``OCL_ICD_VENDORS``: an .icd file, a library, a folder)
    or else the system's folder; with either folder also the one inside pyopencl's wheel."""
    folder = Path(vendors or os.environ.get("OPENCL_VENDOR_PATH") or "/etc/OpenCL/vendors")
    if vendors and not folder.is_dir():
        return _icd(folder) if folder.suffix == ".icd" else [Icd(vendors, vendors)]
    wheel = loader_folder()
    return _icds_in(folder) + (_icds_in(wheel) if wheel else [])


def _icds_in(folder: Path) -> list[Icd]:
    try:
        paths = sorted(folder.glob("*.icd"))
    except OSError:
        return []
    return [icd for path in paths for icd in _icd(path)]


def _icd(path: Path) -> list[Icd]:
    try:
        lines = os.fsdecode(path.read_bytes()).split("\n")
    except OSError:
        return []
    library = lines[0].strip()
    return [Icd(str(path), library)] if library else []


def platforms_wanted() -> tuple[list[Icd], bool]:
    """The platforms to try, each once, and whether the loader by itself finds just these."""
    registered = registered_icds(_original_vendors)
    wanted: dict[str, Icd] = {}
    for icd in registered:
        named = os.path.isabs(icd.library)
        wanted.setdefault(os.path.realpath(icd.library) if named else icd.library, icd)
    native = len(wanted) == len(registered)
    if not _original_vendors:
        for library in environment_libraries()[:1]:
            if os.path.realpath(library) not in wanted:
                wanted[os.path.realpath(library)] = Icd(str(library), str(library))
                native = False
    return list(wanted.values()), native


def point_loader_at(selection: list[Icd] | None) -> None:
    """Restricts this process (and its children) to the selection; None: the loader's own choice.

    Call it before the first OpenCL call: the loader reads its environment just once.
    """
    global _original_home
    if selection is None:
        if os.environ.get(VENDORS) != _original_vendors:
            for name, value in ((VENDORS, _original_vendors), (_HOME, _original_home)):
                os.environ.pop(name, None)
                if value is not None:
                    os.environ[name] = value
        return
    content = json.dumps([[icd.path, icd.library] for icd in selection])
    digest = hashlib.sha256(content.encode()).hexdigest()
    folder = cache_folder()
    try:
        if folder is None:
            raise OSError("no cache folder")
        target = folder / f"platforms-{digest[:16]}"
        if not target.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder, prefix=".platforms-") as fresh:
                write_selection(selection, Path(fresh))
                os.chmod(fresh, 0o755)
                try:
                    os.rename(fresh, target)
                except OSError:
                    if not target.is_dir():  # rather than another process having made it first
                        raise
                else:
                    os.mkdir(fresh)  # what the with statement expects to remove
    except OSError:
        # Lives as long as this process, and so do the children that inherit the variable.
        target = scratch_folder() / f"platforms-{digest[:16]}"
        target.mkdir(exist_ok=True)
        write_selection(selection, target)
    load_pyopencl()  # which sets the variable, by which its loader finds the wheel's .icd
    if _original_home is None:
        _original_home = os.environ.get(_HOME)
    os.environ[VENDORS] = str(target)
    os.environ[_HOME] = str(target)
