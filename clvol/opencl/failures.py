"""What drivers report, as typed errors: which call failed on which device, and whether memory was missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from clvol.errors import ClvolError, DeviceError, RenderError
from clvol.opencl.binding import cl


class LacksMemory(ClvolError):
    """The device has too little memory for what was requested; for less of it there may be enough."""


class BufferMemoryError(LacksMemory, DeviceError):
    """A buffer cannot be made."""

    exit_status = DeviceError.exit_status


class LaunchMemoryError(LacksMemory, RenderError):
    """A kernel or a copy cannot be run. OUT_OF_RESOURCES is one of the reasons, and can have others than memory."""

    exit_status = RenderError.exit_status


@contextmanager
def failures_of(where: str) -> Iterator[None]:
    """Turns what a driver reports in the block into a RenderError of ``where``: whatever the code, the device has not
    done what was requested, and another one may."""
    try:
        yield
    except cl.Error as error:
        kind = LaunchMemoryError if isinstance(error, cl.MemoryError) else RenderError
        raise kind(where, f"failed ({error})") from None
