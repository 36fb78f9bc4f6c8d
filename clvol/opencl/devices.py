"""Lists OpenCL devices and whether they work, and opens one.

A device counts as working when a child process (:mod:`clvol.opencl.probe`) has compiled and run a
small kernel on it with correct results. A platform that crashes or hangs takes only the
child down; it is then kept out of this process by pointing the loader (``OCL_ICD_VENDORS``) at a
folder that registers only the others. The outcome is kept in the user's cache folder, so that
only the first run after a change pays for it.
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from clvol.errors import ClvolError, DeviceError
from clvol.limits import check_room_for_opencl
from clvol.opencl import device_cache
from clvol.opencl.binding import cl
from clvol.opencl.children import ORIGINAL_VENDORS, BegunChild
from clvol.opencl.forks import check_fork, opencl_used
from clvol.opencl.icd import platforms_wanted, point_loader_at
from clvol.opencl.pocl_programs import foresee, foreseen_folder, is_empty, own_pocl_folder
from clvol.opencl.probing import begin, probe
from clvol.opencl.reports import DeviceReport, Findings, rank
from clvol.opencl.runtime import register_runtimes

if TYPE_CHECKING:
    import pyopencl

TIME_LIMIT = 30.0  # seconds that each step of a probe (listing, one device) may take
HOW_TO_GET_ONE = 'a CPU device: "apt install pocl-opencl-icd", or pip install "clvol[cpu]"'

_found: Findings | None = None
_begun: BegunChild | None = None  # by look_ahead


# --- public -----------------------------------------------------------------------------------


def list_devices(*, fresh: bool = False, time_limit: float = TIME_LIMIT) -> list[DeviceReport]:
    """Every device of every platform, working or not; then platforms that yield no device at all.

    ``fresh`` probes anew whatever the cache says (``clvol doctor``); ``time_limit`` is in seconds
    for each step. Nothing an OpenCL library does in its own process (crash, hang, wrong results)
    makes this call fail; no platform at all gives an empty list. Where some platform must be left
    out, this process's ``OCL_ICD_VENDORS`` is set: call it before the first OpenCL call. Raises
    :class:`clvol.errors.RenderError` where a limit on memory leaves compilers no room (``ulimit -v``).
    """
    return _reports(fresh, False, time_limit)


def _reports(fresh: bool = False, enough: bool = True, time_limit: float = TIME_LIMIT) -> list[DeviceReport]:
    """As ``list_devices``. ``enough``: if PoCL's device works, others need not have been tried."""
    global _found, _begun
    if _found is None or fresh or not (enough or _found.complete):
        register_runtimes()
        wanted, native = platforms_wanted()
        key = device_cache.cache_key(wanted, ORIGINAL_VENDORS)
        findings = None if fresh else device_cache.read_cache(key)
        if findings is None or not (enough or findings.complete):
            check_room_for_opencl(loaded=False)
            enough = enough and not fresh
            if not enough:
                end_look_ahead()
            begun, _begun = _begun, None
            findings = probe(wanted, native, time_limit, enough, begun, foresee)
            if any(report.working for report in findings.reports):
                device_cache.write_cache(key, findings)
            else:
                device_cache.forget(key)
        _found = findings
        point_loader_at(findings.selection)
    return list(_found.reports)


def look_ahead() -> None:
    """Begins to look for devices in a process of its own, if no earlier process has, for whoever opens one later:
    scenes are loaded meanwhile. Raises nothing."""
    global _found, _begun
    if _found is not None or _begun is not None:
        return
    try:
        register_runtimes()
        wanted, native = platforms_wanted()
        findings = device_cache.read_cache(device_cache.cache_key(wanted, ORIGINAL_VENDORS))
        if findings is not None:
            _found = findings
            point_loader_at(findings.selection)
            return
        check_room_for_opencl(loaded=False)
        _begun = begin(wanted, native, foreseen_folder())
    except (ClvolError, OSError):  # whoever opens a device meets it
        return


