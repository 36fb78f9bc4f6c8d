"""The command as a whole, and info, doctor, explain, compare."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest

import clvol
from clvol.cli.group import COMMANDS


def test_help_names_every_command(run):
    outcome = run("--help")
    assert outcome.status == 0 and outcome.err == ""
    for name in COMMANDS:
        assert f"\n  {name} " in outcome.out


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(run, name):
    outcome = run(name, "--help")
    assert outcome.status == 0 and outcome.out.startswith(f"Usage: clvol {name} ")


def test_version(run):
    outcome = run("--version")
    assert (outcome.status, outcome.out) == (0, f"clvol {clvol.__version__}\n")


def test_help_imports_nothing_heavy():
    """What makes ``clvol --help`` quick, on machines of any speed."""
    code = (
        "import sys; from clvol.cli import main; main(['--help']); heavy = "
        "{'numpy', 'pydantic', 'pyopencl', 'rich', 'SimpleITK', 'skimage'} & set(sys.modules); "
        "sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["rendr"], "clvol: unknown command 'rendr', expected one of render"),
        (["--bogus"], "clvol: unknown option --bogus, expected"),
        (["info"], "clvol info: no VOLUME, expected VOLUME"),
        (["info", "a", "b"], "clvol info: "),
        (["compare", "a.exr"], "clvol compare: no B, expected B"),
        (["doctor", "x"], "clvol doctor: "),
        (["render", "scene.toml", "-o"], "clvol"),
    ],
)
def test_wrong_usage_is_one_line(refused, words, line):
    assert refused(2, *words).startswith(line)


def test_info_as_json(run, folder):
    outcome = run("info", "cube.npy", "--json")
    facts = json.loads(outcome.out)
    assert (outcome.status, outcome.err) == (0, "")
    assert facts["shape_zyx"] == [4, 4, 4] and facts["dtype"] == "uint8"
    assert facts["spacing"] == [1, 1, 1] and facts["value_range"] == [0, 63]
    assert facts["nan_count"] == 0 and facts["memory_needed"] >= 64


def test_info_for_people_counts_nan(run, folder):
    np.save("holes.npy", np.array([[[1.0, np.nan, np.inf]]]))
    told = dict(line.split(None, 1) for line in run("info", "holes.npy").out.splitlines())
    assert told["type"] == "float64" and told["range"] == "1 to 1"
    assert "NaN voxels       1" in run("info", "holes.npy").out


def test_info_of_a_raw_file_and_of_a_scene(run, folder):
    (folder / "v.raw").write_bytes(bytes(24))
    words = ["--set", "volume.dims=[2,3,4]", "--set", 'volume.dtype="uint8"']
    assert json.loads(run("info", "v.raw", "--json", *words).out)["shape_zyx"] == [4, 3, 2]
    assert json.loads(run("info", "scene.toml", "--json").out)["shape_zyx"] == [4, 4, 4]


def test_info_of_what_is_no_volume(refused, nothing_left):
    assert refused(2, "info", "none.npy").startswith("none.npy: no such file, expected")
    assert refused(2, "info", "cube.npy", "--memory-cap", "1 B").startswith("cube.npy: ")


def test_info_of_a_damaged_volume(refused, folder):
    whole = (folder / "cube.npy").read_bytes()
    for size in (0, 5, 60, len(whole) - 1):
        (folder / "cut.npy").write_bytes(whole[:size])
        assert refused(2, "info", "cut.npy").startswith("cut.npy: ")


@pytest.fixture
def reports(monkeypatch):
    """Sets what the probe of the devices is to find."""
    from clvol.opencl import devices

    def found(*reports):
        monkeypatch.setattr(devices, "list_devices", lambda **_: list(reports))

    return found


def test_doctor_tells_of_working_and_broken_devices(run, reports):
    from clvol.opencl.reports import DeviceReport

    reports(
        DeviceReport("pocl", "Portable Computing Language", "cpu", working=True, type="CPU",
                     global_memory=2**30),
        DeviceReport("broken", "Broken", reason="its platform crashed"),
    )
    outcome = run("doctor")
    assert (outcome.status, outcome.err) == (0, "")
    assert "pocl: works" in outcome.out and "1.0 GiB" in outcome.out
    assert "broken: does not work" in outcome.out and "its platform crashed" in outcome.out
    told = json.loads(run("doctor", "--json").out)["devices"]
    assert [report["working"] for report in told] == [True, False]


def test_doctor_without_a_working_device_has_status_3(run, reports):
    from clvol.opencl.reports import DeviceReport

    for found in ([], [DeviceReport("broken", "Broken", reason="its platform crashed")]):
        reports(*found)
        outcome = run("doctor", "--json")
        assert outcome.status == 3
        assert len(json.loads(outcome.out)["devices"]) == len(found)
        assert outcome.err.startswith("clvol: error: ") and outcome.err.count("\n") == 1


def test_explain_tells_what_the_scene_calls_for(run, folder, monkeypatch):
    told = {"effects": [{"name": "skip", "called_for": True, "reason": "empty space"},
                        {"name": "shade", "called_for": False, "reason": "no light"}],
            "classification": {"name": "post", "reason": "it errs less"}, "kernel_hash": "abc", "warnings": [],
            "rays": {"per_pixel": 4, "reason": "in every pixel"}}
    module = ModuleType("clvol.explanation")
    module.explain = lambda resolved: told if resolved.image.width == 8 else None
    monkeypatch.setitem(sys.modules, "clvol.explanation", module)
    assert json.loads(run("explain", "scene.toml", "--json").out) == told
    lines = run("explain", "scene.toml").out.splitlines()
    assert lines[0].split() == ["yes", "skip", "empty", "space"]
    assert lines[1].split() == ["no", "shade", "no", "light"] and lines[4] == "kernel abc"
    assert lines[2:4] == ["classification post: it errs less", "rays per pixel 4: in every pixel"]


def test_explain_refuses_a_wrong_scene(refused, nothing_left):
    line = refused(2, "explain", "scene.toml", "--set", "image.width=0")
    assert line.startswith("scene.toml: image.width: got 0")


def test_comparing_pictures_of_unequal_size_or_none(refused, folder):
    np.save("a.npy", np.zeros((2, 3, 4), np.float32))
    np.save("b.npy", np.zeros((2, 4, 4), np.float32))
    line = refused(2, "compare", "a.npy", "b.npy")
    assert line.startswith("b.npy: got 4 x 2 pixels, expected 3 x 2 pixels")
    assert refused(2, "compare", "a.npy", "none.npy").startswith("none.npy: ")
    assert refused(2, "compare", "a.npy", "scene.toml").startswith("scene.toml: ")


def test_comparing_pictures(run, folder):
    np.save("a.npy", np.zeros((16, 16, 4), np.float32))
    np.save("b.npy", np.full((16, 16, 4), 0.5, np.float32))
    told = json.loads(run("compare", "a.npy", "b.npy", "--json").out, parse_constant=pytest.fail)
    names = {"rmse", "max_abs", "psnr", "ssim", "delta_e_mean", "delta_e_max"}
    assert names <= set(told)
    assert told["rmse"] == told["max_abs"] == 0.5
    same = json.loads(run("compare", "a.npy", "a.npy", "--json").out, parse_constant=pytest.fail)
    assert same["rmse"] == same["delta_e_max"] == 0
    assert "rmse" in run("compare", "a.npy", "b.npy").out


@pytest.fixture
def two_pictures(folder):
    a = np.random.default_rng(1).random((20, 30, 4)).astype(np.float32)
    b = np.clip(a - 0.25, 0, None)
    np.save("a.npy", a)
    np.save("b.npy", b)
    return a, b


def test_a_difference_picture_to_look_at_and_to_compute_with(run, two_pictures):
    from clvol.image import load_image

    a, b = two_pictures
    outputs = ["-o", "d.png", "-o", "d.exr", "--output", "d.npy"]
    outcome = run("compare", "a.npy", "b.npy", *outputs)
    assert (outcome.status, outcome.err) == (0, "")
    assert "rmse" in outcome.out and "d.png" in outcome.out
    for name in ("d.exr", "d.npy"):
        np.testing.assert_allclose(load_image(name)["rgba"], a - b, atol=1e-7)
    assert load_image("d.png")["rgba"][..., :3].std() > 0.01


def test_a_difference_picture_leaves_json_alone(run, two_pictures):
    plain = run("compare", "a.npy", "b.npy", "--json")
    assert run("compare", "a.npy", "b.npy", "--json", "-o", "d.png") == plain


def test_a_difference_picture_is_never_one_of_the_two(refused, two_pictures, nothing_left):
    for name in ("a.npy", "./b.npy"):
        line = refused(2, "compare", "a.npy", "b.npy", "-o", "d.png", "-o", name)
        assert line.startswith(f"{name}: is also an input, expected a different output file")
    line = refused(2, "compare", "a.npy", "b.npy", "-o", "d.png", "-o", "d.png")
    assert "given twice" in line


@pytest.mark.parametrize("name", ["d.jpg", "d", "none/d.png"])
def test_a_difference_picture_in_an_impossible_place(refused, two_pictures, nothing_left, name):
    line = refused(2, "compare", "a.npy", "b.npy", "-o", "d.exr", "-o", name)
    assert line.startswith(f"{name}: ")


def test_no_difference_picture_of_pictures_of_unequal_size(refused, two_pictures, nothing_left):
    refused(2, "compare", "a.npy", "cube.npy", "-o", "d.png")


def test_a_reader_that_has_gone_away_is_no_error(folder):
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-m", "clvol", "info", "cube.npy"], stdout=write,
                          stderr=subprocess.PIPE, text=True, timeout=300)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no /dev/full")
def test_a_full_disk_behind_stdout_is_told(folder):
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-m", "clvol", "info", "cube.npy"], stdout=full,
                              stderr=subprocess.PIPE, text=True, timeout=300)
    assert done.returncode == 4
    assert done.stderr.startswith("clvol: error: standard output: cannot be written")
    assert done.stderr.count("\n") == 1
