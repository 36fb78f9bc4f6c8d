"""Builds and runs cl/reference.cl: the exact integral along given rays."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from clvol.errors import DeviceError, RenderError
from clvol.opencl.binding import cl
from clvol.opencl.build import build_file
from clvol.opencl.forks import check_fork, opencl_used

if TYPE_CHECKING:
    import pyopencl

_VOXEL_NAMES = {
    "uint8": "uchar",
    "int8": "char",
    "uint16": "ushort",
    "int16": "short",
    "float32": "float",
    "float64": "double",
}
_FIRST_LAUNCH = 512  # rays
_LAUNCH_SECONDS = 0.3  # short enough for a progress report and for Ctrl-C


@dataclass(frozen=True)
class RayIntegrals:
    """The kernel's results for n rays.

    ``rgba`` [n, 4] premultiplied; ``depth`` [n] world distance, inf where the opacity never reaches
    one half; ``error`` [n] sum of the error estimates of all pieces; ``counters`` [n, 4] uint32:
    cells walked, pieces integrated, evaluations of the field, pieces that missed the tolerance.
    """

    rgba: np.ndarray
    depth: np.ndarray
    error: np.ndarray
    counters: np.ndarray
    seconds: float


def integrate_rays(
    device: pyopencl.Device,
    voxels: np.ndarray,
    value_scale: float,
    control: dict[str, np.ndarray],
    opacity_unit: float,
    tolerance: float,
    origins: np.ndarray,
    directions: np.ndarray,
    *,
    filter: str,
    preclassified: bool,
    progress: Callable[[int, int], None] | None = None,
) -> RayIntegrals:
    """Integrate along rays given in index space.

    ``voxels`` [z, y, x] in their own type; values count as voxel * ``value_scale`` (a power of 2).
    ``control`` holds the transfer function on the same scale: "value" [n], "opacity" [n],
    "clearness" [n] (1 - opacity), "color" [n, 3], "visible_below" [n + 2] int32. ``origins`` and
    ``directions`` are float64 [n, 3], directions per world length. ``filter``: "nearest", "linear"
    or "cubic". ``progress(done, total)`` is called after each launch of some rows of rays.

    Raises DeviceError (no fp64, the volume does not fit in one buffer, the device fails) and
    RenderError (the kernel does not build).
    """
    check_fork()
    _check(device, voxels)
    count = len(origins)
    result = RayIntegrals(
        np.empty((count, 4)), np.empty(count), np.empty(count), np.empty((count, 4), np.uint32), 0.0
    )
    started = time.perf_counter()
    try:
        context, program = _program(device, voxels.dtype.name, filter, preclassified)
        queue = cl.CommandQueue(context)
        read = cl.mem_flags.READ_ONLY
        # A CPU reads the host's own memory; anything else gets a copy.
        on_host = device.type & cl.device_type.CPU
        place = cl.mem_flags.USE_HOST_PTR if on_host else cl.mem_flags.COPY_HOST_PTR

        def upload(array: np.ndarray, dtype: type) -> cl.Buffer:
            array = np.ascontiguousarray(array, dtype)
            return cl.Buffer(context, read | cl.mem_flags.COPY_HOST_PTR, hostbuf=array)

        voxel_buffer = cl.Buffer(context, read | place, hostbuf=voxels)
        control_buffers = [
            upload(control[name], np.float64) for name in ("value", "opacity", "clearness", "color")
        ]
        visible_buffer = upload(control["visible_below"], np.int32)
        kernel = cl.Kernel(program, "reference_integral")
        local = 8 if on_host else 64
        done, launch = 0, min(_FIRST_LAUNCH, max(count, 1))
        while done < count:
            end = min(done + launch, count)
            size = end - done
            rays = [upload(a[done:end], np.float64) for a in (origins, directions)]
            outputs = [
                cl.Buffer(context, cl.mem_flags.WRITE_ONLY, size * width)
                for width in (32, 8, 8, 16)
            ]
            nz, ny, nx = voxels.shape
            kernel.set_args(
                voxel_buffer, np.int32(nx), np.int32(ny), np.int32(nz), np.float64(value_scale),
                *control_buffers, visible_buffer, np.int32(len(control["value"])),
                np.float64(opacity_unit), np.float64(tolerance), *rays, np.int64(size), *outputs,
            )
            begun = time.perf_counter()
            groups = -(-size // local)
            cl.enqueue_nd_range_kernel(queue, kernel, (groups * local,), (local,)).wait()
            for array, buffer in zip(
                (result.rgba, result.depth, result.error, result.counters), outputs
            ):
                cl.enqueue_copy(queue, array[done:end], buffer)
            for buffer in (*rays, *outputs):
                buffer.release()
            took = time.perf_counter() - begun
            done = end
            launch = int(np.clip(launch * _LAUNCH_SECONDS / max(took, 1e-3), 64, 4 * launch))
            if progress is not None:
                progress(done, count)
    except cl.Error as error:
        what = " ".join(str(error).split())
        where = f"device {device.name.strip()}"
        raise DeviceError(where, f"the reference failed: {what}") from error
    return RayIntegrals(
        result.rgba, result.depth, result.error, result.counters, time.perf_counter() - started
    )


def _check(device: pyopencl.Device, voxels: np.ndarray) -> None:
    where = f"device {device.name.strip()}"
    # NVIDIA and PoCL name the extension; 1.2 devices may only state the configuration.
    if not (device.double_fp_config or "cl_khr_fp64" in device.extensions):
        raise DeviceError(where, "it has no double precision", "a device with fp64 (clvol doctor)")
    if voxels.nbytes > device.max_mem_alloc_size:
        raise DeviceError(
            where,
            f"the volume takes {voxels.nbytes} bytes",
            f"at most {device.max_mem_alloc_size} bytes in one buffer",
        )


@lru_cache(maxsize=32)
def _program(device: pyopencl.Device, voxel: str, filter: str, preclassified: bool):
    """The context and the built program of one variant; built once per process."""
    options = ["-cl-std=CL1.2", f"-DREFERENCE_VOXEL={_VOXEL_NAMES[voxel]}"]
    if voxel.startswith("float"):
        options.append("-DREFERENCE_FLOATING")
    if filter != "linear":
        options.append(f"-DREFERENCE_{filter.upper()}")
    if preclassified:
        options.append("-DREFERENCE_PRECLASSIFIED")
    opencl_used()
    context = cl.Context([device])
    try:
        return context, build_file(context, "reference.cl", options)
    except cl.RuntimeError as error:
        log = " ".join(str(error).split())[:2000]
        what = f"it does not build with {' '.join(options)}: {log}"
        raise RenderError("reference.cl", what) from error
