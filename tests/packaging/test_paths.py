"""A checkout in any folder: set-up, make and rendering, whatever signs its path has."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from helpers.paths import ROOT

# What shells, make, pip, the OpenCL loader and compilers take for something else, but a colon, which
# no virtual environment can have in its path.
NAMES = {
    "blank": "a folder with blanks",
    "signs": "-I (q'\"uote) $HOME `id` %d # ; & \\ $(x) é",
}


def copy_of_checkout(folder: Path) -> Path:
    folder.mkdir()
    for name in ("setup.cfg", "pyproject.toml", "LICENSE", "README.md", "Makefile"):
        shutil.copy(ROOT / name, folder)
    for name in ("clvol", "cl", ".ci"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "data", folder / "data")
    return folder


def environment(tmp_path: Path, **more: str) -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "OCL_", "POCL_", "MAKE"))}
    return {**kept, "XDG_CACHE_HOME": str(tmp_path / "cache"), **more}


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMES)
def test_make_sets_up_and_renders_in_a_folder_of_any_name(tmp_path, kind, device):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    folder = copy_of_checkout(tmp_path / NAMES[kind])
    # An environment that borrows this one's libraries: nothing is fetched.
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / ".venv"], check=True)
    site = next((folder / ".venv" / "lib").glob("python*/site-packages"))
    libraries = dict.fromkeys((sysconfig.get_path("purelib"), sysconfig.get_path("platlib")))
    (site / "borrowed.pth").write_text("".join(f"{path}\n" for path in libraries))
    pip = {"PIP_NO_INDEX": "1", "PIP_NO_DEPS": "1", "PIP_NO_BUILD_ISOLATION": "0"}
    done = subprocess.run(["make", "-C", folder, "render"], env=environment(tmp_path, **pip),
                          capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    pictures = [str(folder / "out" / f"demo.{ending}") for ending in ("exr", "png")]
    # The command names what it wrote, and then make does; make itself tells of folders that it enters.
    assert [line for line in done.stdout.splitlines() if not line.startswith("make")][-2:] == pictures
    assert all(os.path.getsize(picture) for picture in pictures)
    # The command works from elsewhere, too; the script that pip makes of it knows of blanks alone.
    python = folder / ".venv/bin/python"
    command = [folder / ".venv/bin/clvol"] if kind == "blank" else [python, "-m", "clvol"]
    done = subprocess.run([*command, "--version"], cwd=tmp_path,
                          env=environment(tmp_path), capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("clvol "), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", [NAMES["blank"], "C: $x\" -DX=1 '\nwith a second line"])
def test_every_device_renders_from_sources_in_and_a_working_folder_of_any_name(tmp_path, name, device):
    from clvol.opencl.devices import report_of

    folder = tmp_path / name
    folder.mkdir()
    for package in ("clvol", "cl"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    code = ("import sys; sys.path.insert(0, sys.argv.pop(1)); from clvol.cli import main; "
            "import clvol; assert clvol.__file__.startswith(sys.path[0]); sys.exit(main())")
    done = subprocess.run(
        [sys.executable, "-c", code, folder, "render", ROOT / "data/brainsmall.nrrd", "-o", "a.npy",
         "--set", "image.width=16", "--set", "image.height=16", "--quiet", "--device", report_of(device).name],
        cwd=folder, env=environment(tmp_path), capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert (folder / "a.npy").stat().st_size > 0
