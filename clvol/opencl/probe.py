"""The child process that tries OpenCL platforms, so that a broken one cannot take the host down.

Run as a file by :mod:`clvol.opencl.devices` with a JSON request as its only
argument; answers one JSON object a line on what was standard output when it started::

    {"event": "started"}                        pyopencl is imported, no OpenCL call made yet
    {"event": "platforms", "count": 2}          the loader has listed the platforms
    {"event": "device", "platform_index": ...}  a device's properties; its test begins now
    {"event": "tested", "working": true, ...}   the outcome for the device named last
    {"event": "listed"}                         nothing is left to test
    {"event": "built", "token": ..., "place": ...}   PoCL has a program, in this folder of its cache
    {"event": "icd", "path": ..., "error": ...} a registered library that cannot be loaded
    {"event": "done"}

Whoever reads knows from the last line what was being tried when the child died or stopped
answering. The file imports nothing of clvol: it must start quickly, whatever the parent's state.
"""

from __future__ import annotations

import json
import os
import re
import sys

_PROPERTIES = {  # report's name -> pyopencl's
    "device": "name",
    "vendor": "vendor",
    "version": "version",
    "opencl_c": "opencl_c_version",
    "driver": "driver_version",
    "compute_units": "max_compute_units",
    "global_memory": "global_mem_size",
    "max_buffer": "max_mem_alloc_size",
    "local_memory": "local_mem_size",
    "max_work_group": "max_work_group_size",
    "extensions": "extensions",
}
_GROUPS = 4
_GROUP_SIZE = 16
_VOXELS = 211
_SCALE = 0.25


def first_meaningful_line(text: str) -> str:
    """The line of a compiler log or of stderr that says what is wrong, without colour codes.

    The first that speaks of an error or a failure, else the first that is not blank, at most 200
    characters; "" for a blank text.
    """
    plain = re.sub(r"\x1b\[[0-9;]*m", "", text).replace("\x00", "")
    lines = [" ".join(line.split()) for line in plain.splitlines()]
    # pyopencl's and the drivers' own headings say nothing; the compiler's words come after them.
    noise = re.compile(r"^(-+|=+|build on <.*|\(?options: .*|\(?source saved as .*|"
                       r".*BUILD_PROGRAM_FAILURE.*|traceback .*|"
                       r"compilation (started|failed|done).*|"
                       r"\d+ (error|warning)s? generated\.?)$", re.IGNORECASE)
    lines = [line for line in lines if line and not noise.match(line)]
    wrong = re.compile(r"\b(error|fatal|fail(ed|ure)?|unknown|abort(ed)?|assert(ion)?|cannot)\b",
                       re.IGNORECASE)
    line = next((line for line in lines if wrong.search(line)), lines[0] if lines else "")
    return line if len(line) <= 200 else line[:199] + "…"


def describe(device) -> dict:
    """The device's properties as plain JSON types; what the driver refuses to tell is left out."""
    import pyopencl as cl

    properties: dict = {}
    for name, key in _PROPERTIES.items():
        try:
            value = getattr(device, key)
        except cl.Error:
            continue
        properties[name] = " ".join(value.split()) if isinstance(value, str) else int(value)
    properties["extensions"] = sorted(properties.get("extensions", "").split())
    properties["fp64"] = bool({"cl_khr_fp64", "cl_amd_fp64"} & set(properties["extensions"]))
    kinds = cl.device_type
    named = (("CPU", kinds.CPU), ("GPU", kinds.GPU), ("accelerator", kinds.ACCELERATOR))
    properties["type"] = next((n for n, bit in named if device.type & bit), "other")
    return properties


def try_device(device, source: str, salt: str):
    """Compile and run the probe kernel and check every number; returns its context. Raises on any failure.

    ``salt`` is part of the build options, so that no cache can hide a compiler that does not work.
    """
    import numpy as np
    import pyopencl as cl

    fp64 = bool({"cl_khr_fp64", "cl_amd_fp64"} & set(device.extensions.split()))
    real = np.float64 if fp64 else np.float32
    size = min(_GROUP_SIZE, device.max_work_group_size)
    count = _GROUPS * size
    voxels = (np.arange(_VOXELS) * 37 % 256).astype(np.uint8)

    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    options = ["-cl-std=CL1.2", f"-DCLVOL_PROBE_SALT={salt}"] + ["-DCLVOL_PROBE_FP64"] * fp64
    program = cl.Program(context, source).build(options)
    kernel = cl.Kernel(program, "probe")
    flags = cl.mem_flags
    voxels_buffer = cl.Buffer(context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=voxels)
    outputs = [np.empty(count, t) for t in (np.float32, np.int32, real)]
    buffers = [cl.Buffer(context, flags.WRITE_ONLY, o.nbytes) for o in outputs]
    # pyopencl accepts LocalMemory as an argument, but its types do not say so.
    kernel(queue, (count,), (size,), voxels_buffer, np.int32(_VOXELS), np.float32(_SCALE),
           *buffers, cl.LocalMemory(4 * size))  # type: ignore[arg-type]
    for output, buffer in zip(outputs, buffers):
        cl.enqueue_copy(queue, output, buffer)
    queue.finish()

    i = np.arange(count)
    samples = voxels[(i[:, None] * 7 + np.arange(8) * 13) % _VOXELS].astype(np.float64)
    expected = (
        np.where(samples >= 128.0, samples * _SCALE, 0.0).sum(axis=1),
        i // size * size + (i % size + size - 1) % size,
        1.0 / (i + 1.0),
    )
    for what, got, right in zip(("float", "local memory", "division"), outputs, expected):
        # OpenCL allows a float division 2.5 ULP; the sums of multiples of 1/4 are exact.
        if not np.allclose(got, right, rtol=4 * float(np.finfo(np.float32).eps), atol=0.0):
            raise ArithmeticError(f"the probe kernel computes wrongly ({what})")
    return context


