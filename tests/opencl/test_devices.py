"""Probing: what works is used, what does not is named, and nothing takes the program down."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from clvol.errors import DeviceError
from clvol.opencl import devices, probing
from clvol.opencl.children import Child
from clvol.opencl.devices import select
from clvol.opencl.icd import registered_icds
from clvol.opencl.probe import first_meaningful_line
from clvol.opencl.reports import DeviceReport, Icd
from clvol.opencl.runtime import loader_folder

_BROKEN = {
    # OpenCL libraries, as the loader calls them, that misbehave at the first call.
    "aborts": "#include <stdlib.h>\n"
              "void *clGetExtensionFunctionAddress(const char *n) { abort(); }\n"
              "int clIcdGetPlatformIDsKHR(unsigned n, void *p, unsigned *c) { abort(); }\n"
              "int clGetPlatformIDs(unsigned n, void *p, unsigned *c) { abort(); }\n",
    "hangs": "#include <unistd.h>\n"
             "void *clGetExtensionFunctionAddress(const char *n) { for (;;) sleep(60); }\n"
             "int clIcdGetPlatformIDsKHR(int n, void *p, int *c) { for (;;) sleep(60); }\n"
             "int clGetPlatformIDs(int n, void *p, int *c) { for (;;) sleep(60); }\n",
}

_LIST_AND_OPEN = """
import json, os, sys
from clvol.errors import DeviceError
from clvol.opencl import devices, probing
ran = []
run_child = probing.run_child
def counted(*arguments):
    ran.append(1)
    return run_child(*arguments)
probing.run_child = counted
result = {"reports": [r.__dict__ for r in devices.list_devices(time_limit=float(sys.argv[1]))]}
try:
    result["opened"] = devices.open_device().platform.name
except DeviceError as error:
    result["error"], result["status"] = str(error), error.exit_status
result["children"] = len(ran)
print(json.dumps(result))
"""


def run(cache: Path, vendors: Path | None, time_limit: float = 30.0, code: str = _LIST_AND_OPEN,
        **more: str) -> dict:
    """List the devices and open the default one in a process of its own."""
    unwanted = ("OCL_", "POCL_DEVICES", "PYOPENCL_HOME")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(unwanted)}
    environment.update(XDG_CACHE_HOME=str(cache), **more)
    if vendors is not None:
        environment["OCL_ICD_VENDORS"] = str(vendors)
    done = subprocess.run([sys.executable, "-c", code, str(time_limit)], env=environment,
                          capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture
def vendors(tmp_path: Path) -> Path:
    """A folder that, as the loader reads it, registers every platform of this machine."""
    icds = registered_icds()
    if not icds:
        pytest.skip("no OpenCL platform is registered on this machine")
    folder = tmp_path / "vendors"
    folder.mkdir()
    # The loader reads the folder inside pyopencl's wheel all the same.
    for icd in (i for i in icds if Path(i.path).parent != loader_folder()):
        (folder / Path(icd.path).name).write_text(icd.library + "\n")
    return folder


@pytest.fixture(scope="module")
def probed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """A cache folder after a first run on this machine's platforms, and that run's outcome."""
    if not registered_icds():
        pytest.skip("no OpenCL platform is registered on this machine")
    cache = tmp_path_factory.mktemp("probed")
    return cache, run(cache, None)


@pytest.fixture
def cached(probed: tuple[Path, dict], tmp_path: Path) -> tuple[Path, dict]:
    """The same, in a copy that a test may damage."""
    shutil.copytree(probed[0], tmp_path / "cached")
    return tmp_path / "cached", probed[1]


def add_broken(kind: str, folder: Path) -> None:
    """Register a library that misbehaves beside the good ones."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler to build a broken OpenCL library with")
    source = folder.parent / f"{kind}.c"
    source.write_text(_BROKEN[kind])
    library = folder.parent / f"lib{kind}.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-w", "-o", library, source], check=True)
    (folder / f"{kind}.icd").write_text(f"{library}\n")


def working(result: dict) -> list[str]:
    return [r["name"] for r in result["reports"] if r["working"]]


# --- the machine's own devices


