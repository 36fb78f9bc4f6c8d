"""clvol develop, pictures that render again, standard output, and several scenes in one call."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

import clvol
from clvol.image import load_image
from clvol.image.develop import developed
from clvol.render.frame import Frame, make_frame
from clvol.scene import Display, load_scene

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def picture(folder):
    """A frame of the scene, whose light was not rendered, as picture.exr."""
    resolved = load_scene("scene.toml", ["display.exposure=0.5", "image.background=[0.2,0.4,0.6]"]).resolve()
    alpha = np.linspace(0, 1, 48, dtype=np.float32).reshape(6, 8, 1)
    rgba = np.concatenate([alpha * [1.5, 0.5, 0.25], alpha], axis=-1)
    frame = make_frame(resolved, rgba, None, {}, {}, ["none"])
    frame.save("picture.exr")
    return frame


def pixels(path) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.open(path))


# --- develop


def test_what_the_picture_carries_is_the_default(run, picture):
    assert run("develop", "picture.exr", "-o", "a.png").out == "a.png\n"
    picture.save("b.png")
    assert np.array_equal(pixels("a.png"), pixels("b.png"))


def test_options_and_keys_change_how_it_is_displayed_and_nothing_is_rendered(run, picture, renderer):
    words = ["--exposure", "-1", "--tone-curve", "reinhard", "--white", "2", "--background", "#ff0000"]
    assert run("develop", "picture.exr", "-o", "a.png", *words).status == 0
    how = Display(exposure=-1.0, tone_curve="reinhard", white=2.0)
    assert np.array_equal(pixels("a.png"), developed(picture.rgba, (1, 0, 0), how))
    keys = ["display.exposure=-1", 'display.tone_curve="reinhard"', "display.white=2", "image.background=[1.0,0.0,0.0]"]
    assert run("develop", "picture.exr", "-o", "b.png", *(w for key in keys for w in ("--set", key))).status == 0
    assert np.array_equal(pixels("a.png"), pixels("b.png"))
    assert renderer.calls == []


def test_the_scene_that_is_carried_on_states_the_display(run, picture):
    run("develop", "picture.exr", "-o", "a.png", "--exposure", "2", "--transparent")
    assert pixels("a.png").shape == (6, 8, 4)
    scene = load_scene("a.png")
    assert scene.display == Display(exposure=2.0, transparent=True) and scene.image.width == 8
    run("develop", "picture.exr", "-o", "b.tif", "--background", "white")
    assert np.allclose(load_image("b.tif")["background"], 1.0)


def test_an_overlay_is_drawn_without_the_volume(run, picture):
    os.remove("cube.npy")
    run("develop", "picture.exr", "-o", "a.png", "--exposure", "0")
    run("develop", "picture.exr", "-o", "b.png", "--exposure", "0", "--set", "overlay.box=true")
    assert not np.array_equal(pixels("a.png"), pixels("b.png"))
    picture.overlay = None
    picture.save("old.exr")
    assert run("develop", "old.exr", "-o", "a.png").status == 0
    assert "carries no description" in run("develop", "old.exr", "-o", "a.png", "--set", "overlay.box=true").err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["picture.exr", "-o", "a.png", "--tone-curve", "soft"], "scene: display.tone_curve: got 'soft'"),
        (["picture.exr", "-o", "a.png", "--white", "0"], "scene: display.white: got 0"),
        (["picture.exr", "-o", "a.png", "--exposure", "nan"], "scene: display.exposure: got nan"),
        (["picture.exr", "-o", "a.png", "--background", "0.1,2,0"], "--background: got '0.1,2,0', expected three"),
        (["picture.exr", "-o", "a.png", "--set", "camera.fov_degrees=3"], "--set camera.fov_degrees: changes what"),
        (["picture.exr", "-o", "a.png", "--set", "display.bright=3"], "scene: display.bright: unknown key"),
        (["picture.exr", "-o", "a.exr"], 'a.exr: unknown ending ".exr" of a displayed picture'),
        (["picture.exr", "-o", "a.jpg", "--transparent"], "a.jpg: a .jpg of a transparent picture"),
        (["scene.toml", "-o", "a.png"], "scene.toml: holds colours as displayed"),
        (["none.exr", "-o", "a.png"], "none.exr: there is no such file"),
        (["picture.exr", "-o", "a.png", "-o", "-", "-o", "-"], "-: is given twice"),
    ],
)
def test_mistakes_are_one_line_and_leave_no_file(refused, picture, words, line):
    before = sorted(os.listdir())
    assert refused(2, "develop", *words).startswith(line)
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize("scene", ["not toml [", "version = 1\n[display]\nexposure = 'x'\n", "display = 3"])
def test_damaged_headers_are_refused_or_ignored(run, picture, scene):
    picture.scene_source = scene
    picture.save("bad.exr")
    outcome = run("develop", "bad.exr", "-o", "a.png")
    assert outcome.status in (0, 2) and outcome.err.count("\n") == (outcome.status > 0)


def test_a_damaged_overlay_is_refused(run, picture):
    class Damaged:
        def __init__(self, text):
            self.to_json = lambda: text

    for text in ("{}", "[", json.dumps({**json.loads(picture.overlay.to_json()), "values": [2.0, 1.0]})):
        picture.overlay = Damaged(text)
        picture.save("bad.exr")
        assert "bad.exr: overlay: " in run("develop", "bad.exr", "-o", "a.png").err


def test_a_frame_is_loaded_in_python(picture, tmp_path):
    frame = Frame.load("picture.exr")
    assert np.array_equal(frame.rgba, picture.rgba) and frame.display == picture.display
    assert np.allclose(frame.background, picture.background) and frame.made_from()["voxels"]
    frame.display = clvol.Display(exposure=3.0)
    assert np.asarray(frame.image()).mean() > np.asarray(picture.image()).mean()


# --- standard output


@pytest.mark.usefixtures("device")
def test_a_picture_on_standard_output_is_its_only_content(folder):
    words = [sys.executable, "-m", "clvol", "render", "scene.toml", "-o", "-", "-o", "also.npy", "--stats", "s.json"]
    done = subprocess.run(words, capture_output=True, timeout=300)
    assert done.returncode == 0 and done.stdout.startswith(PNG) and done.stdout.endswith(b"IEND\xaeB`\x82")
    assert b"also.npy" in done.stderr
    assert json.loads((folder / "s.json").read_text())["method"] == "raycast"


def test_stats_on_standard_output(run, folder, renderer):
    outcome = run("render", "scene.toml", "-o", "a.npy", "--stats", "-")
    assert json.loads(outcome.out)["method"] == "raycast" and "a.npy" in outcome.err
    outcome = run("render", "scene.toml", "-o", "a_%d.npy", "--stats", "-", "--set", "animation.frames=2")
    assert json.loads(outcome.out)["frames"] == 2
    assert sorted(path.name for path in folder.iterdir()) == ["a.npy", "a_0.npy", "a_1.npy", "cube.npy", "scene.toml"]


def test_standard_output_is_for_one_thing(refused, nothing_left, renderer):
    assert refused(2, "render", "scene.toml", "-o", "-", "--stats", "-").startswith("-: is given twice")
    assert "one picture for 3 frames" in refused(2, "render", "scene.toml", "-o", "-", "--set", "animation.frames=3")


def test_a_failure_leaves_standard_output_empty(refused, folder, renderer):
    renderer.failure = clvol.errors.RenderError("device", "lost")
    assert refused(4, "render", "scene.toml", "-o", "-") == "device: lost"


# --- several scenes


def test_several_scenes_are_rendered_each_to_its_name(run, folder, renderer):
    shutil.copy("scene.toml", "other.toml")
    (folder / "out").mkdir()
    words = ["-o", "out/{stem}.png", "-o", "out/{stem}.exr", "--stats", "out/{stem}.json"]
    outcome = run("render", "scene.toml", "other.toml", "cube.npy", *words)
    assert outcome.status == 0
    names = {f"{stem}{ending}" for stem in ("scene", "other", "cube") for ending in (".png", ".exr", ".json")}
    assert {path.name for path in (folder / "out").iterdir()} == names
    assert outcome.out.split() == [
        f"out/{stem}{ending}" for stem in ("scene", "other", "cube") for ending in (".png", ".exr", ".json")
    ]


def test_one_failure_does_not_stop_the_others_and_the_worst_status_is_returned(run, folder, renderer):
    (folder / "bad.toml").write_text("version = 2\n")
    outcome = run("render", "bad.toml", "none.toml", "scene.toml", "-o", "{stem}.npy")
    assert outcome.status == 2 and (folder / "scene.npy").exists()
    assert outcome.err.count("clvol: error: ") == 2 and "bad.toml: version" in outcome.err
    renderer.failure = clvol.errors.RenderError("device", "lost")
    outcome = run("render", "bad.toml", "scene.toml", "-o", "{stem}.npy")
    assert outcome.status == 4 and outcome.err.splitlines()[-1] == "clvol: error: device: lost"


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["scene.toml", "cube.npy", "-o", "a.png"], "a.png: one name for 2 inputs, expected a name with {stem}"),
        (["scene.toml", "cube.npy", "-o", "-"], "-: one name for 2 inputs"),
        (["scene.toml", "cube.npy", "-o", "{stem}.png", "--stats", "s.json"], "s.json: one name for 2 inputs"),
        (["scene.toml", "./scene.toml", "-o", "{stem}.png"], "{stem}.png: scene.toml and ./scene.toml are both"),
    ],
)
def test_names_that_would_meet_are_refused_before_the_work(refused, nothing_left, renderer, words, line):
    assert refused(2, "render", *words).startswith(line)
    assert renderer.calls == []


def test_no_scene_is_overwritten_by_another(run, folder, renderer):
    np.save("picture.npy", np.zeros((2, 2, 2), np.uint8))
    outcome = run("render", "scene.toml", "picture.npy", "-o", "{stem}.npy")
    assert outcome.status == 2 and "picture.npy: is also an input" in outcome.err
    assert np.load("picture.npy").shape == (2, 2, 2)


def test_an_interrupt_ends_all(run, folder, renderer):
    renderer.failure = KeyboardInterrupt()
    assert run("render", "scene.toml", "cube.npy", "-o", "{stem}.png").status == 130
    assert len(renderer.calls) == 1


@pytest.mark.parametrize(
    ("path", "stem"),
    [("a/brain.nii.gz", "brain"), ("x.ome.zarr/", "x"), ("t_0.5.toml", "t_0.5"), ("v1.2", "v1.2"), ("a.exr", "a")],
)
def test_stems(path, stem):
    from clvol.batch.names import stem_of

    assert stem_of(path) == stem


# --- the scene that a picture carries


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("ending", ["exr", "png", "jpg"])
def test_a_picture_renders_again_to_the_same_bits_wherever_it_lies(run, folder, ending):
    (folder / "out").mkdir()
    assert run("render", "scene.toml", "-o", f"out/a.{ending}", "-o", "a.npy").status == 0
    os.chdir("/")
    outcome = run("render", folder / f"out/a.{ending}", "-o", folder / "b.npy")
    assert (outcome.status, outcome.err) == (0, "")
    assert np.array_equal(load_image(folder / "a.npy")["rgba"], load_image(folder / "b.npy")["rgba"])
    moved = folder / "moved"
    (folder / "out").rename(moved)
    moved.rename(folder / "deep")  # the volume is seen from the picture's folder as before
    assert run("info", folder / f"deep/a.{ending}").status == 0


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("scene", ["scene.toml", "cube.npy"])
def test_a_frame_of_an_animation_renders_again_of_a_chosen_scene_too(run, folder, scene):
    keys = ["image.width=24", "image.height=20", "animation.orbit_degrees=90", "animation.frames=3", "depth_cue={}"]
    words = [word for key in keys for word in ("--set", key)]
    assert run("render", scene, "-o", "f_%d.exr", *words).status == 0
    outcome = run("render", "f_2.exr", "-o", "again.exr")
    assert outcome.status == 0 and "warning" not in outcome.err
    first, again = load_image("f_2.exr"), load_image("again.exr")
    assert np.array_equal(first["rgba"], again["rgba"])
    assert not np.array_equal(load_image("f_0.exr")["rgba"], again["rgba"])
    run("render", "f_2.exr", "-o", "near.exr", "--set", "camera.fov_degrees=10")
    near = load_image("near.exr")["made_from"]["camera"]
    assert near["fov_degrees"] == 10 and near["position"] == again["made_from"]["camera"]["position"]


@pytest.mark.usefixtures("device")
def test_other_voxels_are_reported(run, folder):
    run("render", "scene.toml", "-o", "a.exr")
    np.save("cube.npy", np.load("cube.npy")[::-1])
    outcome = run("render", "a.exr", "-o", "b.npy")
    assert outcome.status == 0
    assert outcome.err == "clvol: warning: a.exr: made of other data than the picture shows: voxels\n"


def test_pictures_without_a_scene_are_refused(refused, folder):
    from PIL import Image

    Image.new("RGB", (3, 3)).save("plain.png")
    Image.new("RGB", (3, 3)).save("plain.jpg")
    (folder / "text.exr").write_text("no picture")
    assert refused(2, "render", "plain.png", "-o", "x.png").startswith("plain.png: carries no scene, expected a")
    assert refused(2, "render", "plain.jpg", "-o", "x.png").startswith("plain.jpg: carries no scene")
    assert refused(2, "render", "text.exr", "-o", "x.png").startswith("text.exr: the picture cannot be read")
    assert refused(2, "render", "none.exr", "-o", "x.png").startswith("none.exr: there is no such file")


def test_a_picture_of_an_array_asks_for_a_file(run, refused, folder):
    volume = clvol.Volume(np.load("cube.npy"))
    make_frame(clvol.Scene(volume=volume).resolve(), np.zeros((4, 4, 4)), None, {}, {}, []).save("array.exr")
    line = refused(2, "info", "array.exr")
    assert line.startswith("array.exr: volume.file: its voxels were passed as an array")
    assert run("info", "array.exr", "--set", 'volume.file="cube.npy"').status == 0


def test_the_scene_of_a_picture_is_only_data(run, refused, folder, picture):
    picture.scene_source = "__import__('os').system('touch owned')\n"
    picture.save("evil.exr")
    assert "expected a scene in TOML" in refused(2, "render", "evil.exr", "-o", "x.png")
    assert not (folder / "owned").exists()


@pytest.mark.usefixtures("device")
def test_a_picture_renders_again_in_python(run, folder):
    words = ["--set", "animation.frames=2", "--set", "animation.orbit_degrees=90"]
    assert run("render", "scene.toml", "-o", "f_%d.exr", *words).status == 0
    frame = clvol.render("f_1.exr")
    assert np.array_equal(frame.rgba, load_image("f_1.exr")["rgba"])
