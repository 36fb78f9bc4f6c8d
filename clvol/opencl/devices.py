"""Which OpenCL devices there are, which of them work, and one of them opened.

A device counts as working when a child process (:mod:`clvol.opencl.probe`) has compiled and run a
small kernel on it and the numbers were right. A platform that crashes or hangs takes only the
child down; it is then kept out of this process by pointing the loader (``OCL_ICD_VENDORS``) at a
folder that registers only the others. The outcome is kept in the user's cache folder, so that
only the first run after a change pays for it.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clvol.errors import DeviceError
from clvol.limits import check_room_for_opencl
from clvol.opencl import device_cache
from clvol.opencl.children import ORIGINAL_VENDORS, VENDORS, write_selection
from clvol.opencl.children import Child as _Child
from clvol.opencl.children import run_child as _run_child
from clvol.opencl.folders import cache_folder, scratch_folder
from clvol.opencl.forks import check_fork, opencl_used
from clvol.opencl.kernels_path import kernel_folder
from clvol.opencl.reports import DeviceReport, Findings, Icd
from clvol.opencl.runtime import environment_libraries, loader_folder, register_runtimes

if TYPE_CHECKING:
    import pyopencl

TIME_LIMIT = 30.0  # seconds that each step of a probe (listing, one device) may take
HOW_TO_GET_ONE = 'a CPU device: "apt install pocl-opencl-icd", or pip install "clvol[cpu]"'

_HOME = "PYOPENCL_HOME"

_original_vendors = ORIGINAL_VENDORS
_original_home: str | None = None
_found: Findings | None = None


# --- public -----------------------------------------------------------------------------------


def list_devices(*, fresh: bool = False, time_limit: float = TIME_LIMIT) -> list[DeviceReport]:
    """Every device of every platform, working or not; then platforms that yield no device at all.

    ``fresh`` probes anew whatever the cache says (``clvol doctor``); ``time_limit`` is in seconds
    for each step. Nothing an OpenCL library does in its own process (crash, hang, wrong results)
    makes this call fail; no platform at all gives an empty list. Where some platform must be left
    out, this process's ``OCL_ICD_VENDORS`` is set: call it before the first OpenCL call. Raises
    :class:`clvol.errors.RenderError` where a limit on memory leaves compilers no room (``ulimit -v``).
    """
    global _found
    if _found is None or fresh:
        register_runtimes()
        wanted, native = _platforms_wanted()
        key = device_cache.cache_key(wanted, _original_vendors)
        findings = None if fresh else device_cache.read_cache(key)
        if findings is None:
            check_room_for_opencl(loaded=False)
            findings = _probe(wanted, native, time_limit)
            if any(report.working for report in findings.reports):
                device_cache.write_cache(key, findings)
            else:
                device_cache.forget(key)
        _found = findings
        _point_loader_at(findings.selection)
    return list(_found.reports)


def open_device(name: str | None = None) -> pyopencl.Device:
    """The device called ``name``, or the default: PoCL's CPU, another CPU, a GPU, in this order.

    ``name`` is one that :func:`list_devices` gives, or any part of a device's name, platform or
    type, in any case. A device that was found working earlier but cannot be opened now is probed
    again. Raises :class:`clvol.errors.DeviceError` with what was found and why it does not work.
    """
    check_fork()
    pin_threads()
    for fresh in (False, True):
        reports = list_devices(fresh=fresh)
        try:
            candidates = select(reports, name)
        except DeviceError:
            # The cache may be out of date (a driver repaired, a device added): look once more.
            if fresh or not device_cache.came_from_cache():
                raise
            continue
        for report in candidates:
            device = _open(report)
            if device is not None:
                return device
    raise DeviceError(f'device "{candidates[0].name}"',
                      "it works in a process of its own but cannot be opened in this one",
                      "a fresh process that makes no OpenCL call of its own first")


def pin_threads() -> None:
    """Has PoCL keep each of its threads on one core, if nobody has said otherwise.

    Left alone, the system now and then wakes two of them on one core, after other work has run, and
    such a frame takes half as long again. Pinning is absolute, so it is not for a process that
    was given some cores or threads only: then nothing is set.
    """
    if "POCL_AFFINITY" in os.environ or "POCL_MAX_PTHREAD_COUNT" in os.environ:
        return
    if hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == os.cpu_count():
        os.environ["POCL_AFFINITY"] = "1"


def select(reports: list[DeviceReport], name: str | None = None) -> list[DeviceReport]:
    """The working devices that ``name`` may mean (None: any), best first; never empty.

    An exact name wins over a part of one. Raises :class:`clvol.errors.DeviceError`.
    """
    working = sorted((r for r in reports if r.working), key=_rank)
    if not working:
        raise DeviceError("OpenCL", _nothing_works(reports), HOW_TO_GET_ONE)
    if name is None:
        return working
    wanted = name.strip().lower()
    exact = [r for r in reports if r.name == wanted or r.name + ":0" == wanted]
    named = exact or [
        r for r in reports if wanted
        and any(wanted in text.lower() for text in (r.name, r.platform, r.device, r.type))
    ]
    names = ", ".join(r.name for r in working)
    if not named:
        raise DeviceError(f'device "{name}"', "there is none of this name", f"one of {names}")
    usable = sorted((r for r in named if r.working), key=_rank)
    if not usable:
        why = f"it does not work: {named[0].reason}"
        raise DeviceError(f'device "{name}"', why, f"one of {names}")
    return usable


def report_of(device: pyopencl.Device) -> DeviceReport | None:
    """The report of an opened device, or None for a device that :func:`list_devices` knows not."""
    platform = device.platform
    for report in list_devices():
        if ((platform.name, platform.version) == (report.platform, report.platform_version)
                and _is(device, report)
                and platform.get_devices().index(device) == report.device_index):
            return report
    return None


def forget_devices() -> None:
    """Drop what is known, here and in the cache: call it when a device that worked fails."""
    global _found
    _found = None
    device_cache.forget(device_cache.cache_key(_platforms_wanted()[0], _original_vendors))


# --- choosing and opening -----------------------------------------------------------------------


def _rank(report: DeviceReport) -> tuple[int, str, int]:
    """PoCL's CPU, other CPUs, GPUs, others, platforms without a device; not by loading order."""
    order = {"CPU": 1, "GPU": 2, "": 4}.get(report.type, 3)
    if report.type == "CPU" and _short_name(report) == "pocl":
        order = 0
    return order, report.platform, report.device_index


