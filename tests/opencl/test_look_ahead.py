"""Looking for devices while a scene is loaded, and building programs meanwhile: what is done, and what is left."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from clvol.opencl.icd import registered_icds

_AHEAD = """
import json, os
from clvol.opencl import build, children, devices, probing
begun = []
class Counted(children.BegunChild):
    def __init__(self, *arguments):
        begun.append(arguments[0].get("serves", False))
        super().__init__(*arguments)
probing.BegunChild = children.BegunChild = Counted
devices.look_ahead()
devices.look_ahead()
assert devices.is_looking_ahead()
programs = [build.foreseen_program("repeat_last.cl", ["-cl-std=CL1.2", "-DVOXEL_BITS=8"]),
            {"source": "no program", "options": "", "token": "none"}]
devices.build_ahead(programs)
device = devices.open_device()
said = []
build._log.info = lambda text, *values: said.append(text % values)
from clvol.opencl.context import DeviceContext
context = DeviceContext(device)
build.build_file(context.context, "repeat_last.cl", ["-cl-std=CL1.2", "-DVOXEL_BITS=8"])
context.release()
complete, known = devices._found.complete, len(devices._found.reports)
reports = devices.list_devices()
print(json.dumps({"platform": device.platform.name, "begun": begun, "said": said, "complete": complete,
                  "devices": [known, len(reports)], "untried": [r.reason for r in reports if "tried" in r.reason]}))
"""


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """That of a process on a machine where clvol has never run."""
    if not registered_icds():
        pytest.skip("no OpenCL platform is registered on this machine")
    unwanted = ("OCL_", "POCL_", "PYOPENCL_HOME")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(unwanted)}
    (tmp_path / "temporary").mkdir()
    return kept | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path / "temporary")}


def run(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, timeout=300, check=False
    )


def test_one_process_looks_for_devices_and_builds_programs(environment, tmp_path):
    done = run(environment, "-c", _AHEAD)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    if found["platform"] != "Portable Computing Language":
        pytest.skip("PoCL's device does not work on this machine")
    assert "built while devices were looked for" in found["said"][0]
    assert found["begun"] == [True] + [False] * (not found["complete"])  # the rest is tried once it is asked for
    assert found["devices"][0] == found["devices"][1] and not found["untried"]
    assert len(list((tmp_path / "cache" / "clvol" / "programs").iterdir())) == 1  # kept as if this process had built it
    assert not list((tmp_path / "temporary").iterdir())


def test_nothing_is_left_of_a_process_that_nobody_waits_for(environment, tmp_path):
    code = "from clvol.opencl import devices; devices.look_ahead(); print(devices._begun._process.pid)"
    done = run(environment, "-c", code)
    assert done.returncode == 0, done.stderr
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout), 0)
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.slow  # looks for devices twice
def test_a_device_with_another_name_is_found_although_it_was_not_tried(environment):
    code = """
import sys
from clvol.opencl import devices
devices.open_device()
others = [r.name for r in devices._found.reports if r.reason == "not tried yet"]
print(*[devices.open_device(name).platform.name for name in others[:1]], sep="\\n")
"""
    done = run(environment, "-c", code)
    assert done.returncode == 0, done.stderr
    if not done.stdout.strip():
        pytest.skip("this machine has no device beside PoCL's")
    assert done.stdout.strip() != "Portable Computing Language"
