"""clvol render of several frames: numbered pictures one by one, videos whole or not at all."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from PIL import Image

from clvol.errors import RenderError
from clvol.image import load_image

FRAMES = ["--set", "animation.frames=3", "--set", "animation.fps=2"]


def names(folder) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name not in START)


START = ("scene.toml", "cube.npy")


def test_pictures_are_numbered_from_0(run, folder, renderer):
    outcome = run("render", "scene.toml", "-o", "a_%04d.npy", "-o", "b%d.png", *FRAMES)
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.split() == [
        "a_0000.npy", "b0.png", "a_0001.npy", "b1.png", "a_0002.npy", "b2.png",
    ]  # fmt: skip
    assert names(folder) == sorted(outcome.out.split())
    for index in range(3):  # half a second apart
        assert np.load(f"a_000{index}.npy")[0, 0, 0] == np.float32(0.25 + index / 8)


def test_one_renderer_gets_time_and_camera_of_each_frame(run, folder, renderer):
    more = ["--set", "animation.time=1.5", "--set", "animation.orbit_degrees=90"]
    run("render", "scene.toml", "-o", "a_%d.npy", *FRAMES, *more)
    assert len(renderer.calls) == 1
    times, cameras = zip(*renderer.rendered)
    assert times == (1.5, 2.0, 2.5)
    assert len({camera.position for camera in cameras}) == 3


@pytest.mark.parametrize("ending", ["gif", "webp", "apng"])
def test_a_video_holds_every_frame(run, folder, renderer, ending):
    outcome = run("render", "scene.toml", "-o", f"v.{ending}", *FRAMES)
    assert (outcome.status, outcome.out, outcome.err) == (0, f"v.{ending}\n", "")
    with Image.open(f"v.{ending}") as video:
        assert (video.n_frames, video.size) == (3, (8, 6))


def test_videos_pictures_and_stats_together(run, folder, renderer):
    files = ["-o", "v.gif", "-o", "a_%d.npy", "--stats", "s.json"]
    outcome = run("render", "scene.toml", *files, *FRAMES)
    assert outcome.out.split() == ["a_0.npy", "a_1.npy", "a_2.npy", "v.gif", "s.json"]
    stats = json.loads((folder / "s.json").read_text())
    assert (stats["frames"], stats["frames_kept"]) == (3, 0)
    assert (stats["samples"], stats["rays"]) == (21, 144) and stats["devices"] == ["stub"]
    assert stats["seconds"]["render"] == 1.5
    assert set(stats["seconds"]) == {"load", "prepare", "compile", "render", "write", "total"}


def test_a_single_frame_takes_the_number_0(run, folder, renderer):
    assert run("render", "scene.toml", "-o", "a_%02d.npy").out == "a_00.npy\n"


MISTAKES = [
    (["-o", "a.png", *FRAMES], "a.png: one name for 3 frames, expected a name with a number such "
     "as a_%04d.png, or one of .gif, .webp, .apng, .mp4"),
    (["-o", "a%d%d.png", *FRAMES], "a%d%d.png: one name for 3 frames"),
    (["-o", "a.mov", *FRAMES], 'a.mov: unknown ending ".mov"'),
    (["-o", "a.gif"], "a.gif: a video of a single picture, expected .exr or .png or .jpg or .jpeg or "),
    (["-o", "none/a.gif", *FRAMES], 'none/a.gif: the folder '),
    (["-o", "none/a%d.png", *FRAMES], 'none/a0.png: the folder '),
    (["-o", "a.gif", *FRAMES, "--set", "animation.fps=60"],
     "a.gif: 60 frames per second, expected 0.1 to 50"),
    (["-o", "a.png", "--resume"], "--resume: given for a single picture, expected animation"),
    (["-o", "a%d.png", "--max-error", "1e-2", *FRAMES],
     "--max-error: given for an animation of 3 frames, expected one frame"),
    (["-o", "a%d.png", "--time-budget", "1", *FRAMES], "--time-budget: given for an animation"),
    (["-o", "a%d.png", "-o", "a%02d.png", "--set", "animation.frames=11"],
     "a%02d.png: frame 10 is a file that is used already"),
    (["-o", "a%d.npy", "--stats", "a2.npy", *FRAMES], "a%d.npy: frame 2 is a file that is used"),
    (["-o", "a%d.png", "-o", "./a%d.png", *FRAMES], "./a0.png: is given twice as an output"),
    (["-o", "a%d.png", "--set", "animation.frames=0"], "scene.toml: animation.frames: got 0"),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "line"), MISTAKES)
def test_mistakes_are_told_before_the_work(refused, nothing_left, renderer, arguments, line):
    assert refused(2, "render", "scene.toml", *arguments).startswith(line)
    assert renderer.rendered == []


def test_an_mp4_needs_a_package_that_is_named(refused, nothing_left, renderer, monkeypatch):
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *a: None if "ffmpeg" in name else find(name, *a)
    )
    line = refused(2, "render", "scene.toml", "-o", "a.mp4", *FRAMES)
    assert line == (
        "a.mp4: needs the package imageio-ffmpeg, expected that package (pip install "
        "imageio-ffmpeg), or one of .gif, .webp, .apng"
    )


@pytest.mark.parametrize(
    ("failure", "status"), [(KeyboardInterrupt(), 130), (RenderError("kernel", "it failed"), 4)]
)
def test_what_is_finished_stays_and_no_half_video_does(
    refused, folder, renderer, monkeypatch, failure, status
):
    monkeypatch.setattr(renderer, "failure", failure)
    monkeypatch.setattr(renderer, "fails_at", 1.0)  # the last frame
    (folder / "v.gif").write_bytes(b"old")
    arguments = ["-o", "v.gif", "-o", "a_%d.npy", "-o", "a_%d.png", "--stats", "s.json", *FRAMES]
    refused(status, "render", "scene.toml", *arguments)
    assert names(folder) == ["a_0.npy", "a_0.png", "a_1.npy", "a_1.png", "v.gif"]
    assert (folder / "v.gif").read_bytes() == b"old"


def test_a_full_disk_leaves_no_half_video(refused, nothing_left, renderer, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    line = refused(4, "render", "scene.toml", "-o", "v.webp", *FRAMES)
    assert line == "v.webp: the file cannot be written: No space left on device"


def test_resuming_renders_only_what_is_missing(run, folder, renderer):
    arguments = ["render", "scene.toml", "-o", "a_%d.png", "-o", "b_%d.exr", *FRAMES]
    run(*arguments)
    untouched = os.stat("a_0.png")
    (folder / "b_1.exr").write_bytes((folder / "b_1.exr").read_bytes()[:200])  # broken
    (folder / "a_2.png").unlink()
    renderer.rendered.clear()
    outcome = run(*arguments, "--resume", "--stats", "s.json")
    assert outcome.status == 0 and outcome.err == "1 of 3 frames existed already and were kept\n"
    assert outcome.out.split() == ["a_1.png", "b_1.exr", "a_2.png", "b_2.exr", "s.json"]
    assert [time for time, _ in renderer.rendered] == [0.5, 1.0]
    assert os.stat("a_0.png").st_mtime_ns == untouched.st_mtime_ns
    assert load_image("b_1.exr")["rgba"][0, 0, 0] == np.float32(0.375)
    stats = json.loads((folder / "s.json").read_text())
    assert (stats["frames"], stats["frames_kept"]) == (2, 1)


def test_without_resuming_everything_is_rendered_again(run, folder, renderer):
    arguments = ["render", "scene.toml", "-o", "a_%d.npy", *FRAMES]
    run(*arguments)
    run(*arguments)
    assert len(renderer.rendered) == 6


@pytest.mark.parametrize("other", ["image.width=9", "animation.orbit_degrees=5"])
def test_pictures_of_another_scene_are_not_kept(run, folder, renderer, other):
    arguments = ["render", "scene.toml", "-o", "a_%d.png", *FRAMES]
    run(*arguments)
    run(*arguments, "--resume", "--set", other)
    assert len(renderer.rendered) == 6


def test_when_nothing_is_missing_no_device_is_opened(run, folder, renderer):
    arguments = ["render", "scene.toml", "-o", "a_%d.png", *FRAMES]
    run(*arguments)
    renderer.calls.clear()
    outcome = run(*arguments, "--resume", "--stats", "s.json")
    assert (outcome.status, outcome.out) == (0, "s.json\n") and renderer.calls == []
    assert json.loads((folder / "s.json").read_text())["samples"] == 0


def test_a_video_goes_on_where_it_stopped(run, folder, renderer, monkeypatch):
    assert run("render", "scene.toml", "-o", "whole.gif", *FRAMES).status == 0
    renderer.rendered.clear()
    monkeypatch.setattr(renderer, "failure", RenderError("device", "failed", "luck"))
    monkeypatch.setattr(renderer, "fails_at", 1.0)
    assert run("render", "scene.toml", "-o", "a.gif", "--resume", *FRAMES).status == 4
    assert not os.path.exists("a.gif") and sorted(os.listdir("a.gif.frames")) == ["000000.png", "000001.png"]
    monkeypatch.setattr(renderer, "failure", None)
    outcome = run("render", "scene.toml", "-o", "a.gif", "--resume", *FRAMES)
    assert outcome.status == 0 and outcome.out.split() == ["a.gif"]
    assert [time for time, _ in renderer.rendered] == [0.0, 0.5, 1.0]
    assert not os.path.exists("a.gif.frames")
    with Image.open("a.gif") as film, Image.open("whole.gif") as whole:
        assert film.n_frames == whole.n_frames == 3
        for index in range(3):
            film.seek(index), whole.seek(index)
            np.testing.assert_array_equal(np.asarray(film.convert("RGB")), np.asarray(whole.convert("RGB")))


def test_other_files_beside_the_frames_of_a_video_stay(run, folder, renderer):
    os.mkdir("a.gif.frames")
    (folder / "a.gif.frames" / "notes.txt").write_text("mine")
    assert run("render", "scene.toml", "-o", "a.gif", "--resume", *FRAMES).status == 0
    assert os.listdir("a.gif.frames") == ["notes.txt"]


def test_transparent_frames_of_a_video_are_not_kept(refused, folder, renderer):
    line = refused(2, "render", "scene.toml", "-o", "a.gif", "--resume", "--set", "display.transparent=true", *FRAMES)
    assert line.startswith("--resume: given with a.gif and display.transparent, expected display.transparent = false")