def test_every_working_device_tells_what_it_is(each_device):
    report = devices.report_of(each_device)
    assert report is not None and report.working and report.reason == ""
    assert report.compute_units > 0 and report.max_buffer > 0
    assert report.global_memory >= report.max_buffer > 0
    assert report.fp64 == ("cl_khr_fp64" in report.extensions)


def test_a_device_is_found_again_by_its_name(each_device):
    report = devices.report_of(each_device)
    assert devices.open_device(report.name) == each_device
    assert devices.open_device(report.name.upper()) == each_device


def test_a_library_registered_twice_is_one_platform(tmp_path, vendors):
    once = working(run(tmp_path / "once", vendors))
    for number, icd in enumerate(registered_icds(str(vendors))):
        (vendors / f"again{number}.icd").write_text(f"{icd.library}\n")
    assert working(run(tmp_path / "twice", vendors)) == once


def test_two_devices_of_one_platform_are_numbered(tmp_path, vendors):
    result = run(tmp_path / "cache", vendors, POCL_DEVICES="pthread pthread")
    if "pocl" not in working(result):
        pytest.skip("PoCL is not installed or does not work")
    assert {"pocl", "pocl:1"} <= set(working(result))


# --- broken platforms


@pytest.mark.slow
@pytest.mark.parametrize("kind, limit, reason", [
    ("aborts", 30.0, "SIGABRT"), ("hangs", 5.0, "no answer within 5 s")])
def test_a_platform_that_breaks_is_left_out_and_named(tmp_path, vendors, kind, limit, reason):
    good = working(run(tmp_path / "good", vendors))
    add_broken(kind, vendors)
    result = run(tmp_path / "cache", vendors, limit)
    assert working(result) == good
    broken = next(r for r in result["reports"] if r["name"] == kind)
    assert reason in broken["reason"] and "\n" not in broken["reason"]
    assert "opened" in result
    # The next process knows already: no child, and the broken library is not loaded there either.
    again = run(tmp_path / "cache", vendors, limit)
    assert again["children"] == 0 and again["opened"] == result["opened"]


def test_only_a_broken_platform_is_a_device_error(tmp_path):
    folder = tmp_path / "vendors"
    folder.mkdir()
    add_broken("aborts", folder)
    result = run(tmp_path / "cache", folder / "aborts.icd")
    assert result["status"] == 3
    assert "aborts: crashed (SIGABRT)" in result["error"]
    assert "pocl-opencl-icd" in result["error"] and 'pip install "clvol[cpu]"' in result["error"]


@pytest.mark.slow
def test_a_registered_library_that_is_missing_is_named(tmp_path, vendors):
    good = working(run(tmp_path / "good", vendors))
    (vendors / "gone.icd").write_text(f"{tmp_path}/libgone.so\n")
    result = run(tmp_path / "cache", vendors)
    assert working(result) == good
    gone = next(r for r in result["reports"] if r["name"] == "gone")
    assert "cannot be loaded" in gone["reason"] and "libgone.so" in gone["reason"]


def test_no_platform_at_all_says_how_to_get_one(tmp_path):
    result = run(tmp_path / "cache", tmp_path / "none.icd")
    assert result["reports"] == [] and result["status"] == 3
    assert "no platform found" in result["error"] and "pocl-opencl-icd" in result["error"]


def children(*scripts: list[dict] | tuple[list[dict], str]):
    """A stand-in for the probe's child processes: each call plays the next script."""
    remaining = list(scripts)

    def play(request, selection, time_limit):
        script = remaining.pop(0)
        events, death = script if isinstance(script, tuple) else (script, "")
        return Child(events, death)

    return play


def listed(p: int, d: int) -> dict:
    return {"event": "device", "platform_index": p, "device_index": d,
            "platform": "Intel(R) OpenCL", "device": f"device {p}.{d}", "type": "CPU"}


START = [{"event": "started"}, {"event": "platforms", "count": 1}]
WORKS = {"event": "tested", "working": True, "reason": ""}
END = [{"event": "listed"}, {"event": "done"}]


def test_a_device_that_kills_its_probe_does_not_hide_the_next(monkeypatch):
    monkeypatch.setattr(probing, "run_child", children(
        (START + [listed(0, 0), WORKS, listed(0, 1)], "crashed (SIGSEGV)"),
        START + [listed(0, 2), WORKS] + END,
    ))
    found = probing.probe([Icd("a.icd", "liba.so")], True, 1.0)
    assert [(r.name, r.working, r.reason) for r in found.reports] == [
        ("intel", True, ""), ("intel:1", False, "crashed (SIGSEGV)"), ("intel:2", True, "")]
    assert found.selection is None