def failure_line(error: BaseException) -> str:
    """One line that says why a device failed."""
    line = first_meaningful_line(str(error))
    name = type(error).__name__
    return line or name


def is_pocl(platform) -> bool:
    return platform.name == "Portable Computing Language"


def build_programs(context, answer) -> None:
    """Builds the programs that standard input names until it ends, each a line of JSON."""
    import pyopencl as cl

    folder = os.environ["POCL_CACHE_DIR"]
    known = places_in(folder)
    for line in sys.stdin:
        program = json.loads(line)
        try:
            cl._cl._Program(context, program["source"]).build(program["options"].encode(), None)
        except Exception:  # whoever needs it meets the error
            continue
        new = places_in(folder) - known
        known |= new
        if len(new) == 1:
            answer({"event": "built", "token": program["token"], "place": new.pop()})


def places_in(folder: str) -> set:
    """The folders of programs in PoCL's cache."""
    return {f"{a.name}/{b.name}" for a in os.scandir(folder) if a.is_dir() for b in os.scandir(a.path) if b.is_dir()}


def main(request: dict, answer) -> None:
    """Do what ``request`` asks; ``answer(dict)`` sends one event."""
    import pyopencl as cl

    if request["only_vendors_folder"]:
        # pyopencl's loader reads the .icd files in the wheel as well, unless told of another place.
        os.environ["PYOPENCL_HOME"] = os.environ["OCL_ICD_VENDORS"]
    answer({"event": "started"})
    try:
        platforms = cl.get_platforms()
    except cl.LogicError as error:  # CL_PLATFORM_NOT_FOUND_KHR: the loader works and finds none
        if "PLATFORM_NOT_FOUND" not in str(error):
            raise
        platforms = []
    answer({"event": "platforms", "count": len(platforms)})
    skip = {tuple(pair) for pair in request.get("skip", ())}
    if not request["enumerate_only"]:
        with open(request["kernel"], encoding="utf-8") as file:
            source = file.read()
    pocl = None  # the context of its device, once that works
    # PoCL first: where its device is enough, the others need not be tried.
    for p, platform in sorted(enumerate(platforms), key=lambda pair: not is_pocl(pair[1])):
        common = {"event": "device", "platform_index": p, "device_index": -1,
                  "platform": platform.name, "platform_version": platform.version}
        try:
            devices = platform.get_devices()
        except cl.Error as error:
            devices, why = [], failure_line(error)
        else:
            why = "the platform has no device"
        if not devices and (p, -1) not in skip:
            answer(common)
            answer({"event": "tested", "working": False, "reason": why})
        if request["enumerate_only"]:
            continue
        for d, device in enumerate(devices):
            if (p, d) in skip:
                continue
            described = describe(device)
            answer({**common, "device_index": d, **described})
            if pocl is not None and request.get("pocl_is_enough"):
                answer({"event": "tested", "working": False, "reason": "not tried yet", "left_out": True})
                continue
            try:
                context = try_device(device, source, request["salt"])
            except Exception as error:
                answer({"event": "tested", "working": False, "reason": failure_line(error)})
            else:
                answer({"event": "tested", "working": True, "reason": ""})
                if pocl is None and is_pocl(platform) and described["type"] == "CPU":
                    pocl = context
    answer({"event": "listed"})
    if pocl is not None and request.get("serves"):
        build_programs(pocl, answer)
    # Last, because opening a stranger's library may do anything: which ones cannot even be loaded.
    import ctypes

    for path, library in request.get("libraries", ()):
        try:
            ctypes.CDLL(library)
        except OSError as error:
            answer({"event": "icd", "path": path, "error": first_meaningful_line(str(error))})
    answer({"event": "done"})


if __name__ == "__main__":
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # a crash here is an answer, not a dump
    except (ImportError, OSError, ValueError):
        pass
    # Drivers print: keep our answers apart from whatever they write to standard output.
    stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def send(event: dict) -> None:
        stream.write(json.dumps(event) + "\n")
        stream.flush()

    main(json.loads(sys.argv[1]), send)
    # Not os._exit: whoever reads sees from the exit status whether the libraries let a process end.
    stream.close()
