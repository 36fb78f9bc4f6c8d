"""Colours by name and as hex, wherever a colour is taken."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

import clvol
from clvol.errors import SceneError
from clvol.scene import load_scene
from clvol.transfer import TransferFunction, srgb_to_linear
from clvol.transfer.color_names import NamedColor, parse_color

VOLUME = '[volume]\nfield = "constant"\nsize = [2, 2, 2]\n'


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("red", (1, 0, 0)),
        (" SteelBlue ", (70 / 255, 130 / 255, 180 / 255)),
        ("#f80", (1, 136 / 255, 0)),
        ("#FF8800", (1, 136 / 255, 0)),
        ("tab:blue", (31 / 255, 119 / 255, 180 / 255)),
    ],
)
def test_names_and_hex_are_srgb_colours(text, expected):
    assert parse_color(text) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("text", ["", "rad", "#12", "#12345678", "tab:bloe", "rgb(1, 2, 3)", "x" * 1000, "#ggg"])
def test_what_names_no_colour_is_refused(text):
    with pytest.raises(ValueError, match="a colour name"):
        parse_color(text)


def test_a_transfer_function_takes_names_beside_numbers():
    function = TransferFunction([0, 1, 2], [0, 0, 1], ["#808080", (0.25, 0.5, 0.75), "white"])
    assert np.array_equal(function.colors, [[srgb_to_linear(128 / 255)] * 3, [0.25, 0.5, 0.75], [1, 1, 1]])
    with pytest.raises(SceneError, match=r"colors\.1: got 'blu', expected .* \(did you mean 'blue'\?\)"):
        TransferFunction([0, 1], [0, 1], ["red", "blu"])


@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_every_key_takes_a_name_whose_colour_does_not_depend_on_color_space(tmp_path, space):
    path = tmp_path / "scene.toml"
    path.write_text(
        f"""{VOLUME}
[transfer_function]
color_space = "{space}"
points = [{{ value = 0, opacity = 0, color = "#808080" }}, {{ value = 1, opacity = 1, color = [0.5, 0.5, 0.5] }}]
[image]
background = "#808080"
[depth_cue]
color = "#808080"
[[isosurface]]
value = 1
color = "#808080"
[[light]]
type = "headlight"
color = "#808080"
[shadow]
scatter_color = "#808080"
""",
        encoding="utf-8",
    )
    scene = load_scene(path)
    resolved = scene.resolve()
    grey = np.full(3, srgb_to_linear(128 / 255))
    number = 0.5 if space == "linear" else srgb_to_linear(0.5)
    assert np.array_equal(resolved.transfer_function.colors, [grey, [number] * 3])
    for color in (
        resolved.background, resolved.depth_cue.color, resolved.isosurfaces[0].color, resolved.lights[0].color,
        resolved.shadow.scatter_color,
    ):  # fmt: skip
        assert np.array_equal(color, grey)
    assert scene.to_toml().count('"#808080"') == 6


def test_a_scene_that_is_written_reads_back_the_same(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(VOLUME + '[image]\nbackground = "navy"\n[transfer_function]\ncolor_space = "linear"\n', "utf-8")
    first = load_scene(path)
    path.write_text(first.to_toml(), encoding="utf-8")
    assert np.array_equal(load_scene(path).resolve().background, first.resolve().background)
    assert first.model_copy(update={"image": first.image.model_copy(update={"width": 9})}).image.background == (
        0, 0, 128 / 255
    )  # fmt: skip


def test_the_error_names_the_key_and_the_nearest_colour():
    with pytest.raises(SceneError, match=r"light\.color: got 'yelow', expected .*did you mean 'yellow'"):
        clvol.Light(type="headlight", color="yelow")


@pytest.mark.parametrize("linear", [False, True])
def test_a_named_colour_survives_copies(linear):
    color = NamedColor("orange", linear)
    for other in (copy.deepcopy(color), pickle.loads(pickle.dumps(color))):
        assert (other, other.text, other.is_linear) == (color, "orange", linear)
