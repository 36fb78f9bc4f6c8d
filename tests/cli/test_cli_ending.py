"""The command ends with its own status, whatever OpenCL libraries do at the end of a process."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT

_LIBRARY = """
#include <signal.h>
#include <stdio.h>
#include <unistd.h>
{destructor}
void *clGetExtensionFunctionAddress(const char *name) {{ return 0; }}
int clIcdGetPlatformIDsKHR(unsigned n, void **p, unsigned *count) {{ if (count) *count = 0; return -1001; }}
int clGetPlatformIDs(unsigned n, void **p, unsigned *count) {{ if (count) *count = 0; return -1001; }}
"""
_AT_END = "__attribute__((destructor)) static void at_end(void) {{ {0} }}"
DESTRUCTORS = {
    "crashes": "raise(SIGSEGV);",
    "hangs": "for (;;) sleep(60);",
    "prints": 'puts("bye"); fflush(stdout);',
    "exits": "_exit(3);",
}


@pytest.fixture
def library(tmp_path):
    """Builds an OpenCL library without devices whose destructor does what is asked."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler to build a broken OpenCL library with")

    def build(what: str) -> Path:
        source = tmp_path / f"{what}.c"
        source.write_text(_LIBRARY.format(destructor=_AT_END.format(DESTRUCTORS[what])))
        path = tmp_path / f"lib{what}.so"
        subprocess.run([compiler, "-shared", "-fPIC", "-o", path, source], check=True)
        return path

    return build


@pytest.mark.parametrize("what", DESTRUCTORS)
def test_a_library_in_the_process_does_not_change_how_it_ends(tmp_path, library, what, device):
    """Loaded beside the device's own, whoever loaded it."""
    from clvol.opencl.devices import report_of

    code = ("import ctypes, sys; ctypes.CDLL(sys.argv.pop(1)); "
            "from clvol.cli.ending import command_line; command_line()")
    render = ["render", ROOT / "data/brainsmall.nrrd", "-o", "a.npy", "--set", "image.width=16",
              "--set", "image.height=16", "--quiet", "--device", report_of(device).name]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code, library(what), *render], cwd=tmp_path,
                          env=environment, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr) == (0, "a.npy\n", "")
    assert np.load(tmp_path / "a.npy").shape == (16, 16, 4)
    # An error's status stays, too, where OpenCL was used.
    small = ["--set", 'integration.method="multiresolution"', "--set", 'multiresolution.memory="99 KiB"']
    done = subprocess.run([sys.executable, "-c", code, library(what), *render, *small],
                          cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2 and "multiresolution.memory" in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("what", ["crashes", "hangs"])
def test_a_platform_without_devices_that_spoils_the_end_is_left_out(tmp_path, library, what):
    """Of a program of the user's own, which ends as any Python program does."""
    from clvol.opencl.icd import registered_icds
    from clvol.opencl.runtime import loader_folder

    vendors = tmp_path / "vendors"
    vendors.mkdir()
    icds = [icd for icd in registered_icds() if Path(icd.path).parent != loader_folder()]
    for icd in icds:
        (vendors / Path(icd.path).name).write_text(f"{icd.library}\n")
    (vendors / f"{what}.icd").write_text(f"{library(what)}\n")
    code = ("import numpy as np, clvol\n"
            "from clvol.opencl.devices import list_devices\n"
            "for report in list_devices(): print(report.name, report.working, report.reason)\n"
            "volume = clvol.Volume(np.zeros((4, 4, 4), np.uint8))\n"
            "with clvol.Renderer(clvol.Scene(volume=volume, image={'width': 8, 'height': 8})) as renderer:\n"
            "    renderer.render()\n")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OCL_ICD_VENDORS": str(vendors),
                   "XDG_CACHE_HOME": str(tmp_path / "cache")}
    for _ in range(2):  # probed, and from the cache
        done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment,
                              capture_output=True, text=True, timeout=300)
        if "no device works" in done.stderr:
            pytest.skip("no OpenCL device works on this machine")
        assert done.returncode == 0, (done.returncode, done.stdout, done.stderr)
        assert f"{what} False it has no device" in done.stdout


def test_what_is_to_be_done_at_the_end_is_done(tmp_path):
    """Python's own hooks run, output is flushed, and the status is the one given."""
    code = ("import atexit, sys, pyopencl\n"
            "from clvol.cli.ending import leave\n"
            "atexit.register(lambda: print('hook', flush=False))\n"
            "sys.stdout.write('text without a newline ')\n"
            "leave(7)\n")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)},
                          capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr) == (7, "text without a newline hook\n", "")


def test_without_opencl_the_process_ends_as_any_other():
    code = ("import sys, os; from clvol.cli.ending import leave\n"
            "os._exit = lambda status: print('not so')\n"
            "leave(5)\n")
    done = subprocess.run([sys.executable, "-c", code], env={**os.environ, "PYTHONPATH": str(ROOT)},
                          capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (5, "")
