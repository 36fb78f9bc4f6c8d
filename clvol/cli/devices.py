"""Devices as commands name them."""

from __future__ import annotations

from collections.abc import Sequence


def measure_for_all(devices: Sequence[str], quiet: bool) -> None:
    """Measures devices of one processor once, if "all" has to choose between them."""
    if "all" not in (name.strip().lower() for name in devices):
        return
    from clvol.cli.console import working
    from clvol.cli.trial import try_render
    from clvol.opencl.devices import by_processor, keep_speeds, list_devices

    for same in by_processor(list_devices()):
        if len(same) > 1 and not all(report.speed for report in same):
            with working("measuring the speed of devices", quiet):
                keep_speeds({report.name: try_render(report.name).speed for report in same})
