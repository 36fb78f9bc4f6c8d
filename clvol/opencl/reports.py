"""What a probe of the OpenCL devices found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DeviceReport:
    """What ``clvol doctor`` tells of one device, or of a platform that yields none.

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


@dataclass(frozen=True)
class Icd:
    """One line that tells the OpenCL loader of a platform's library."""

    path: str  # the .icd file (or the library itself, where the environment names it directly)
    library: str  # its line: a path, or a name that the dynamic linker finds


@dataclass
class Findings:
    """The outcome of a probe: the reports, and the platforms to use if not the loader's own."""

    reports: list[DeviceReport]
    selection: list[Icd] | None = None
