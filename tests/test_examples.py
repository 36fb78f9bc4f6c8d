"""Every example of data/examples does what it says, at a small size."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from clvol.cli import main
from clvol.image import load_image
from clvol.scene import load_scene

EXAMPLES = Path(__file__).resolve().parents[1] / "data" / "examples"
SCENES = sorted(path.stem for path in EXAMPLES.glob("*.toml"))
SMALL = ["--set", "image.width=40", "--set", "image.height=32", "--quiet"]
# What each scene shows: (table, what it holds).
SHOWS = {
    "transfer_function": lambda scene: len(scene.transfer_function.points) > 4,
    "lights": lambda scene: len(scene.light) > 1,
    "isosurface": lambda scene: len(scene.isosurface) > 1,
    "clip": lambda scene: len(scene.clip) > 1,
    "shadows": lambda scene: scene.shadow.scattering > 0,
    "slicing": lambda scene: scene.slicing.is_half_angle,
    "blocks": lambda scene: scene.integration.method == "multiresolution",
    "compression": lambda scene: scene.compression.is_lossy and scene.compression.stated,
    "pyramid": lambda scene: scene.integration.method == "pyramid",
    "projection": lambda scene: scene.integration.compositing != "over",
    "channels": lambda scene: len(scene.channel) > 1,
    "labels": lambda scene: scene.field[0].role == "label",
    "animation": lambda scene: scene.animation.frames > 1,
    "edges": lambda scene: scene.image.refines,
    "keyframes": lambda scene: len(scene.animation.keyframe) > 1,
    "overlay": lambda scene: scene.overlay.scale_bar and scene.overlay.color_bar,
}


def test_there_are_sixteen_scenes_and_five_scripts():
    assert set(SCENES) == set(SHOWS)
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {
        "render_array", "render_to_error", "compare_steps", "labels", "series"
    }  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_shows_its_effect_and_names_the_schema(name):
    path = EXAMPLES / f"{name}.toml"
    assert path.read_text(encoding="utf-8").startswith("#:schema ../scene.schema.json\n# ")
    assert SHOWS[name](load_scene(path))


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_rendered_without_warnings(name, tmp_path, capfd):
    moves = name in ("animation", "keyframes")
    file = "a_%d.npy" if moves else "a.npy"
    few = ["--set", "animation.frames=2"] if moves else []
    assert main(["render", str(EXAMPLES / f"{name}.toml"), "-o", str(tmp_path / file), *SMALL, *few]) == 0
    assert capfd.readouterr().err == ""
    pictures = [load_image(path)["rgba"] for path in sorted(tmp_path.glob("*.npy"))]
    assert len(pictures) == 1 + moves
    for rgba in pictures:
        assert rgba.shape == (32, 40, 4) and np.isfinite(rgba).all()
        assert 0.05 < (rgba[..., 3] > 0.1).mean() <= 1.0
        assert np.ptp(rgba[..., :3]) > 0.1
    if len(pictures) > 1:
        assert not np.array_equal(*pictures)


def script(name: str) -> dict:
    return runpy.run_path(str(EXAMPLES / f"{name}.py"))


def test_the_script_that_renders_an_array(tmp_path):
    frame = script("render_array")["main"](str(tmp_path / "a.png"), 32)
    assert frame.rgba.shape == (32, 32, 4) and frame.rgba[..., 3].max() > 0.5
    assert (tmp_path / "a.png").is_file()


def test_the_script_that_renders_to_an_error(tmp_path):
    frame = script("render_to_error")["main"](str(tmp_path / "a.png"), 32, 1e-2)
    assert frame.stats["accuracy"]["bound"] <= 1e-2 and (tmp_path / "a.png").is_file()


def test_the_script_that_compares_steps():
    rows = script("compare_steps")["main"](24)
    errors = [error for _, error, _ in rows]
    assert errors == sorted(errors, reverse=True) and errors[-1] < 0.01


def test_the_script_that_writes_a_series(tmp_path, capfd):
    scene = script("series")["main"](str(tmp_path / "s"), 3, 16)
    assert main(["render", str(scene), "-o", str(tmp_path / "a_%d.npy"), *SMALL]) == 0
    assert capfd.readouterr().err == ""
    pictures = [load_image(path)["rgba"] for path in sorted(tmp_path.glob("*.npy"))]
    assert len(pictures) == 3 and all((rgba[..., 3] > 0.1).any() for rgba in pictures)
    assert not np.array_equal(pictures[0], pictures[2])


def test_the_labels_are_what_their_script_writes():
    import clvol

    written = clvol.load_volume(EXAMPLES / "labels.nrrd")
    assert np.array_equal(written.data, script("labels")["labels"]())


def test_a_script_runs_by_itself(tmp_path):
    words = [sys.executable, str(EXAMPLES / "render_array.py"), str(tmp_path / "a.png"), "24"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "million samples" in done.stdout


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("jobs/*.toml")), ids=lambda path: path.stem)
def test_a_job_is_rendered(path, tmp_path, capfd):
    """As a user's own, with files elsewhere and small."""
    text = path.read_text(encoding="utf-8").replace("../../../out", str(tmp_path))
    text = text.replace("../../brainsmall.nrrd", str(EXAMPLES.parent / "brainsmall.nrrd")).replace("256", "32")
    (tmp_path / "job.toml").write_text(text, encoding="utf-8")
    assert main(["batch", str(tmp_path / "job.toml"), "--quiet"]) == 0
    told = capfd.readouterr()
    assert told.err == "" and told.out.count('"status": "rendered"') == 9
    assert len(list(tmp_path.rglob("*.png"))) == 9