def end_look_ahead() -> None:
    """Ends the process of ``look_ahead``, if nobody has waited for it."""
    global _begun
    if _begun is not None:
        _begun.end()
        _begun = None


def _forget_begun() -> None:
    global _begun
    _begun = None  # it is the parent's


atexit.register(end_look_ahead)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_begun)


def is_looking_ahead() -> bool:
    """Whether ``look_ahead`` has begun with what is not finished yet, on a machine where no program is kept yet."""
    return _begun is not None and is_empty()


def build_ahead(programs: Sequence[Mapping[str, str]]) -> None:
    """Has ``programs`` (``build.foreseen_program``) built for PoCL in the process of ``look_ahead``, where the compiler
    is loaded already."""
    if _begun is not None:
        _begun.build(programs)


def open_device(name: str | None = None) -> pyopencl.Device:
    """The device called ``name``, or the default: PoCL's CPU, another CPU, a GPU, in this order.

    ``name`` is one that :func:`list_devices` gives, or any part of a device's name, platform or
    type, in any case. A device that was found working earlier but cannot be opened now is probed
    again. Raises :class:`clvol.errors.DeviceError` with what was found and why it does not work.
    """
    check_fork()
    pin_threads()
    for fresh in (False, True):
        reports = _reports(fresh, name is None or name.strip().lower() == "pocl")
        try:
            candidates = select(reports, name)
        except DeviceError:
            # The cache may be out of date (a driver repaired, a device added), or not all were tried: look once more.
            if fresh or not (device_cache.came_from_cache() or (_found is not None and not _found.complete)):
                raise
            continue
        for report in candidates:
            device = _open(report)
            if device is not None:
                return device
    raise DeviceError(f'device "{candidates[0].name}"',
                      "it works in a process of its own but cannot be opened in this one",
                      "a fresh process that makes no OpenCL call of its own first")


def open_devices(name: str | None = None) -> list[pyopencl.Device]:
    """The devices that ``name`` means: as for ``open_device``, or "all", or "NAME:k/n", the k-th (from 1) of n parts of
    a device with as many compute units each.

    "all" takes one device per processor, the fastest as far as speeds are known (``keep_speeds``), since the runtimes
    of one processor share its cores. Raises
    :class:`clvol.errors.DeviceError`.
    """
    if name is None:
        return [open_device()]
    if name.strip().lower() == "all":
        return [open_device(report.name) for report in one_per_processor(list_devices())]
    whole, slash, parts = name.rpartition(":")
    if slash and "/" in parts:
        return [_part_of_device(whole, parts, name)]
    return [open_device(name)]


def named_devices(name: str | None = None) -> list[str]:
    """The names of the devices that ``open_devices`` would open, without opening one: no driver is loaded. A part of a
    device is not checked."""
    if name is not None and name.strip().lower() == "all":
        return [report.name for report in one_per_processor(list_devices())]
    whole, slash, parts = (name or "").rpartition(":")
    if slash and "/" in parts:
        return [f"{select(list_devices(), whole)[0].name}:{parts}"]
    return [select(_reports() if name is None else list_devices(), name)[0].name]


def one_per_processor(reports: list[DeviceReport]) -> list[DeviceReport]:
    """Of the working devices that are the same processor, the fastest; the first where a speed is not known. CPUs are
    one processor; other devices are told apart by their names and numbers."""
    return [_fastest(same) for same in by_processor(reports)]


def by_processor(reports: list[DeviceReport]) -> list[list[DeviceReport]]:
    """The working devices, those of one processor together, best first."""
    found: dict[tuple, list[DeviceReport]] = {}
    for report in sorted((r for r in reports if r.working), key=rank):
        is_cpu = report.type.upper() == "CPU"
        found.setdefault(("CPU",) if is_cpu else (report.device, report.device_index), []).append(report)
    return list(found.values())


def _fastest(reports: list[DeviceReport]) -> DeviceReport:
    return max(reports, key=lambda report: report.speed) if all(r.speed for r in reports) else reports[0]