def _nothing_works(reports: list[DeviceReport]) -> str:
    if not reports:
        return "no platform found"
    return "no device works: " + "; ".join(f"{r.name}: {r.reason}" for r in reports)


def _open(report: DeviceReport) -> pyopencl.Device | None:
    """The device itself, or None when it is no longer what the report says."""
    from clvol.opencl.binding import cl
    from clvol.opencl.pocl_programs import own_pocl_folder

    opencl_used()
    try:
        with own_pocl_folder():
            # Not by the platform's index: the loader reads a folder in whatever order it comes.
            for platform in cl.get_platforms():
                if (platform.name, platform.version) == (report.platform, report.platform_version):
                    devices = platform.get_devices()
                    index = report.device_index
                    if index < len(devices) and _is(devices[index], report):
                        cl.Context([devices[index]])
                        return devices[index]
    except cl.Error:
        pass
    return None


def _is(device: pyopencl.Device, report: DeviceReport) -> bool:
    texts = (device.name, device.driver_version)
    return tuple(" ".join(text.split()) for text in texts) == (report.device, report.driver)


def _short_name(report: DeviceReport) -> str:
    platform = report.platform.lower()
    if "portable computing language" in platform or "pocl" in platform:
        return "pocl"
    for vendor in ("nvidia", "amd", "intel"):
        if vendor in platform:
            return f"{vendor}-gpu" if vendor == "intel" and report.type == "GPU" else vendor
    words = "".join(c if c.isalnum() else " " for c in platform).split()
    return words[0] if words else "unnamed"


def _named(reports: list[DeviceReport]) -> list[DeviceReport]:
    """The reports with their names: the platform's short one, numbered from the second on."""
    seen: dict[str, int] = {}
    named = []
    for report in sorted(reports, key=_rank):
        base = report.name or _short_name(report)
        number = seen.get(base, 0)
        seen[base] = number + 1
        named.append(replace(report, name=f"{base}:{number}" if number else base))
    return named


# --- which platforms are registered --------------------------------------------------------------


def registered_icds(vendors: str | None = None) -> list[Icd]:
    """What the loader reads: ``vendors`` (``OCL_ICD_VENDORS``: an .icd file, a library, a folder)
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


def _platforms_wanted() -> tuple[list[Icd], bool]:
    """The platforms to try, and whether the loader by itself reads just these, each once."""
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


def _point_loader_at(selection: list[Icd] | None) -> None:
    """Restrict this process (and its children) to the selection; None: the loader's own choice."""
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
                    if not target.is_dir():  # not merely another process being quicker
                        raise
                else:
                    os.mkdir(fresh)  # what the with statement expects to remove
    except OSError:
        # Lives as long as this process, and so do the children that inherit the variable.
        target = scratch_folder() / f"platforms-{digest[:16]}"
        target.mkdir(exist_ok=True)
        write_selection(selection, target)
    from clvol.opencl import binding  # pyopencl sets the variable, by which its loader finds the wheel's .icd

    del binding
    if _original_home is None:
        _original_home = os.environ.get(_HOME)
    os.environ[VENDORS] = str(target)
    os.environ[_HOME] = str(target)


