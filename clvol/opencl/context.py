"""An opened device: its context and queue, buffers, programs and kernels.

Kernels are called with arguments by name, which are declared beforehand (clvol/opencl/arguments.py), so that
a wrong array raises a Python error instead of giving a wrong picture.
"""

from __future__ import annotations

import logging
import signal
import sys
import threading
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary, finalize

import numpy as np

from clvol.errors import DeviceError, RenderError
from clvol.limits import check_room_for_opencl
from clvol.opencl.arguments import Argument, known_sizes
from clvol.opencl.binding import cl
from clvol.opencl.build import build_file, is_pocl, keep_programs
from clvol.opencl.devices import device_name
from clvol.opencl.failures import BufferMemoryError, failures_of
from clvol.opencl.forks import check_fork, is_forked, opencl_used
from clvol.opencl.launches import SafeLaunches


@dataclass(frozen=True, eq=False)
class DeviceArray:
    """A buffer with the dtype and shape of its contents; ``host`` keeps memory alive that it uses."""

    buffer: cl.Buffer
    dtype: np.dtype
    shape: tuple[int, ...]
    host: np.ndarray | None = None

    @property
    def nbytes(self) -> int:
        return int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize


_log = logging.getLogger(__name__)


class Kernel:
    """A kernel and the arguments it takes. Not for two threads at once.

    ``alone``: work-items are groups of their own where a call names no size of groups. The driver would choose one by
    the number of work-items; PoCL compiles the kernel again for every size, and so for every new size of a volume.
    ``device``: its name, for errors. ``safe``: orders launches on devices that need it.
    """

    def __init__(
        self,
        program: Any,
        name: str,
        arguments: tuple[Argument, ...],
        alone: bool = False,
        device: str | None = None,
        safe: SafeLaunches | None = None,
    ) -> None:
        self.name = name
        self._where = device or f"kernel {name}"
        self.arguments = arguments
        self._names = {argument.name for argument in arguments}
        self._alone, self._safe = alone, safe
        self._kernel = cl.Kernel(program, name)
        if self._kernel.num_args != len(self.arguments):
            raise RenderError(
                f"kernel {name}",
                f"takes {self._kernel.num_args} arguments",
                f"the {len(self.arguments)} that are declared",
            )

    def __call__(
        self,
        queue: cl.CommandQueue,
        global_size: Sequence[int],
        local_size: Sequence[int] | None,
        *,
        sizes: Mapping[str, int] | None = None,
        **given: Any,
    ) -> cl.Event:
        """Enqueues the kernel with its arguments by name. ``sizes``: values of names in their shapes, in addition to
        the kernel's own integer arguments."""
        check_fork()
        if given.keys() != self._names:
            expected = ", ".join(argument.name for argument in self.arguments)
            raise RenderError(f"kernel {self.name}", f"got {', '.join(given)}", expected)
        values = {a.name: a.checked_value(self.name, given[a.name]) for a in self.arguments if a.intent == "value"}
        known = {**(sizes or {}), **known_sizes(values)}
        with failures_of(self._where):
            for index, argument in enumerate(self.arguments):
                if argument.intent == "value":
                    self._kernel.set_arg(index, values[argument.name])
                    continue
                array = given[argument.name]
                if not isinstance(array, DeviceArray):
                    where = f"kernel {self.name}, argument {argument.name}"
                    raise RenderError(where, f"got {type(array).__name__}", "a DeviceArray")
                argument.check_buffer(self.name, array, known)
                self._kernel.set_arg(index, array.buffer)
            if local_size is None and self._alone:
                local_size = (1,) * len(global_size)
            size = tuple(int(n) for n in global_size)
            groups = None if local_size is None else tuple(int(n) for n in local_size)
            if self._safe is None:
                return cl.enqueue_nd_range_kernel(queue, self._kernel, size, groups)
            return self._safe.launch(
                size, groups, lambda: cl.enqueue_nd_range_kernel(queue, self._kernel, size, groups)
            )


def restore_interrupts() -> None:
    """Restores Python's Ctrl-C handler, since compilers inside drivers (LLVM) install their own."""
    if threading.current_thread() is threading.main_thread():
        handler = signal.getsignal(signal.SIGINT)
        if handler is not None:
            signal.signal(signal.SIGINT, handler)


_PAGE = 4096
_LARGE_PAGE = 2**21
_KEPT, _LARGEST_KEPT = 6, 64 * 2**20  # number of outputs kept for reuse, and bytes of the largest


