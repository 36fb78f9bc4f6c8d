"""Machines on which a picture must come out all the same: each a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT

pytestmark = pytest.mark.slow  # each test starts several processes

RAMP = ("--set", 'transfer_function.preset="grayscale"')  # nothing is chosen from the voxels, nor said
UNSET = ("OCL_", "POCL_", "PYOPENCL", "XDG_", "TMP", "TEMP")


def run(*arguments: object, cwd: Path, prefix: tuple = (), **environment: str | None) -> subprocess.CompletedProcess:
    kept = {k: v for k, v in os.environ.items() if not k.startswith(UNSET)}
    kept |= {"PYTHONPATH": str(ROOT)} | environment
    kept = {k: str(v) for k, v in kept.items() if v is not None}
    command = [*prefix, sys.executable, "-m", "clvol", *arguments]
    return subprocess.run([str(c) for c in command], cwd=cwd, env=kept, capture_output=True, text=True, timeout=300)


def render(cwd: Path, *more: object, **how) -> tuple[np.ndarray, str]:
    """The picture and what was said on stderr; the command has to succeed."""
    (cwd / "a.npy").unlink(missing_ok=True)
    done = run("render", ROOT / "data/brainsmall.nrrd", "-o", "a.npy", *RAMP, "--set", "image.width=16",
               "--set", "image.height=16", *more, cwd=cwd, **how)
    assert done.returncode == 0, (done.returncode, done.stdout, done.stderr)
    return np.load(cwd / "a.npy"), done.stderr


@pytest.fixture(scope="module")
def usual(tmp_path_factory) -> tuple[Path, np.ndarray]:
    """A cache folder after a render, and the picture; nothing was to be said."""
    folder = tmp_path_factory.mktemp("usual")
    picture, said = render(folder, XDG_CACHE_HOME=folder / "cache")
    assert said == "" and picture[..., 3].max() > 0
    return folder / "cache", picture


@pytest.fixture
def cached(usual, tmp_path) -> tuple[Path, np.ndarray]:
    """The same, in a copy that a test may damage."""
    shutil.copytree(usual[0], tmp_path / "cache")
    return tmp_path / "cache", usual[1]


def warnings(said: str) -> list[str]:
    lines = said.splitlines()
    assert all(line.startswith("clvol: warning: ") for line in lines), said
    return lines


def files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


@pytest.mark.parametrize("damage", ["garbled", "cut"])
def test_a_damaged_cache_costs_time_and_one_warning(cached, tmp_path, damage, device):
    cache, picture = cached
    assert len(files(cache)) >= 2  # what is known of devices, and a program
    for path in files(cache):
        content = path.read_bytes()
        if damage == "garbled":
            path.write_bytes(os.urandom(len(content)))
        else:
            path.write_bytes(content[: len(content) // 2])
    again, said = render(tmp_path, XDG_CACHE_HOME=cache)
    assert np.array_equal(again, picture)
    (line,) = warnings(said)
    assert "damaged" in line and str(cache) in line
    again, said = render(tmp_path, XDG_CACHE_HOME=cache)  # mended
    assert np.array_equal(again, picture) and said == ""


def test_a_damaged_cache_of_pocl_harms_nobody(tmp_path, usual, device):
    """PoCL aborts the process on it; whatever lies where PoCL would look, or is told to look."""
    for home in (tmp_path / "pocl" / "kcache", tmp_path / "named"):
        for number in range(3):
            (home / "AB" / f"CD{number}").mkdir(parents=True)
            (home / "AB" / f"CD{number}" / "program.bc").write_bytes(b"garbage")
    for variables in ({}, {"POCL_CACHE_DIR": tmp_path / "named"}):
        picture, _ = render(tmp_path, XDG_CACHE_HOME=tmp_path, **variables)
        assert np.array_equal(picture, usual[1])
    # Where programs are to be kept was said.
    kept = files(tmp_path / "named" / "clvol")
    if device.platform.name == "Portable Computing Language":
        assert kept
        for path in kept:
            path.write_bytes(path.read_bytes()[:-1])
        picture, said = render(tmp_path, XDG_CACHE_HOME=tmp_path, POCL_CACHE_DIR=tmp_path / "named")
        assert np.array_equal(picture, usual[1])
        assert "damaged" in warnings(said)[0] and "named" in said


@pytest.mark.parametrize("first", ["", "import pyopencl; "])
def test_pyopencl_s_own_caches_are_not_used(cached, tmp_path, first, each_device):
    """Whoever imported it first: it fails where they cannot be written, are damaged, or locked."""
    from clvol.opencl.devices import report_of

    cache, picture = cached
    for name in ("pytools", "pyopencl"):
        (cache / name).write_text("a file where the folder should be")
    code = f"{first}import sys; from clvol.cli import main; sys.exit(main())"
    kept = {k: v for k, v in os.environ.items() if not k.startswith(UNSET)}
    kept |= {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(cache)}
    done = subprocess.run([sys.executable, "-c", code, "render", ROOT / "data/brainsmall.nrrd", "-o", "a.npy",
                           *RAMP, "--set", "image.width=16", "--set", "image.height=16", "--device",
                           report_of(each_device).name], cwd=tmp_path, env=kept, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert np.allclose(np.load(tmp_path / "a.npy"), picture, atol=1e-6)


@pytest.mark.parametrize("trouble", ["a file", "not allowed", "no home", "full"])
def test_no_cache_costs_time_and_one_warning(tmp_path, usual, trouble, device):
    prefix: tuple = ()
    variables: dict = {"XDG_CACHE_HOME": tmp_path / "cache"}
    if trouble == "a file":
        (tmp_path / "cache").write_text("")
    elif trouble == "not allowed":
        (tmp_path / "cache").mkdir()
        (tmp_path / "cache").chmod(0o555)
        if os.geteuid() == 0:
            if shutil.which("capsh") is None:
                pytest.skip("root may write everywhere, and there is no capsh to take that away")
            prefix = ("capsh", "--drop=cap_dac_override,cap_dac_read_search,cap_fowner", "--shell=/usr/bin/env", "--")
    elif trouble == "no home":
        variables = {"HOME": None}
        # Nor does anything say who the user is.
        (tmp_path / "sitecustomize.py").write_text(
            "import pwd\n\ndef getpwuid(uid):\n    raise KeyError(uid)\n\npwd.getpwuid = getpwuid\n")
        variables["PYTHONPATH"] = f"{tmp_path}{os.pathsep}{ROOT}"
    elif trouble == "full":
        (tmp_path / "cache").mkdir()
        mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8k", "tmpfs", tmp_path / "cache"],
                                 capture_output=True)
        if mounted.returncode != 0:
            pytest.skip("only root can make a small disk (mount)")
    try:
        picture, said = render(tmp_path, prefix=prefix, **variables)
    finally:
        if trouble == "full":
            subprocess.run(["umount", tmp_path / "cache"], check=True)
    assert np.array_equal(picture, usual[1])
    (line,) = warnings(said)
    assert "cache" in line and "each time" in line
    assert not (tmp_path / "~").exists()


@pytest.mark.parametrize("trouble", ["gone", "full", "no code"])
def test_a_folder_for_temporary_files_that_is_of_no_use(tmp_path, usual, trouble, device):
    """PoCL links its programs there, and loads them from there."""
    from clvol.opencl.devices import report_of

    place = tmp_path / "tmp"
    if trouble != "gone":
        place.mkdir()
        options = "size=16k" if trouble == "full" else "size=64m,noexec"
        if subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", place], capture_output=True).returncode:
            pytest.skip("only root can make a small disk (mount)")
    try:
        picture, said = render(tmp_path, "--device", report_of(device).name,
                               XDG_CACHE_HOME=tmp_path / "cache", TMPDIR=place)
    finally:
        if trouble != "gone":
            subprocess.run(["umount", place], check=True)
    assert np.allclose(picture, usual[1], atol=1e-6) and said == ""


@pytest.mark.parametrize("limit", ["-v 100000", "-v 200000", "-v 600000", "-v 1000000", "-v 1600000", "-f 100",
                                   "-n 12"])
def test_too_little_of_anything_is_a_picture_or_one_error(tmp_path, usual, limit, device):
    """Memory, size of files, open files."""
    limited = ("sh", "-c", f'ulimit {limit} && exec "$@"', "sh")
    done = run("render", ROOT / "data/brainsmall.nrrd", "-o", "a.npy", *RAMP, "--set", "image.width=16",
               "--set", "image.height=16", cwd=tmp_path, prefix=limited, XDG_CACHE_HOME=tmp_path / "cache")
    if done.returncode == 0:
        assert np.allclose(np.load(tmp_path / "a.npy"), usual[1], atol=1e-6)
    else:
        assert done.returncode in (3, 4), done.stderr
        assert done.stderr.startswith("clvol: error: ") and done.stderr.count("\n") == 1
        assert not (tmp_path / "a.npy").exists()


@pytest.mark.parametrize("kilobytes", [300_000, 600_000, 1_000_000, 1_600_000])
def test_too_little_memory_though_devices_are_known(tmp_path, cached, kilobytes, device):
    """Nothing is probed then: libraries and compilers are loaded at once."""
    limited = ("sh", "-c", f'ulimit -v {kilobytes} && exec "$@"', "sh")
    done = run("render", ROOT / "data/brainsmall.nrrd", "-o", "a.npy", *RAMP, "--set", "image.width=16", "--set",
               "image.height=16", "--set", 'integration.filter="nearest"', cwd=tmp_path, prefix=limited,
               XDG_CACHE_HOME=cached[0])
    if done.returncode:
        assert done.returncode == 4 and "ulimit -v" in done.stderr, done.stderr
        assert done.stderr.startswith("clvol: error: memory: ") and done.stderr.count("\n") == 1
    assert (tmp_path / "a.npy").exists() == (done.returncode == 0)


def test_many_processes_share_a_cache(tmp_path, usual, device):
    kept = {k: v for k, v in os.environ.items() if not k.startswith(UNSET)}
    kept |= {"PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    command = [sys.executable, "-m", "clvol", "render", ROOT / "data/brainsmall.nrrd", *RAMP,
               "--set", "image.width=16", "--set", "image.height=16", "-o"]
    processes = [subprocess.Popen([*command, f"{n}.npy"], cwd=tmp_path, env=kept, text=True,
                                  stdout=subprocess.PIPE, stderr=subprocess.PIPE) for n in range(3)]
    for number, process in enumerate(processes):
        _, said = process.communicate(timeout=300)
        assert (process.returncode, said) == (0, "")
        assert np.array_equal(np.load(tmp_path / f"{number}.npy"), usual[1])
    assert not [path for path in files(tmp_path / "cache") if path.name.endswith(".part")]


def test_nothing_is_left_among_temporary_files(tmp_path, usual, device):
    place = tmp_path / "tmp"
    place.mkdir()
    render(tmp_path, XDG_CACHE_HOME=tmp_path / "cache", TMPDIR=place)
    done = run("doctor", cwd=tmp_path, XDG_CACHE_HOME=tmp_path / "cache", TMPDIR=place)
    assert done.returncode == 0 and f"temporary files  {place}" in done.stdout
    assert list(place.iterdir()) == []