# --- probing in child processes -------------------------------------------------------------------


def _probe(wanted: list[Icd], native: bool, time_limit: float) -> Findings:
    """Probe the platforms; ``native`` says that the loader finds them all by itself."""
    selection = None if native else list(wanted)
    broken: list[DeviceReport] = []
    ends: list[str] = []
    reports, death = _probe_devices(wanted, selection, time_limit, ends)
    if death is not None:
        # Some platform takes the process down as soon as the loader asks it. Take them in one by
        # one; this also finds two that are well alone but cannot live in one process.
        if len(wanted) <= 1:
            selection = []
            broken = [_icd_report(icd, death) for icd in wanted] or [
                DeviceReport(name="opencl", platform="OpenCL loader", reason=death)]
        else:
            selection = []
            for icd in wanted:
                child = _run_child({"enumerate_only": True}, selection + [icd], time_limit)
                if child.death and not child.has("listed"):
                    broken.append(_icd_report(icd, child.death))
                else:
                    selection.append(icd)
        reports, death = [], None
        if selection:
            reports, death = _probe_devices(selection, selection, time_limit, ends)
        if death is not None:  # it lists now and then only: better no device than a crash
            broken += [_icd_report(icd, death) for icd in selection]
            reports, selection = [], []
    if any(ends):
        kept, useless = _without_bad_ends(wanted if selection is None else selection, time_limit)
        if useless:
            selection, broken = kept, broken + useless
    return Findings(_named(reports + broken), selection)


def _without_bad_ends(
    icds: list[Icd], time_limit: float
) -> tuple[list[Icd], list[DeviceReport]]:
    """Those that have a device or let a process end well; and reports of the others, which would only
    spoil its exit status."""
    kept, useless = [], []
    for icd in icds:
        child: _Child = _run_child({"enumerate_only": True}, [icd], time_limit)
        platforms = sum(e["count"] for e in child.events if e["event"] == "platforms")
        empty = sum(e["event"] == "device" for e in child.events)  # that is all it tells of when listing
        if child.end and platforms <= empty:
            reason = f"it has no device, and a process that loads it {child.end} at its end"
            useless.append(_icd_report(icd, reason))
        else:
            kept.append(icd)
    return kept, useless


def _icd_report(icd: Icd, reason: str) -> DeviceReport:
    stem = Path(icd.path).name.split(".")[0].lower()
    source = f"{icd.path} ({icd.library})"
    return DeviceReport(name=stem or "unnamed", platform=source, reason=reason)


def _probe_devices(
    icds: list[Icd], selection: list[Icd] | None, time_limit: float, ends: list[str]
) -> tuple[list[DeviceReport], str | None]:
    """Probe every device; the second value is how the child died if it could not even list them. How it
    ended is appended to ``ends``."""
    found: dict[tuple[int, int], DeviceReport] = {}
    unloadable: list[DeviceReport] = []
    known = {f.name for f in fields(DeviceReport)}
    while True:
        request = {"enumerate_only": False, "kernel": str(kernel_folder() / "probe.cl"),
                   "salt": os.urandom(6).hex(), "skip": sorted(found),
                   "libraries": [[icd.path, icd.library] for icd in icds]}
        child = _run_child(request, selection, time_limit)
        ends.append(child.end)
        if child.death and not child.has("started"):
            return [], child.death
        current: tuple[int, int] | None = None
        for event in child.events:
            if event["event"] == "device":
                current = (event["platform_index"], event["device_index"])
                values: dict[str, Any] = {k: v for k, v in event.items() if k in known}
                values["extensions"] = tuple(values.get("extensions", ()))
                found[current] = DeviceReport(name="", **values)
            elif event["event"] == "tested" and current is not None:
                found[current] = replace(found[current], working=event["working"],
                                         reason=event["reason"])
                current = None
            elif event["event"] == "icd":
                icd = next(i for i in icds if i.path == event["path"])
                unloadable.append(_icd_report(icd, f"cannot be loaded: {event['error']}"))
        if current is not None:  # it died on this one: leave it out and go on with the next
            found[current] = replace(found[current], working=False,
                                     reason=child.death or "the probe ended without an answer")
            continue
        if child.death and not child.has("listed"):
            return [], child.death
        return [found[key] for key in sorted(found)] + unloadable, None
