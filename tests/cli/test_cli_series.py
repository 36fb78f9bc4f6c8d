"""Series on the command line: a frame per step, what fails is named and leaves the rest, sheets and jobs of steps."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from clvol import load_volume
from clvol.image import load_image

TEXT = """version = 1
[volume]
file = "t_*.npy"
[image]
width = 10
height = 8
[transfer_function]
opacity_unit = 2.0
points = [{ value = 0.0, opacity = 0.0, color = [1, 1, 1] }, { value = 90.0, opacity = 0.9, color = [1, 1, 1] }]
[integration]
step_error = 0.0
"""
COUNT = 4


@pytest.fixture
def series(tmp_path, monkeypatch):
    """A folder with a scene of four steps, each brighter than the one before."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clvol.cache_folder.cache_folder", lambda: tmp_path / "cache")
    for k in range(COUNT):
        np.save(tmp_path / f"t_{8 + k}.npy", np.full((4, 5, 6), 20 * (k + 1), np.uint8))
    (tmp_path / "s.toml").write_text(TEXT)
    return tmp_path


def pixels(path) -> np.ndarray:
    return load_image(path)["rgba"] if str(path).endswith(".exr") else np.load(path)


def names(folder, pattern) -> list[str]:
    return sorted(path.name for path in folder.glob(pattern))


def test_a_frame_for_each_step(run, series):
    outcome = run("render", "s.toml", "-o", "f_%d.npy", "-o", "f.gif", "--stats", "stats.json")
    assert outcome.status == 0, outcome
    assert names(series, "f_*.npy") == [f"f_{k}.npy" for k in range(COUNT)]
    shown = [float(np.load(f"f_{k}.npy")[..., 3].sum()) for k in range(COUNT)]
    assert shown == sorted(shown) and len(set(shown)) == COUNT
    with Image.open("f.gif") as film:
        assert film.n_frames == COUNT
    assert json.loads((series / "stats.json").read_text())["frames"] == COUNT


def test_frames_are_numbers_of_steps(run, series):
    run("render", "s.toml", "-o", "f_%d.npy")
    assert run("render", "s.toml", "-o", "g_%d.npy", "--frames", "1:3").status == 0
    assert names(series, "g_*") == ["g_1.npy", "g_2.npy"]
    np.testing.assert_array_equal(pixels("g_2.npy"), pixels("f_2.npy"))
    assert run("render", "s.toml", "-o", "g_%d.npy", "--frames", ":").status == 0
    assert len(names(series, "g_*")) == COUNT
    outcome = run("render", "s.toml", "-o", "h_%d.npy", "--frames", "2:9")
    assert outcome.status == 2 and "'2:9' for an animation of 4 frames" in outcome.err
    assert run("render", "s.toml", "-o", "one.npy", "--set", "volume.step=2").status == 0
    np.testing.assert_array_equal(pixels("one.npy"), pixels("f_2.npy"))


@pytest.mark.slow  # the chosen look is a program of its own
def test_a_pattern_is_a_scene(run, series):
    assert run("render", "t_*.npy", "-o", "p_%d.png", "--set", "image.width=8", "--set", "image.height=8").status == 0
    assert len(names(series, "p_*.png")) == COUNT
    assert run("render", "t_*.npy", "-o", "still.png", "--set", "image.width=8").status == 0
    outcome = run("render", "x_*.npy", "-o", "still.png")
    assert outcome.status == 2 and "no file is named like 'x_*.npy'" in outcome.err


def test_a_step_that_fails_is_named_and_the_other_frames_are_there(run, series):
    (series / "t_10.npy").write_bytes(b"nothing")
    outcome = run("render", "s.toml", "-o", "f_%d.npy", "--stats", "stats.json")
    assert outcome.status == 2
    assert names(series, "f_*.npy") == ["f_0.npy", "f_1.npy", "f_3.npy"]
    errors = [line for line in outcome.err.splitlines() if "error" in line]
    assert len(errors) == 1 and errors[0].startswith("clvol: error: frame 2: ") and "t_10.npy" in errors[0]
    told = json.loads((series / "stats.json").read_text())
    assert told["frames"] == 3 and told["frames_failed"] == [2] and told["frames_kept"] == 0
    outcome = run("render", "s.toml", "-o", "f.gif")  # a video without a frame would be another video
    assert outcome.status == 2 and "t_10.npy" in outcome.err and not (series / "f.gif").exists()


def test_resume_renders_what_is_missing_and_what_has_changed(run, series):
    def rendered() -> set[str]:
        outcome = run("render", "s.toml", "-o", "f_%d.png", "--resume")
        assert outcome.status == 0, outcome
        return set(outcome.out.split())

    assert len(rendered()) == COUNT
    assert rendered() == set()
    (series / "f_1.png").unlink()
    np.save(series / "t_11.npy", np.full((4, 5, 6), 79, np.uint8))
    assert rendered() == {"f_1.png", "f_3.png"}


