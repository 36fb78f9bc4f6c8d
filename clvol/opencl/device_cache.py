"""The outcome of a probe, kept in the user's cache folder, so that only the first run after a change
pays for it."""

from __future__ import annotations

import hashlib
import json
import os
import platform as host
import sys
from dataclasses import asdict
from pathlib import Path

from clvol.opencl.folders import cache_folder, why_no_cache
from clvol.opencl.kernels_path import kernel_folder
from clvol.opencl.notices import notice
from clvol.opencl.program_store import EACH_TIME
from clvol.opencl.reports import DeviceReport, Findings, Icd

_FORMAT = 4  # version of the cache file's format
_KEPT = 16  # cache files kept in the folder
_VENDORS = "OCL_ICD_VENDORS"
# Environment variables that change what a platform lists or how it behaves start like this.
_RELEVANT = ("OCL_", "OPENCL_", "POCL_", "CL_CONFIG", "CUDA_", "GPU_", "ROCR_", "HIP_", "RUSTICL_",
             "LD_LIBRARY_PATH", "LD_PRELOAD")
_came_from_cache = False


def came_from_cache() -> bool:
    """Whether the findings that were read or written last were an earlier process's."""
    return _came_from_cache


def _stat(path: str | Path) -> list:
    try:
        status = os.stat(path)
    except OSError:
        return [str(path)]
    return [str(path), status.st_mtime_ns, status.st_size]


def cache_key(wanted: list[Icd], vendors: str | None) -> str:
    """A digest of everything that can change a probe's outcome and is cheap to read. ``vendors``: the
    OCL_ICD_VENDORS that this process was started with."""
    from importlib import metadata

    try:
        version = metadata.version("pyopencl")
    except metadata.PackageNotFoundError:
        version = ""
    folders = ["/usr/lib", f"/usr/lib/{host.machine()}-linux-gnu", "/usr/lib64", "/usr/local/lib"]
    libraries = []
    for icd in wanted:
        libraries.append([icd.path, icd.library, _stat(icd.path)])
        if os.path.isabs(icd.library):
            libraries[-1].append(_stat(icd.library))
        else:  # the dynamic linker's names: wherever the library lies, one of these changes with it
            libraries[-1] += [_stat(os.path.join(f, icd.library)) for f in folders]
    try:
        processors = len(os.sched_getaffinity(0))
    except AttributeError:
        processors = os.cpu_count() or 1
    sources = [*sorted(Path(__file__).parent.glob("*.py")), *sorted(kernel_folder().iterdir())]
    facts = [
        _FORMAT, version, sys.executable, host.node(), host.machine(), host.release(), processors,
        libraries, _stat("/etc/ld.so.cache"), _stat("/usr/bin/ld"), [_stat(source) for source in sources],
        _limits(), vendors,
        sorted((k, v) for k, v in os.environ.items() if k.startswith(_RELEVANT) and k != _VENDORS),
    ]
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def _limits() -> list:
    """The limits of this process: a device that works may fail under tighter limits."""
    try:
        import resource
    except ImportError:
        return []
    names = ("RLIMIT_AS", "RLIMIT_DATA", "RLIMIT_NPROC", "RLIMIT_NOFILE", "RLIMIT_STACK", "RLIMIT_FSIZE")
    limits = [resource.getrlimit(getattr(resource, name))[0] for name in names]
    return [os.geteuid(), *limits]


def _cache_file(key: str) -> Path | None:
    folder = cache_folder()
    return None if folder is None else folder / f"devices-{key[:24]}.json"


def read_cache(key: str) -> Findings | None:
    """The findings of an earlier process, or None if they are missing, unreadable, damaged, or have another key."""
    global _came_from_cache
    path = _cache_file(key)
    _came_from_cache = False
    try:
        if path is None or not path.is_file():
            return None
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["key"] != key:
            return None
        reports = []
        for item in content["reports"]:
            report = DeviceReport(**{**item, "extensions": tuple(item["extensions"])})
            if any(not isinstance(getattr(report, n), kind) for n, kind in _FIELD_TYPES.items()):
                return None
            reports.append(report)
        selection = content["selection"]
        if selection is not None:
            selection = [Icd(str(path), str(library)) for path, library in selection]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
    if not any(report.working for report in reports):
        return None
    _came_from_cache = True
    return Findings(reports, selection, bool(content["complete"]))


_FIELD_TYPES = {
    "name": str, "platform": str, "platform_version": str, "device": str, "driver": str,
    "type": str, "reason": str, "working": bool, "device_index": int, "global_memory": int, "max_buffer": int,
    "compute_units": int, "fp64": bool, "speed": float,
}


def write_cache(key: str, findings: Findings) -> None:
    """Keeps the findings for later processes; a folder that cannot be written to is reported, once."""
    global _came_from_cache
    _came_from_cache = False
    path = _cache_file(key)
    if path is None:
        notice("cache", f"there is none ({why_no_cache()}); {EACH_TIME}")
        return
    selection = findings.selection
    content = {"key": key, "complete": findings.complete, "reports": [asdict(report) for report in findings.reports],
               "selection": None if selection is None else [[i.path, i.library] for i in selection]}
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")
        os.replace(temporary, path)
    except OSError as error:
        notice(f"cache {path.parent}", f"cannot be written ({error.strerror}); {EACH_TIME}")
        try:
            temporary.unlink(missing_ok=True)
        except OSError:
            pass
        return
    try:
        files = sorted(path.parent.glob("devices-*.json"), key=lambda p: p.stat().st_mtime)
        for old in files[:-_KEPT]:
            old.unlink()
    except OSError:  # another process did the same
        pass


def forget(key: str) -> None:
    """Drops the findings kept under ``key``."""
    path = _cache_file(key)
    try:
        if path is not None:
            path.unlink(missing_ok=True)
    except OSError:
        pass
