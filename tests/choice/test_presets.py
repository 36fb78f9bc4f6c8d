"""Presets that are files: each is placed on the volume, brings its technique, and says where it does not fit."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.first_volumes import KINDS, hounsfield, solid

import clvol
from clvol.errors import SceneError
from clvol.features.scene_warnings import scene_warnings
from clvol.scene.preset_file import load_preset, preset_folder, preset_names
from clvol.transfer import preset

NAMES = (
    "cryo-em", "ct-angiography", "ct-bone", "ct-lung", "ct-soft-tissue", "ct-tissue", "density", "flow", "fluorescence",
    "light-sheet", "micro-ct", "mr-angiography", "mr-brain",
)  # fmt: skip
OWN = """
summary = "mine"
expects = "anything"
scale = "relative"
points = [{ at = 0.0, opacity = 0.0, color = [0, 0, 1] }, { at = 0.5, opacity = 0.75, color = [1, 0, 0] }]
[material]
ambient = 0.5
"""


def test_all_presets_are_there():
    assert preset_names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_preset_is_valid_and_suits_the_data_that_it_names(name, tmp_path):
    loaded = load_preset(name, tmp_path, "scene")
    assert loaded.summary.endswith(".") and loaded.expects and loaded.kinds
    volume = hounsfield() if loaded.scale == "hounsfield" else KINDS[loaded.kinds[0]]()
    scene = clvol.Scene(volume=volume, transfer_function={"preset": name})
    resolved = scene.resolve()
    assert resolved.integration.filter == "cubic" and len(resolved.lights) == 2
    assert resolved.chosen["preset"] == name and "warning" not in resolved.chosen
    assert not [w for w in scene_warnings(resolved) if w.where == "transfer_function.preset"]
    values = np.linspace(*volume.value_range, 500)
    assert resolved.transfer_function.opacity(values).max() > 0.05


@pytest.mark.parametrize("offset", [0, 1000])
def test_hounsfield_presets_follow_an_offset_in_the_data(offset):
    volume = hounsfield(offset, np.uint16 if offset else np.int16)
    function = clvol.Scene(volume=volume, transfer_function={"preset": "ct-bone"}).resolve().transfer_function
    plain = preset("ct-bone", volume.value_range)
    assert function.values.tolist() == (plain.values + offset).tolist()
    assert function.opacities.tolist() == plain.opacities.tolist()


@pytest.mark.parametrize(("name", "volume"), [
    ("ct-lung", solid), ("ct-angiography", KINDS["vessels"]), ("mr-brain", hounsfield),
    ("fluorescence", KINDS["labels"]), ("flow", KINDS["mask"]), ("cryo-em", KINDS["microscopy"]),
])  # fmt: skip
def test_other_data_are_warned_of(name, volume):
    resolved = clvol.Scene(volume=volume(), transfer_function={"preset": name}).resolve()
    (warning,) = (w for w in scene_warnings(resolved) if w.where == "transfer_function.preset")
    assert repr(name) in warning.what


def test_a_preset_s_technique_gives_way_to_what_the_scene_states():
    scene = clvol.Scene(
        volume=solid(), transfer_function={"preset": "micro-ct", "opacity_unit": 7.0}, light=[{"type": "headlight"}],
        integration={"filter": "linear"}, material={"ambient": 0.9}, camera={"position": (90.0, 1.0, 2.0)},
    )  # fmt: skip
    resolved = scene.resolve()
    assert resolved.transfer_function.opacity_unit == 7.0 and len(resolved.lights) == 1
    assert resolved.integration.filter == "linear" and resolved.material.ambient == 0.9
    assert resolved.camera.position == (90.0, 1.0, 2.0)


def test_a_preset_of_one_s_own_is_a_file_beside_the_scene(tmp_path):
    (tmp_path / "mine.toml").write_text(OWN)
    np.save(tmp_path / "a.npy", solid().data)
    (tmp_path / "s.toml").write_text(
        'version = 1\n[volume]\nfile = "a.npy"\n[transfer_function]\npreset = "mine.toml"\n'
    )
    resolved = clvol.load_scene(tmp_path / "s.toml").resolve()
    low, high = resolved.volume.value_range
    assert resolved.transfer_function.values.tolist() == [low, 0.5 * (low + high)]
    assert resolved.material.ambient == 0.5


@pytest.mark.parametrize(("text", "where", "what"), [
    (OWN.replace("summary", "sumary"), "sumary", "unknown key"),
    (OWN.replace('"relative"', '"absolute"'), "scale", "'absolute'"),
    (OWN.replace("at = 0.5", "at = -1.0"), "points.1.at", "-1.0"),
    (OWN.replace("ambient = 0.5", "ambient = 5"), "material.ambient", "5"),
    ("points = [", "mine.toml", "cannot be read"),
])  # fmt: skip
def test_mistakes_in_a_preset_name_file_and_key(tmp_path, text, where, what):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(SceneError) as caught:
        load_preset("mine.toml", tmp_path, "scene")
    assert "mine.toml" in caught.value.where and where in caught.value.where and what in caught.value.what


def test_an_unknown_preset_is_refused_with_all_names(tmp_path):
    with pytest.raises(SceneError, match=r"got 'ct-bones', expected .*'mr-brain'.*did you mean 'ct-bone'"):
        clvol.Scene(volume=solid(), transfer_function={"preset": "ct-bones"})
    with pytest.raises(SceneError, match="none.toml', no such file"):
        clvol.Scene(volume=solid(), transfer_function={"preset": "none.toml"}).resolve()
    assert preset_folder() is not None