class DeviceContext:
    """A context and an in-order queue on one device, with its programs built so far. For one thread at a time:
    kernels hold their arguments, and the ``Renderer`` that has a context lets threads in one by one.
    """

    def __init__(self, device: cl.Device) -> None:
        check_room_for_opencl(loaded=True)
        opencl_used()
        self.device = device
        self.name = device_name(device)
        self.is_cpu = bool(device.type & cl.device_type.CPU)
        self._alone = self.is_cpu and is_pocl(device)
        # PoCL 3.1 runs what a part of its device is given on all threads of the device, not on the part's.
        self.uses_all_threads = is_pocl(device) and device.parent_device is not None
        self.has_double = "cl_khr_fp64" in device.extensions.split()
        self.compile_seconds = 0.0
        try:
            self.context = cl.Context([device])
            self.queue = cl.CommandQueue(self.context)
        except cl.Error as error:
            raise DeviceError(self.name, f"cannot be used ({error})", "a working device") from None
        _log.info("rendering on %s: %s (%s)", self.name, device.name.strip(), device.platform.name.strip())
        self._outputs: list[tuple[DeviceArray, int]] = []
        self._lent: set[int] = set()  # ids of outputs that have not been taken yet
        self._written: WeakKeyDictionary[DeviceArray, tuple[bytes, Any]] = WeakKeyDictionary()  # by write_once
        self._programs: dict[tuple, Any] = {}
        self._kernels: dict[tuple, Kernel] = {}
        self.warmed: set[Hashable] = set()  # what has been launched once, by keys of those who launch it

    def release(self) -> None:
        """Waits for the queue, forgets kernels and programs, and stores the programs for later processes."""
        if is_forked():  # the queue belongs to the parent: waiting for it would not end
            return
        try:
            self.queue.finish()
        except cl.Error:  # the device is lost, with whatever was enqueued
            _log.info("%s does not finish its queue", self.name)
        keep_programs()
        self._outputs.clear()
        self._programs.clear()
        self._kernels.clear()
        self.warmed.clear()

    # Programs

    def kernel(
        self,
        file: str,
        name: str,
        arguments: Sequence[Argument],
        switches: Mapping[str, int] | None = None,
        folder: Path | None = None,
    ) -> Kernel:
        """Kernel ``name`` of cl/``file`` with ``switches`` (-D), built at most once. ``folder``: one more to include
        files from."""
        options = compile_options(switches or {})
        arguments = tuple(arguments)
        key = (file, name, options, folder, arguments)
        if key not in self._kernels:
            program = self._program(file, options, folder)
            safe = SafeLaunches(program, name, self) if is_pocl(self.device) else None
            self._kernels[key] = Kernel(program, name, arguments, self._alone, self.name, safe)
        return self._kernels[key]

    def _program(self, file: str, options: tuple[str, ...], folder: Path | None) -> Any:
        key = (file, options, folder)
        if key not in self._programs:
            check_fork()
            start = time.perf_counter()
            try:
                program = build_file(self.context, file, options, folder)
            except cl.RuntimeError as error:
                lines = [line for line in str(error).splitlines() if "error" in line.lower()]
                reason = lines[0] if lines else str(error)
                what = f"does not build on {self.name} with {' '.join(options)}: {reason}"
                raise RenderError(f"cl/{file}", what) from None
            restore_interrupts()
            self._programs[key] = program
            self.compile_seconds += time.perf_counter() - start
        return self._programs[key]

    # Buffers

    def upload(self, array: np.ndarray, *, writable: bool = False) -> DeviceArray:
        """A copy of ``array`` on the device, which kernels may only read unless it is ``writable``."""
        array = np.ascontiguousarray(array)
        kind = cl.mem_flags.READ_WRITE if writable else cl.mem_flags.READ_ONLY
        flags = kind | cl.mem_flags.COPY_HOST_PTR
        return self._buffer(flags, array.dtype, array.shape, array)

    def share(self, array: np.ndarray) -> DeviceArray:
        """``array`` (contiguous, not changed while in use) as a read-only buffer; on a CPU device
        without a copy."""
        if not self.is_cpu:
            return self.upload(array)
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        return self._buffer(flags, array.dtype, array.shape, array)

    def empty(self, dtype: Any, shape: Sequence[int]) -> DeviceArray:
        """An uninitialised array on the device."""
        return self._buffer(cl.mem_flags.READ_WRITE, np.dtype(dtype), tuple(shape), None)

    def resident(
        self, dtype: Any, shape: Sequence[int], fill: Callable[[np.ndarray], None] | None = None
    ) -> DeviceArray:
        """An array that kernels read at many places, and that is kept until they are done: a volume. ``fill`` writes
        its contents; without it they are not initialised. On a CPU device it lies in large pages, where the system has
        them: rays meet a new row of voxels, which of pages of 4 KiB is mostly another page, at nearly every sample, and
        a translation that is not at hand costs as much as the sample.
        """
        check_fork()
        nbytes = int(np.prod(shape, dtype=np.int64)) * np.dtype(dtype).itemsize
        if not self.is_cpu or nbytes < _LARGE_PAGE:
            if fill is None:
                return self.empty(dtype, shape)
            fill(small := np.empty(shape, dtype))
            return self.upload(small)
        try:
            # numpy asks for large pages; a buffer that begins and ends where runtimes want it is used without a copy.
            memory = np.empty(nbytes + 2 * _LARGE_PAGE, np.uint8)
        except MemoryError as error:
            raise _no_memory(self.name, nbytes, error) from None
        first = -memory.ctypes.data % _LARGE_PAGE
        host = memory[first : first + nbytes].view(dtype).reshape(shape)
        if fill is not None:
            fill(host)
        return self._buffer(cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, host.dtype, host.shape, host)

    def refill(self, array: DeviceArray, fill: Callable[[np.ndarray], None]) -> None:
        """Has ``fill`` write other contents into ``array``, a ``resident`` one, once everything enqueued is done. It
        gets an array with arbitrary contents."""
        check_fork()
        if array.host is None:
            fill(fresh := np.empty(array.shape, array.dtype))
            self.write(array, fresh)
            return
        with failures_of(self.name):
            mapped, _ = cl.enqueue_map_buffer(
                self.queue, array.buffer, cl.map_flags.WRITE, 0, array.shape, array.dtype
            )
            try:
                fill(array.host)  # which is what is mapped
            finally:
                mapped.base.release(self.queue)

    def output(self, dtype: Any, shape: Sequence[int], host: np.ndarray | None = None) -> DeviceArray:
        """An array that a kernel writes and ``take`` then returns: on a CPU device the kernel
        writes directly into host memory; into ``host``, if given (``shared_array``)."""
        check_fork()
        if not self.is_cpu:
            return self.empty(dtype, shape)
        if host is not None:
            flags = cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR
            return self._buffer(flags, host.dtype, host.shape, host)
        key = (np.dtype(dtype), tuple(shape))
        for output, references in self._outputs:
            # The output is free if nothing else refers to it, since its last picture was dropped. Fresh memory would
            # cost a page fault for every 4 KiB of each frame.
            free = id(output) not in self._lent and sys.getrefcount(output.host) == references
            if free and (output.dtype, output.shape) == key:
                self._lent.add(id(output))
                return output
        host = np.empty(shape, dtype)
        flags = cl.mem_flags.WRITE_ONLY | cl.mem_flags.USE_HOST_PTR
        output = self._buffer(flags, host.dtype, host.shape, host)
        del host
        if output.nbytes <= _LARGEST_KEPT:
            self._outputs.append((output, sys.getrefcount(output.host)))
            self._lent.add(id(output))
            for dropped, _ in self._outputs[:-_KEPT]:
                self._lent.discard(id(dropped))  # another object may get the same id
            del self._outputs[:-_KEPT]
        return output

    def take(self, output: DeviceArray) -> np.ndarray:
        """The contents of an ``output`` once everything enqueued is done. The output is not reused while the returned
        array, or a view of it, exists."""
        return self.take_all([output])[0]

    def take_all(self, outputs: Sequence[DeviceArray]) -> list[np.ndarray]:
        """As ``take``, of several outputs, with a single wait."""
        check_fork()
        with failures_of(self.name):
            waiting = [self._mapped(output) for output in outputs if output.host is not None]
            if waiting:
                waiting[-1][1].wait()  # the queue is in order
            for mapped, _ in waiting:
                mapped.base.release(self.queue)
        self._lent.difference_update(map(id, outputs))
        return [self.read(output) if output.host is None else output.host for output in outputs]

    def _mapped(self, output: DeviceArray) -> tuple[Any, cl.Event]:
        """The memory of an ``output`` and the event after which it may be read."""
        mapped, event = cl.enqueue_map_buffer(
            self.queue, output.buffer, cl.map_flags.READ, 0, output.shape, output.dtype, is_blocking=False
        )
        return mapped, event

    def write(self, array: DeviceArray, values: np.ndarray, first: int = 0) -> None:
        """Copies ``values`` into ``array``, from element ``first`` on; returns when the copy is done."""
        check_fork()
        values = np.ascontiguousarray(values)
        offset = first * array.dtype.itemsize
        with failures_of(self.name):
            cl.enqueue_copy(self.queue, array.buffer, values, dst_offset=offset, is_blocking=True)

    def write_once(self, array: DeviceArray, values: np.ndarray) -> None:
        """As ``write``, of all of an ``array`` that nothing else writes. Nothing is done if it has these values: a
        launch need not wait for others that use them."""
        check_fork()
        contents = values.tobytes()
        if self._written.get(array, (None,))[0] != contents:
            # Nothing waits for it: the queue is in order. The event keeps what is copied.
            self._written[array] = contents, self._enqueue_write(array, values.copy())

    def _enqueue_write(self, array: DeviceArray, values: np.ndarray) -> Any:
        with failures_of(self.name):
            return cl.enqueue_copy(self.queue, array.buffer, values, is_blocking=False)

    def copy(
        self, source: DeviceArray, first: int, target: DeviceArray, to: int, count: int
    ) -> None:
        """Enqueues a copy of ``count`` elements, starting at ``first`` in ``source``, to position ``to`` in ``target``,
        which has the same dtype. Within one array they must not overlap."""
        check_fork()
        size = source.dtype.itemsize
        with failures_of(self.name):
            cl.enqueue_copy(
                self.queue,
                target.buffer,
                source.buffer,
                byte_count=count * size,
                src_offset=first * size,
                dst_offset=to * size,
            )

    def read(self, array: DeviceArray, out: np.ndarray | None = None) -> np.ndarray:
        """The contents of ``array``; waits for everything enqueued before."""
        check_fork()
        if out is None:
            out = np.empty(array.shape, array.dtype)
        with failures_of(self.name):
            cl.enqueue_copy(self.queue, out, array.buffer, is_blocking=True)
        return out

    def finish(self) -> None:
        """Waits for everything enqueued; RenderError if any of it failed."""
        check_fork()
        with failures_of(self.name):
            self.queue.finish()

    def _buffer(
        self, flags: int, dtype: np.dtype, shape: tuple[int, ...], host: np.ndarray | None
    ) -> DeviceArray:
        check_fork()
        nbytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
        limit = int(self.device.max_mem_alloc_size)
        if nbytes > limit:
            raise DeviceError(
                self.name, f"one buffer of {nbytes} bytes is needed", f"at most {limit} bytes"
            )
        try:
            if host is None:
                buffer = cl.Buffer(self.context, flags, max(nbytes, 1))
            else:
                buffer = cl.Buffer(self.context, flags, hostbuf=host)
        except (cl.Error, MemoryError) as error:
            raise _no_memory(self.name, nbytes, error) from None
        keeps = host if flags & cl.mem_flags.USE_HOST_PTR else None
        return DeviceArray(buffer, dtype, shape, keeps)


