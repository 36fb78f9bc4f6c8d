"""Programs built from source, or loaded as an earlier process compiled them from the same source."""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from clvol.opencl import pocl_programs, program_store
from clvol.opencl.binding import cl
from clvol.opencl.forks import is_forked
from clvol.opencl.kernels_path import kernel_folder
from clvol.opencl.source import whole_source
from clvol.quietly import without_warnings

_log = logging.getLogger(__name__)
_POCL = "Portable Computing Language"
_lock = threading.Lock()  # PoCL compiles one program at a time anyway


def build_file(
    context: cl.Context, file: str | Path, options: Sequence[str], folder: Path | None = None
) -> Any:
    """The built program of ``file`` (in cl/, or an absolute path); ``folder``: one more to include files from.

    Raises RenderError for a missing source, and pyopencl's RuntimeError with the compiler's
    messages where it does not build.
    """
    kernels = kernel_folder()
    folders = (kernels,) if folder is None else (Path(folder), kernels)
    start = time.perf_counter()
    program, where = _build(context, whole_source(kernels / file, folders), options)
    _log.info("%s: %s, %.2f s; %s", Path(file).name, where, time.perf_counter() - start, " ".join(options))
    return program


def is_pocl(device: cl.Device) -> bool:
    """Whether PoCL drives the device: it compiles kernels when they are first enqueued, once per size of groups."""
    return device.platform.name == _POCL


def build_program(context: cl.Context, source: str, options: Sequence[str]) -> Any:
    """The program of ``source`` (without any #include), built for the context's only device.

    ``options`` are words without blanks or quotes: implementations parse those differently.
    """
    return _build(context, source, options)[0]


_COMPILED, _FROM_CACHE = "compiled", "found in the cache"


def _build(context: cl.Context, source: str, options: Sequence[str]) -> tuple[Any, str]:
    """The program, and a phrase about its origin."""
    device = context.devices[0]
    words = " ".join(options).encode()
    key = program_key(device, source, options)
    with _lock, without_warnings(cl.CompilerWarning):  # drivers warn that compilation is done
        if is_pocl(device):
            where = _FROM_CACHE if pocl_programs.restore(key) else _COMPILED
            if where == _COMPILED and pocl_programs.adopt(key, program_token(source, options)):
                where = "built while devices were looked for"
            program = _built(cl._cl._Program(context, source), words)
            pocl_programs.built(key)
            return program, where
        if _has_cache(device):
            return _built(cl._cl._Program(context, source), words), "built by a driver with a cache of its own"
        store = program_store.program_folder()
        kept = program_store.read_program(store, key)
        if kept is not None:
            try:
                return _built(cl._cl._Program(context, [device], [kept[""]]), words), _FROM_CACHE
            except (cl.Error, KeyError):  # this driver rejects it after all
                pass
        program = _built(cl._cl._Program(context, source), words)
        try:
            (binary,) = program.get_info(cl.program_info.BINARIES)
        except (cl.Error, ValueError):  # it gives none
            return program, _COMPILED
        program_store.write_program(store, key, {"": bytes(binary)})
        return program, _COMPILED


def _built(program: Any, options: bytes) -> Any:
    # pyopencl.Program.build is avoided: it adds its own -I and its own cache.
    with _in_plain_folder():
        program.build(options, None)
    return program


@contextmanager
def _in_plain_folder() -> Iterator[None]:
    """Changes the working folder while its name has a quote in it: Intel's compiler gets the name in quotes as a
    folder of files, and would take the rest of it for options."""
    try:
        folder = os.getcwd()
    except OSError:
        folder = ""
    if '"' not in folder:
        yield
        return
    here = os.open(".", os.O_RDONLY)
    try:
        os.chdir(os.sep)
        yield
    finally:
        os.fchdir(here)
        os.close(here)


def keep_programs(everything: bool = False) -> None:
    """Stores for later processes the compiled code of the programs built since the last call, or of all programs.
    This is also done at the end of the process."""
    if is_forked():  # the parent stores them, and its lock may never be released here
        return
    with _lock:
        pocl_programs.keep(everything)


atexit.register(keep_programs, everything=True)


def program_token(source: str, options: Sequence[str]) -> str:
    """A digest of a program, whatever device it is built for."""
    return hashlib.blake2b("\0".join((*options, source)).encode("utf-8", "surrogateescape"), digest_size=16).hexdigest()


def foreseen_program(file: str, options: Sequence[str]) -> dict[str, str]:
    """The program of a file in cl/ as ``children.BegunChild.build`` takes it. RenderError for a missing source."""
    kernels = kernel_folder()
    source = whole_source(kernels / file, (kernels,))
    return {"source": source, "options": " ".join(options), "token": program_token(source, options)}


def program_key(device: cl.Device, source: str, options: Sequence[str]) -> str:
    """A digest of everything that the compiled program depends on."""
    digest = hashlib.blake2b(digest_size=20)
    for text in (*_identity(device), *options, source):
        digest.update(text.encode("utf-8", errors="surrogateescape") + b"\0")
    return digest.hexdigest()


def _has_cache(device: cl.Device) -> bool:
    """Whether the driver has a reliable cache of its own."""
    return "NVIDIA" in device.platform.name.upper()


@cache
def _identity(device: cl.Device) -> tuple[str, ...]:
    platform = device.platform
    return (
        platform.name, platform.version, device.name, device.vendor, device.version,
        device.driver_version, str(device.vendor_id), str(device.address_bits),
        _processor() if device.type & cl.device_type.CPU else "",
    )  # fmt: skip


def _processor() -> str:
    """The features of this machine's processor: machines with other processors may share the home folder."""
    try:
        with open("/proc/cpuinfo", "rb") as file:
            lines = file.read(8192).decode("ascii", errors="replace").split("\n")
    except OSError:
        return ""
    wanted = ("model name", "flags", "Features", "CPU part", "isa")
    return "\n".join(line for line in lines[:60] if line.split("\t")[0].strip() in wanted)