def test_platforms_that_only_crash_together_are_separated(monkeypatch):
    monkeypatch.setattr(probing, "run_child", children(
        (START[:1], "crashed (SIGABRT)"),  # both
        START + END,  # the first alone
        (START[:1], "crashed (SIGABRT)"),  # the second beside it
        START + [listed(0, 0), WORKS] + END,  # what is left
    ))
    icds = [Icd("one.icd", "libone.so"), Icd("two.icd", "libtwo.so")]
    found = probing.probe(icds, True, 1.0)
    assert found.selection == icds[:1]
    assert [(r.name, r.working) for r in found.reports] == [("intel", True), ("two", False)]


# --- the cache


def test_a_second_process_does_not_probe(cached):
    cache, first = cached
    second = run(cache, None)
    assert first["children"] > 0 and second["children"] == 0
    assert first["reports"] == second["reports"] and first["opened"] == second["opened"]


def test_a_new_platform_is_probed(cached, vendors):
    (vendors / "new.icd").write_text("libnone.so\n")
    result = run(cached[0], vendors)
    assert result["children"] > 0 and "new" in [r["name"] for r in result["reports"]]


@pytest.mark.parametrize("content", [
    "", "not json", "[]", "{}", '{"key": 1, "reports": [{}], "selection": null}'])
def test_a_damaged_cache_is_ignored(cached, content):
    cache, first = cached
    (file,) = cache.glob("clvol/devices-*.json")
    file.write_text(content)
    again = run(cache, None)
    assert again["children"] > 0 and lasting(again["reports"]) == lasting(first["reports"])


def lasting(reports):
    """Without what a driver reckons from the memory that happens to be free."""
    return [{k: v for k, v in r.items() if k not in ("global_memory", "max_buffer")} for r in reports]


def test_a_cache_folder_that_cannot_be_made_is_no_error(tmp_path, vendors):
    (tmp_path / "cache").write_text("a file where the folder should be")
    add_broken("aborts", vendors)  # so that a folder of chosen platforms is wanted as well
    assert "opened" in run(tmp_path / "cache", vendors)


@pytest.mark.parametrize("stale", [
    {"device_index": 7}, {"driver": "of yesterday"}, {"platform": "of yesterday"}])
def test_a_cached_device_that_is_gone_is_probed_again(cached, stale):
    cache, first = cached
    (file,) = cache.glob("clvol/devices-*.json")
    content = json.loads(file.read_text())
    content["reports"] = [{**r, **stale} for r in content["reports"]]
    file.write_text(json.dumps(content))
    again = run(cache, None)
    assert again["children"] > 0 and again["opened"] == first["opened"]


def test_fresh_probes_whatever_the_cache_says(cached):
    code = _LIST_AND_OPEN.replace("list_devices(", "list_devices(fresh=True, ")
    assert run(cached[0], None, code=code)["children"] > 0


# --- choosing

POCL = DeviceReport("pocl", "Portable Computing Language", "pthread-x", type="CPU", working=True,
                    device_index=0)
INTEL = DeviceReport("intel", "Intel(R) OpenCL", "Xeon", type="CPU", working=True, device_index=0)
NVIDIA = DeviceReport("nvidia", "NVIDIA CUDA", "NVIDIA H200", type="GPU", working=True,
                      device_index=0)
SECOND = replace(NVIDIA, name="nvidia:1", device_index=1)
ALL = [NVIDIA, SECOND, INTEL, POCL]


def test_pocl_then_other_cpus_then_gpus():
    assert select(ALL) == [POCL, INTEL, NVIDIA, SECOND]
    assert select([NVIDIA, INTEL])[0] == INTEL


@pytest.mark.parametrize("name, expected", [
    ("pocl", POCL), ("POCL", POCL), ("nvidia", NVIDIA), ("nvidia:0", NVIDIA), ("nvidia:1", SECOND),
    ("h200", NVIDIA), ("gpu", NVIDIA), ("xeon", INTEL), ("portable", POCL), (" intel ", INTEL),
])
def test_a_name_or_a_part_of_one_in_any_case(name, expected):
    assert select(ALL, name)[0] == expected


