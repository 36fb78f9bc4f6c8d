"""The findings of a probe of the OpenCL devices."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class DeviceReport:
    """The report of ``clvol doctor`` on one device, or on a platform without devices.

    ``name`` is short, unique and stable ("pocl", "intel", "nvidia", "pocl:1"); ``reason`` is one
    line, "" for a working device. Memory figures are bytes; zero or "" where nothing is known
    because the platform broke before it could tell.
    """

    name: str
    platform: str
    device: str = ""
    vendor: str = ""
    version: str = ""
    platform_version: str = ""
    opencl_c: str = ""
    driver: str = ""
    type: str = ""
    compute_units: int = 0
    global_memory: int = 0
    max_buffer: int = 0
    local_memory: int = 0
    max_work_group: int = 0
    fp64: bool = False
    extensions: tuple[str, ...] = ()
    working: bool = False
    reason: str = ""
    device_index: int = -1  # within its platform
    speed: float = 0.0  # samples per second, as measured once; 0 if it was not


@dataclass(frozen=True)
class Icd:
    """One line that tells the OpenCL loader of a platform's library."""

    path: str  # the .icd file (or the library itself, where the environment names it directly)
    library: str  # its line: a path, or a name that the dynamic linker finds


@dataclass
class Findings:
    """The outcome of a probe: the reports, and the platforms to use if not the loader's own. ``complete``: all devices
    were tried; else PoCL's works, and others were not."""

    reports: list[DeviceReport]
    selection: list[Icd] | None = None
    complete: bool = True


def rank(report: DeviceReport) -> tuple[int, str, int]:
    """A key that sorts devices, best first: PoCL's CPU, other CPUs, GPUs, others, platforms without a device.

    The order in which the loader lists platforms has no part in it.
    """
    order = {"CPU": 1, "GPU": 2, "": 4}.get(report.type, 3)
    if report.type == "CPU" and short_name(report) == "pocl":
        order = 0
    return order, report.platform, report.device_index


def short_name(report: DeviceReport) -> str:
    """The platform's name in one word, such as "pocl", "intel" or "intel-gpu"."""
    platform = report.platform.lower()
    if "portable computing language" in platform or "pocl" in platform:
        return "pocl"
    for vendor in ("nvidia", "amd", "intel"):
        if vendor in platform:
            return f"{vendor}-gpu" if vendor == "intel" and report.type == "GPU" else vendor
    words = "".join(c if c.isalnum() else " " for c in platform).split()
    return words[0] if words else "unnamed"


def named(reports: list[DeviceReport]) -> list[DeviceReport]:
    """The reports with their names: the platform's short one, numbered from the second on."""
    seen: dict[str, int] = {}
    named = []
    for report in sorted(reports, key=rank):
        base = report.name or short_name(report)
        number = seen.get(base, 0)
        seen[base] = number + 1
        named.append(replace(report, name=f"{base}:{number}" if number else base))
    return named