@pytest.mark.slow  # four calls with EXR
def test_a_picture_of_a_step_renders_again(run, series):
    """Also where the steps are spread over another number of frames."""
    run("render", "s.toml", "-o", "f_%d.exr", "--set", "animation.frames=2")
    for k in (0, 1):
        assert run("render", f"f_{k}.exr", "-o", f"again_{k}.exr").status == 0
        np.testing.assert_array_equal(pixels(f"again_{k}.exr"), pixels(f"f_{k}.exr"))
    assert pixels("f_1.exr").sum() > pixels("f_0.exr").sum()


def test_info_lists_the_steps(run, series):
    told = json.loads(run("info", "s.toml", "--json").out)
    assert told["value_range"] == [20.0, 80.0] and told["size_xyz"] == [6, 5, 4]
    assert [each["value_range"] for each in told["steps"]] == [[20.0 * (k + 1)] * 2 for k in range(COUNT)]
    assert [each["path"] for each in told["steps"]] == [f"t_{8 + k}.npy" for k in range(COUNT)]
    (series / "t_9.npy").write_bytes(b"nothing")
    text = run("info", "t_*.npy").out
    assert "4, whose range over all times is above" in text
    lines = text.splitlines()[-COUNT:]
    assert lines[0].split() == ["0", "20", "to", "20", "t_8.npy"]
    assert "t_9.npy: " in lines[1] and " to " not in lines[1].partition("t_9")[0]


@pytest.mark.slow  # many small calls
def test_a_sheet_of_steps(run, series):
    for steps, count in ((["1"], 1), ([":"], 4), (["0:4:2", "3"], 3), (["1:", "1"], 3)):
        words = [word for each in steps for word in ("--step", each)]
        outcome = run("sheet", "s.toml", "-o", "sheet.png", "--size", "32", "--columns", "1", *words)
        assert outcome.status == 0, outcome
        with Image.open("sheet.png") as picture:
            heights = picture.height
        run("sheet", "s.toml", "-o", "one.png", "--size", "32", "--columns", "1")
        with Image.open("one.png") as picture:
            assert (heights > picture.height) == (count > 1)
    for wrong in ("4", "x", "2:1", "1:2:3:4", "::0", "-1"):
        outcome = run("sheet", "s.toml", "-o", "no.png", "--size", "32", "--step", wrong)
        assert outcome.status == 2 and "--step" in outcome.err, wrong
    assert run("sheet", "t_8.npy", "-o", "no.png", "--size", "32", "--step", "0").status == 2


def test_a_job_with_a_picture_for_each_step(run, series):
    (series / "job.toml").write_text(
        'scenes = ["s.toml"]\noutput = "out/{volume.step}.npy"\n'
        '[[vary]]\nkey = "volume.step"\nvalues = [0, 1, 2, 3]\n'
    )
    (series / "t_10.npy").write_bytes(b"nothing")
    outcome = run("batch", "job.toml")
    assert outcome.status == 2 and "t_10.npy" in outcome.err + outcome.out
    assert names(series / "out", "*.npy") == ["0.npy", "1.npy", "3.npy"]
    run("render", "s.toml", "-o", "f_%d.npy")
    for k in (0, 1, 3):
        np.testing.assert_array_equal(pixels(f"out/{k}.npy"), pixels(f"f_{k}.npy"))


def test_files_of_a_series_are_not_written_to(run, series):
    outcome = run("render", "s.toml", "-o", "t_9.npy")
    assert outcome.status == 2 and "t_9.npy: is also an input" in outcome.err
    assert run("render", "s.toml", "-o", "t_%d.npy", "--set", "animation.frames=10").status == 2
    assert [int(np.load(f"t_{8 + k}.npy").max()) for k in range(COUNT)] == [20, 40, 60, 80]


def test_a_store_is_made_of_one_step(run, series):
    outcome = run("store", "t_*.npy", "-o", "a.zarr")
    assert outcome.status == 2 and "t_*.npy: a series of 4 steps, expected one of them" in outcome.err
    assert run("store", "t_*.npy", "-o", "a.zarr", "--set", "volume.step=2", "--quiet").status == 0
    assert load_volume("a.zarr").value_range == (60.0, 60.0)


def test_a_frame_per_step_needs_a_series(run, series):
    outcome = run("render", "t_8.npy", "-o", "x.png", "--frames", ":")
    assert outcome.status == 2 and "given for a single picture" in outcome.err