def _no_memory(name: str, nbytes: int, error: Exception) -> DeviceError:
    return BufferMemoryError(name, f"no memory for {nbytes} bytes ({error})", "a smaller volume or image")


_free: list[np.ndarray] = []  # memory of shared arrays that nothing refers to any more


def shared_array(shape: Sequence[int], dtype: Any) -> np.ndarray:
    """An array into which several CPU devices can write without copies, since it begins at a page. Memory of earlier
    ones is used again: fresh memory is zeroed page by page, while a frame is rendered."""
    dtype = np.dtype(dtype)
    nbytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    memory = _taken(nbytes + _PAGE)
    first = -memory.ctypes.data % _PAGE
    owner = np.frombuffer(memory.data[first : first + nbytes], dtype)
    if nbytes <= _LARGEST_KEPT:
        finalize(owner, _give_back, memory).atexit = False  # views of the array keep its owner
    return owner.reshape(shape)


def _taken(nbytes: int) -> np.ndarray:
    """Memory of exactly ``nbytes``. Other threads may take and give back at the same time."""
    kept = []
    found = None
    while _free and found is None:
        memory = _free.pop()
        if len(memory) == nbytes:
            found = memory
        else:
            kept.append(memory)
    for memory in kept:
        _give_back(memory)
    return np.empty(nbytes, np.uint8) if found is None else found


def _give_back(memory: np.ndarray) -> None:
    _free.append(memory)
    del _free[:-_KEPT]


def compile_options(switches: Mapping[str, int]) -> tuple[str, ...]:
    """The one place where switches become compiler flags. Values are integers, never scene text. No warnings: PoCL's
    compiler would write to the user's terminal how many it has (of vectors that are wider than registers)."""
    return ("-cl-std=CL1.2", "-w", *(f"-D{name}={int(value)}" for name, value in sorted(switches.items())))