def keep_speeds(speeds: Mapping[str, float]) -> None:
    """Keeps the measured speeds of devices (by name, in samples per second) with what the probe found."""
    global _found
    if _found is None or not any(speeds.values()):
        return
    reports = [replace(report, speed=speeds.get(report.name) or report.speed) for report in _found.reports]
    _found = replace(_found, reports=reports)
    device_cache.write_cache(device_cache.cache_key(platforms_wanted()[0], ORIGINAL_VENDORS), _found)


_parts: dict[tuple[int, str], tuple[list[pyopencl.Device], str]] = {}  # they must not be made twice


def _part_of_device(whole: str, parts: str, name: str) -> pyopencl.Device:
    expected = "NAME:k/n with whole numbers 1 <= k <= n, such as pocl:1/2"
    number, _, count = parts.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise DeviceError(f'device "{name}"', "not a part of a device", expected)
    device = open_device(whole)
    units = int(device.max_compute_units)
    each = units // int(count)
    if not each:
        raise DeviceError(f'device "{name}"', f"{whole} has {units} compute units", f"at most {units} parts")
    key = device.int_ptr, count
    if key not in _parts:
        try:
            made = device.create_sub_devices([cl.device_partition_property.EQUALLY, each])  # type: ignore[list-item]
        except cl.Error as error:
            raise DeviceError(f'device "{name}"', f"{whole} cannot be divided ({error})", "a whole device") from None
        _parts[key] = made[: int(count)], count
    return _parts[key][0][int(number) - 1]


def device_name(device: pyopencl.Device) -> str:
    """The name by which a user requests ``device``."""
    for made, count in _parts.values():
        if device in made:
            return f"{device_name(device.parent_device)}:{made.index(device) + 1}/{count}"
    report = report_of(device)
    return report.name if report is not None else device.name.strip()


def pin_threads() -> None:
    """Makes PoCL keep each of its threads on one core, unless the environment says otherwise.

    Without this the system occasionally wakes two of them on one core, after other work has run, and
    such a frame takes half as long again. Pinning uses absolute core numbers, so nothing is set in a process that
    is restricted to some cores or threads.
    """
    if "POCL_AFFINITY" in os.environ or "POCL_MAX_PTHREAD_COUNT" in os.environ:
        return
    if hasattr(os, "sched_getaffinity") and len(os.sched_getaffinity(0)) == os.cpu_count():
        os.environ["POCL_AFFINITY"] = "1"


def select(reports: list[DeviceReport], name: str | None = None) -> list[DeviceReport]:
    """The working devices that ``name`` may mean (None: any), best first; never empty.

    An exact name wins over a part of one. Raises :class:`clvol.errors.DeviceError`.
    """
    working = sorted((r for r in reports if r.working), key=rank)
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
    usable = sorted((r for r in named if r.working), key=rank)
    if not usable:
        why = f"it does not work: {named[0].reason}"
        raise DeviceError(f'device "{name}"', why, f"one of {names}")
    return usable


def report_of(device: pyopencl.Device) -> DeviceReport | None:
    """The report of an opened device, or None for a device that :func:`list_devices` does not list."""
    platform = device.platform
    if device not in platform.get_devices():  # a part of one
        return None
    for report in _reports():
        if ((platform.name, platform.version) == (report.platform, report.platform_version)
                and _is(device, report)
                and platform.get_devices().index(device) == report.device_index):
            return report
    return None


def forget_devices() -> None:
    """Drops all findings, here and in the cache; to be called when a device that worked fails."""
    global _found
    _found = None
    device_cache.forget(device_cache.cache_key(platforms_wanted()[0], ORIGINAL_VENDORS))


# --- choosing and opening -----------------------------------------------------------------------


def _nothing_works(reports: list[DeviceReport]) -> str:
    if not reports:
        return "no platform found"
    return "no device works: " + "; ".join(f"{r.name}: {r.reason}" for r in reports)


def _open(report: DeviceReport) -> pyopencl.Device | None:
    """The device itself, or None if it no longer matches the report."""
    opencl_used()
    try:
        with own_pocl_folder():
            # The platform's index cannot be used: the loader reads a folder in any order.
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
