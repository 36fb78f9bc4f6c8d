"""clvol init: a scene to go on from, which renders as the volume alone does."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.first_volumes import KINDS, solid

from clvol.opencl.devices import report_of
from clvol.scene import load_scene

SMALL = ("--set", "image.width=40", "--set", "image.height=32")


@pytest.fixture
def ball(folder):
    np.save(folder / "ball.npy", solid().data)
    return folder


def test_the_scene_renders_as_the_volume_does_bit_for_bit(run, ball, device):
    where = ("--device", report_of(device).name)
    assert run("init", "ball.npy", "-o", "s.toml", *SMALL).out == "s.toml\n"
    alone = run("render", "ball.npy", "-o", "a.npy", "--stats", "a.json", *SMALL, *where)
    again = run("render", "s.toml", "-o", "b.npy", "--stats", "b.json", *where)
    assert (alone.status, again.status) == (0, 0)
    assert np.array_equal(np.load("a.npy"), np.load("b.npy"))
    assert alone.err.startswith("chosen: object (brighter than what is around it") and alone.err.count("\n") == 1
    assert again.err == "" and "chosen" not in json.loads((ball / "b.json").read_text())
    chosen = json.loads((ball / "a.json").read_text())["chosen"]
    assert chosen["kind"] == "object" and chosen["in_words"] + "\n" == alone.err
    assert run("render", "ball.npy", "-o", "c.npy", "--quiet", *SMALL, *where).err == ""


def test_the_scene_is_complete_and_each_key_is_explained(run, ball):
    run("init", "ball.npy", "-o", "s.toml", "--set", "image.width=70")
    text = (ball / "s.toml").read_text()
    assert 'file = "ball.npy"' in text and "width = 70 " in text
    for table in ("volume", "camera", "image", "transfer_function", "integration", "material", "[light]"):
        assert f"[{table}]" in text
    others = ("#", " ", "points", "version")
    keys = [line for line in text.splitlines() if " = " in line and not line.startswith(others)]
    assert len(keys) > 15 and all("  # " in line for line in keys)
    assert load_scene("s.toml").completed().chosen is None


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_reads_back_as_it_was_chosen(run, folder, kind):
    volume = KINDS[kind]()
    np.save(folder / "v.npy", volume.data)
    assert run("init", "v.npy", "-o", "s.toml").status == 0
    written, chosen = load_scene("s.toml").resolve(), load_scene("v.npy").resolve()
    assert written.transfer_function == chosen.transfer_function and written.camera == chosen.camera
    assert written.lights == chosen.lights and written.material == chosen.material
    assert written.integration == chosen.integration


def test_the_volume_is_named_from_the_scene_s_folder(run, ball):
    (ball / "deep").mkdir()
    assert run("init", "ball.npy", "-o", "deep/s.toml").status == 0
    assert 'file = "../ball.npy"' in (ball / "deep" / "s.toml").read_text()
    assert load_scene("deep/s.toml").load_volume().shape == (40, 40, 40)


def test_a_preset_instead(run, ball):
    outcome = run("init", "ball.npy", "-o", "s.toml", "--preset", "micro-ct")
    assert "preset micro-ct" in outcome.err
    assert "# Preset micro-ct, for micro-CT" in (ball / "s.toml").read_text()


@pytest.mark.parametrize(("words", "said"), [
    (("ball.npy", "-o", "s.txt"), "--output: got 's.txt', expected a file name that ends in .toml"),
    (("none.npy", "-o", "s.toml"), "none.npy"),
    (("ball.npy", "-o", "nowhere/s.toml"), "nowhere"),
    (("ball.npy", "-o", "s.toml", "--preset", "ct-bones"), "ball.npy: transfer_function.preset: got 'ct-bones'"),
    (("scene.toml", "-o", "scene.toml"), "scene.toml"),
])  # fmt: skip
def test_what_cannot_be_written_is_refused_and_nothing_is_left(refused, ball, nothing_left, words, said):
    assert said in refused(2, "init", *words)