@pytest.mark.parametrize("name", ["", "  ", "nonesuch", "nvidia:2"])
def test_an_unknown_name_is_refused_with_the_known_ones(name):
    with pytest.raises(DeviceError, match="pocl, intel, nvidia, nvidia:1") as raised:
        select(ALL, name)
    assert raised.value.exit_status == 3


def test_a_broken_device_asked_for_says_why_it_is_broken():
    broken = replace(NVIDIA, working=False, reason="out of memory")
    with pytest.raises(DeviceError, match="does not work: out of memory"):
        select([broken, POCL], "nvidia")
    assert select([broken, POCL], "cpu") == [POCL]


def test_nothing_working_names_each_reason():
    with pytest.raises(DeviceError, match="nvidia: no driver; pocl: no linker.*pocl-opencl-icd"):
        select([replace(NVIDIA, working=False, reason="no driver"),
                replace(POCL, working=False, reason="no linker")])


# --- small things


@pytest.mark.parametrize("log, line", [
    ("", ""),
    ("\n  \n", ""),
    ("Build on <pyopencl.Device 'x'>:\n\nerror: unknown target CPU 'generic'\nDevice x failed",
     "error: unknown target CPU 'generic'"),
    ("clBuildProgram failed: BUILD_PROGRAM_FAILURE - clBuildProgram failed\n1 error generated.\n"
     "warning: odd\na.cl:3:1: error: use of undeclared identifier 'x'",
     "a.cl:3:1: error: use of undeclared identifier 'x'"),
    ("\x1b[31mjust words\x1b[0m", "just words"),
])
def test_the_meaningful_line_of_a_log(log, line):
    assert first_meaningful_line(log) == line


def test_no_opencl_at_import():
    code = ("import sys, clvol, clvol.opencl.devices, clvol.opencl.runtime\n"
            "sys.exit('pyopencl' in sys.modules)")
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@pytest.mark.parametrize("said", ["POCL_AFFINITY", "POCL_MAX_PTHREAD_COUNT"])
def test_threads_are_pinned_unless_something_was_said(monkeypatch, said):

    monkeypatch.delenv("POCL_MAX_PTHREAD_COUNT", raising=False)
    monkeypatch.setenv("POCL_AFFINITY", "x")
    monkeypatch.delenv("POCL_AFFINITY")
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(os.cpu_count())))
    devices.pin_threads()
    assert os.environ["POCL_AFFINITY"] == "1"
    monkeypatch.delenv("POCL_AFFINITY")
    monkeypatch.setenv(said, "0")
    devices.pin_threads()
    assert os.environ.get("POCL_AFFINITY") in (None, "0")
    monkeypatch.delenv(said)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0} if os.cpu_count() > 1 else set())
    devices.pin_threads()
    assert "POCL_AFFINITY" not in os.environ


def test_one_device_per_processor_the_fastest_as_far_as_is_known():
    from clvol.opencl.devices import one_per_processor
    from clvol.opencl.reports import DeviceReport

    def cpu(name: str, platform: str, speed: float) -> DeviceReport:
        return DeviceReport(name, platform, "cpu", working=True, type="CPU", speed=speed)

    gpus = [DeviceReport(f"gpu:{k}", "GPUs", "gpu", working=True, type="GPU", device_index=k) for k in range(2)]
    broken = DeviceReport("broken", "Broken", "gpu", type="GPU")
    for pocl, intel, expected in ((1e8, 2e8, "intel"), (2e8, 1e8, "pocl"), (0.0, 2e8, "pocl")):
        reports = [cpu("intel", "Intel(R) OpenCL", intel), cpu("pocl", "Portable Computing Language", pocl)]
        found = one_per_processor([*reports, broken, *gpus])
        assert [report.name for report in found] == [expected, "gpu:0", "gpu:1"]


def test_speeds_are_kept_with_the_probe(monkeypatch, tmp_path, device):
    from clvol.opencl import devices

    name = devices.report_of(device).name
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(devices, "_found", devices._found)
    devices.keep_speeds({name: 1.5e8})
    monkeypatch.setattr(devices, "_found", None)
    assert next(r for r in devices.list_devices() if r.name == name).speed == 1.5e8
