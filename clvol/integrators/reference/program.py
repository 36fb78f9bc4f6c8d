"""Builds and runs cl/reference.cl: the exact integral along given rays."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from clvol.errors import DeviceError, RenderError
from clvol.opencl.binding import cl
from clvol.opencl.build import build_file, is_pocl
from clvol.opencl.devices import device_name
from clvol.opencl.forks import check_fork, opencl_used
from clvol.opencl.launches import SafeLaunches
from clvol.schedule.crew import Team

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
_ITEM = 64  # rays that devices share as one
_FIRST_SPEED, _FIRST_COST, _LAUNCH_COST = 1e7, 64 * 500.0, 2e-3  # cells per second, cells per item, and seconds
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
    seconds: float = 0.0

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        return self.rgba, self.depth, self.error, self.counters


def _empty(count: int) -> RayIntegrals:
    return RayIntegrals(np.empty((count, 4)), np.empty(count), np.empty(count), np.empty((count, 4), np.uint32))


def integrate_rays(
    device: pyopencl.Device | Sequence[pyopencl.Device],
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
    on_loss: Callable[[int, BaseException], None] | None = None,
) -> RayIntegrals:
    """Integrate along rays given in index space.

    ``device``: one, or several that share the rays. ``voxels`` [z, y, x] in their own type; values count as
    voxel * ``value_scale`` (a power of 2).
    ``control`` holds the transfer function on the same scale: "value" [n], "opacity" [n],
    "clearness" [n] (1 - opacity), "color" [n, 3], "visible_below" [n + 2] int32. ``origins`` and
    ``directions`` are float64 [n, 3], directions per world length. ``filter``: "nearest", "linear"
    or "cubic". ``progress(done, total)`` is called now and then with numbers of rays.

    Raises DeviceError (no fp64, the volume does not fit in one buffer, the device fails) and
    RenderError (the kernel does not build). One of several devices that fails is left out, with a warning, or a call of
    ``on_loss(device, error)``.
    """
    check_fork()
    devices = list(device) if isinstance(device, Sequence) else [device]
    count = len(origins)
    result = _empty(count)
    started = time.perf_counter()
    scene = _Scene(voxels, value_scale, control, opacity_unit, tolerance, filter, preclassified)
    hands = [_RaysOnDevice(each, scene, origins, directions, result) for each in devices]
    if len(hands) == 1:
        hands[0].begin()
        hands[0].integrate(np.arange(count), progress)
    elif count:
        items = -(-count // _ITEM)
        team = Team([device_name(each) for each in devices], _FIRST_SPEED, _LAUNCH_COST)
        report = None if progress is None else lambda done: progress(min(done * _ITEM, count), count)
        try:
            team.run(hands, np.full(items, _FIRST_COST), lambda _, taken: taken(), report, on_loss)
        finally:
            team.close()
    return replace(result, seconds=time.perf_counter() - started)


@dataclass(frozen=True, eq=False)
class _Scene:
    """What rays are integrated through: see ``integrate_rays``."""

    voxels: np.ndarray
    value_scale: float
    control: dict[str, np.ndarray]
    opacity_unit: float
    tolerance: float
    filter: str
    preclassified: bool


class _RaysOnDevice:
    """Integrates rays on one ``device``; a ``clvol.schedule.crew.Hand`` whose items are ``_ITEM`` rays each."""

    def __init__(
        self, device: pyopencl.Device, scene: _Scene, origins: np.ndarray, directions: np.ndarray, result: RayIntegrals
    ) -> None:
        self._device, self._scene, self._rays, self._result = device, scene, (origins, directions), result
        self._launch = _FIRST_LAUNCH

    def begin(self) -> None:
        scene, device = self._scene, self._device
        _check(device, scene.voxels)
        with _failures(device):
            self._context, program = _program(device, scene.voxels.dtype.name, scene.filter, scene.preclassified)
            self._queue = cl.CommandQueue(self._context)
            # A CPU reads the host's own memory; anything else gets a copy.
            self._on_host = device.type & cl.device_type.CPU
            place = cl.mem_flags.USE_HOST_PTR if self._on_host else cl.mem_flags.COPY_HOST_PTR
            self._voxels = cl.Buffer(self._context, cl.mem_flags.READ_ONLY | place, hostbuf=scene.voxels)
            self._control = [
                self._upload(scene.control[name], np.float64) for name in ("value", "opacity", "clearness", "color")
            ]
            self._visible = self._upload(scene.control["visible_below"], np.int32)
            self._kernel = cl.Kernel(program, "reference_integral")
            self._safe = SafeLaunches(program, "reference_integral", self) if is_pocl(device) else None

    def _upload(self, array: np.ndarray, dtype: type) -> cl.Buffer:
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self._context, flags, hostbuf=np.ascontiguousarray(array, dtype))

    def work(self, items: np.ndarray) -> tuple[np.ndarray, Callable[[], None]]:
        """Costs are counts of cells and pieces, which are the same on all devices."""
        rays = (items[:, None] * _ITEM + np.arange(_ITEM)).ravel()
        rays = rays[rays < len(self._rays[0])]
        own = _empty(len(rays))
        self.integrate(rays, None, own)
        counted = own.counters[:, :2].sum(axis=1, dtype=np.float64)
        first = np.arange(0, len(rays), _ITEM)

        def take() -> None:
            for array, part in zip(self._result.arrays, own.arrays):
                array[rays] = part

        return np.add.reduceat(counted, first) + 1.0, take

    def integrate(
        self, rays: np.ndarray, progress: Callable[[int, int], None] | None, into: RayIntegrals | None = None
    ) -> None:
        """Integrates along ``rays`` (numbers), in launches that are kept short, and writes results to ``into``, ray by
        ray in this order."""
        into = self._result if into is None else into
        with _failures(self._device):
            done, count = 0, len(rays)
            while done < count:
                end = min(done + min(self._launch, count), count)
                begun = time.perf_counter()
                self._run(rays[done:end], into, done, end)
                took = time.perf_counter() - begun
                done = end
                self._launch = int(np.clip(self._launch * _LAUNCH_SECONDS / max(took, 1e-3), 64, 4 * self._launch))
                if progress is not None:
                    progress(done, count)

    def _run(self, rays: np.ndarray, into: RayIntegrals, begin: int, end: int) -> None:
        scene, size = self._scene, end - begin
        sent = [self._upload(a[rays], np.float64) for a in self._rays]
        outputs = [
            cl.Buffer(self._context, cl.mem_flags.WRITE_ONLY, size * width)
            for width in (32, 8, 8, 16)
        ]
        nz, ny, nx = scene.voxels.shape
        self._kernel.set_args(
            self._voxels, np.int32(nx), np.int32(ny), np.int32(nz), np.float64(scene.value_scale),
            *self._control, self._visible, np.int32(len(scene.control["value"])),
            np.float64(scene.opacity_unit), np.float64(scene.tolerance), *sent, np.int64(size), *outputs,
        )  # fmt: skip
        local = 8 if self._on_host else 64
        groups = -(-size // local)
        grid = (groups * local,), (local,)

        def enqueue() -> cl.Event:
            return cl.enqueue_nd_range_kernel(self._queue, self._kernel, *grid)

        (enqueue() if self._safe is None else self._safe.launch(*grid, enqueue)).wait()
        for array, buffer in zip(into.arrays, outputs):
            cl.enqueue_copy(self._queue, array[begin:end], buffer)
        for buffer in (*sent, *outputs):
            buffer.release()


@contextmanager
def _failures(device: pyopencl.Device) -> Iterator[None]:
    """DeviceError for what OpenCL reports in the block."""
    try:
        yield
    except cl.Error as error:
        what = " ".join(str(error).split())
        where = f"device {device.name.strip()}"
        raise DeviceError(where, f"the reference failed: {what}") from error


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
