"""Probing all platforms in child processes (:mod:`clvol.opencl.probe`): a broken one takes only a child down."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from clvol.opencl.children import BegunChild, Child, run_child
from clvol.opencl.kernels_path import kernel_folder
from clvol.opencl.reports import DeviceReport, Findings, Icd, named


def begin(wanted: list[Icd], native: bool, keep: Path) -> BegunChild:
    """Begins with the first child of a ``probe`` for which PoCL is enough; the programs that it is told meanwhile are
    kept in the folder ``keep``."""
    request = _request(wanted, []) | {"pocl_is_enough": True, "serves": True}
    return BegunChild(request, None if native else list(wanted), keep)


def probe(
    wanted: list[Icd], native: bool, time_limit: float, enough: bool = False, begun: BegunChild | None = None,
    built: Callable[[str, str], None] | None = None,
) -> Findings:  # fmt: skip
    """Probe the platforms; ``native`` says that the loader finds them all by itself. ``enough``: a device of PoCL that
    works is enough, others need not be tried. ``begun``: the first child, from ``begin``; ``built(token, place)`` is
    called for each program that it has built."""
    selection = None if native else list(wanted)
    broken: list[DeviceReport] = []
    ends: list[str] = []
    left_out: list[str] = []
    reports, death = _probe_devices(wanted, selection, time_limit, ends, enough, begun, built, left_out)
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
                child = run_child({"enumerate_only": True}, selection + [icd], time_limit)
                if child.death and not child.has("listed"):
                    broken.append(_icd_report(icd, child.death))
                else:
                    selection.append(icd)
        reports, death = [], None
        if selection:
            left_out.clear()
            reports, death = _probe_devices(selection, selection, time_limit, ends)
        if death is not None:  # it lists now and then only: better no device than a crash
            broken += [_icd_report(icd, death) for icd in selection]
            reports, selection = [], []
    if any(ends):
        kept, useless = _without_bad_ends(wanted if selection is None else selection, time_limit)
        if useless:
            selection, broken = kept, broken + useless
    return Findings(named(reports + broken), selection, not left_out)


def _without_bad_ends(
    icds: list[Icd], time_limit: float
) -> tuple[list[Icd], list[DeviceReport]]:
    """The platforms that have a device or let a process end well, and reports of the others, which would only
    spoil its exit status."""
    kept, useless = [], []
    for icd in icds:
        child: Child = run_child({"enumerate_only": True}, [icd], time_limit)
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


def _request(icds: list[Icd], skip: list[tuple[int, int]]) -> dict[str, Any]:
    return {"enumerate_only": False, "kernel": str(kernel_folder() / "probe.cl"), "salt": os.urandom(6).hex(),
            "skip": skip, "libraries": [[icd.path, icd.library] for icd in icds]}


def _probe_devices(
    icds: list[Icd], selection: list[Icd] | None, time_limit: float, ends: list[str], enough: bool = False,
    begun: BegunChild | None = None, built: Callable[[str, str], None] | None = None,
    left_out: list[str] | None = None,
) -> tuple[list[DeviceReport], str | None]:  # fmt: skip
    """Probe every device; the second value is how the child died if it could not even list them. How it
    ended is appended to ``ends``, and devices that were not tried to ``left_out``. Otherwise as ``probe``."""
    found: dict[tuple[int, int], DeviceReport] = {}
    unloadable: list[DeviceReport] = []
    known = {f.name for f in fields(DeviceReport)}
    while True:
        if begun is None:
            request = _request(icds, sorted(found)) | {"pocl_is_enough": enough}
            child = run_child(request, selection, time_limit)
        else:
            child, begun = begun.finished(time_limit), None
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
                if event.get("left_out") and left_out is not None:
                    left_out.append(found[current].device)
                current = None
            elif event["event"] == "built" and built is not None:
                built(event["token"], event["place"])
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
