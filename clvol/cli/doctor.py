"""clvol doctor: lists the devices that work, and says why others do not."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import click

from clvol.cli.options import json_option

if TYPE_CHECKING:
    from clvol.opencl.cache_report import CacheReport
    from clvol.opencl.reports import DeviceReport


@click.command("doctor", short_help="List the OpenCL devices: working, or why not.")
@json_option
def command(as_json: bool) -> None:
    """List the OpenCL devices, and the caches on disk.

    A small picture is rendered on each device and checked. The exit status is 3 if no device works.
    """
    from clvol.cli.console import say, say_json, working
    from clvol.cli.trial import try_render
    from clvol.opencl.cache_report import report_caches
    from clvol.opencl.devices import keep_speeds, list_devices, select
    from clvol.text import printable

    caches = report_caches()
    reports = []
    problems = list(caches.problems)
    for report in list_devices(fresh=True):
        if report.working:
            with working(f"rendering on {report.name}", as_json):
                trial = try_render(report.name)
            report = replace(report, working=not trial.reason, reason=trial.reason, speed=trial.speed)
            notices = (f"{where}: {what}" for where, what in trial.notices.items())
            # Problems of the caches are listed already.
            problems += [n for n in notices if n not in problems and not (caches.problems and n.startswith("cache"))]
        reports.append(report)
    keep_speeds({report.name: report.speed for report in reports})
    caches = replace(caches, problems=problems)
    if as_json:
        say_json({"devices": [asdict(report) for report in reports], "cache": asdict(caches)})
    else:
        for report in reports:
            say(printable(f"{report.name}: {'works' if report.working else 'does not work'}"))
            _show_device(report)
        _show_caches(caches)
    select(reports)  # raises the DeviceError, which says how to get a device


def _show_device(report: DeviceReport) -> None:
    from clvol.cli.console import say_table
    from clvol.scene.sizes import format_size

    rows = [("  platform", report.platform)]
    if not report.working:
        rows.append(("  reason", report.reason))
    if report.device:
        double = "yes" if report.fp64 else "no"
        memory = format_size(report.global_memory)
        buffer = format_size(report.max_buffer)
        rows += [
            ("  device", report.device),
            ("  driver", f"{report.driver} ({report.version})"),
            ("  memory", f"{memory}, at most {buffer} in one buffer"),
            ("  units", f"{report.compute_units}, double precision: {double}"),
        ]
        if report.speed:
            rows.append(("  speed", f"{report.speed / 1e6:.3g} million samples per second"))
    say_table(rows)


def _show_caches(caches: CacheReport) -> None:
    from clvol.cli.console import say, say_table
    from clvol.scene.sizes import format_size
    from clvol.text import printable

    say(printable(f"cache: {caches.folder or 'none'}"))
    programs = f"{caches.programs}, {format_size(caches.size)}"
    rows = [("  programs", programs), ("  temporary files", caches.temporary or "nowhere")]
    if caches.pocl_folder is not None:
        rows.append(("  PoCL's programs", caches.pocl_folder))
    rows += [("  problem", problem) for problem in caches.problems]
    say_table(rows)
