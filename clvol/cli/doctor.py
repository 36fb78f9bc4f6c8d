"""clvol doctor: which devices there are, and why others are left out."""

from __future__ import annotations

from dataclasses import asdict

import click

from clvol.cli.options import json_option


@click.command("doctor", short_help="The OpenCL devices: working, or why not.")
@json_option
def command(as_json: bool) -> None:
    """List the OpenCL devices, each probed with a small kernel. Status 3 if none works."""
    from clvol.cli.console import say, say_json, say_table
    from clvol.opencl.devices import list_devices, select
    from clvol.scene.sizes import format_size
    from clvol.text import printable

    reports = list_devices(fresh=True)
    if as_json:
        say_json({"devices": [asdict(report) for report in reports]})
    else:
        for report in reports:
            say(printable(f"{report.name}: {'works' if report.working else 'does not work'}"))
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
            say_table(rows)
    select(reports)  # raises the DeviceError, which says how to get a device
