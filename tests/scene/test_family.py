"""Scenes that are loaded one after another are those that are loaded alone."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.errors import SceneError
from clvol.features.analysis import analysis_of, called_for, differs_in_view
from clvol.scene import load_scene
from clvol.scene.family import SceneFamily
from clvol.scene.same_value import is_same

SETTINGS = [
    (),
    (("camera.position", [30.0, 20.0, -40.0]),),
    (("camera.position", [30, 20, -40]),),  # whole numbers, which the scene's text has as well
    (("camera.position", [-0.0, 20.0, -40.0]),),
    (("camera.position", [0.0, 20.0, -40.0]),),
    (("transfer_function.opacity_unit", 2.0),),
    (("light.0.type", "headlight"), ("integration.step", 0.5)),
    (("integration.step", 0.5), ("overlay.box", True)),
    (("image.background", [0.25, 0.5, 1.0]),),
    (("depth_cue.color", [0.0, 0.0, 0.0]), ("depth_cue.start", 1.0), ("depth_cue.end", 50.0)),
    (("camera.position", [1.0, 2.0, -40.0]), ("clip.0.normal", [1.0, 0.0, 0.0]), ("clip.0.point", [3.0, 0.0, 0.0])),
]


@pytest.fixture(scope="module")
def scene_file(tmp_path_factory):
    folder = tmp_path_factory.mktemp("family")
    np.save(folder / "ramp.npy", np.arange(9 * 10 * 11, dtype=np.float32).reshape(9, 10, 11))
    (folder / "scene.toml").write_text(
        'version = 1\n[volume]\nfile = "ramp.npy"\n[camera]\nposition = [3.0, 4.0, -30.0]\n[image]\nwidth = 40\n'
        "[transfer_function]\npoints = [{ value = 0.0, opacity = 0.0, color = [1.0, 0.0, 0.0] },\n"
        "{ value = 900.0, opacity = 0.5, color = [0.0, 1.0, 0.0] }]\n"
    )
    return str(folder / "scene.toml")


def test_each_scene_is_the_one_that_is_loaded_alone(scene_file):
    family = SceneFamily()
    for settings in [*SETTINGS, *SETTINGS[::-1]]:
        found = family.resolve(family.load(scene_file, settings=settings))
        alone = load_scene(scene_file, settings=settings).resolve()
        assert found.source == alone.source
        parts = [(name, part) for name, part in vars(alone).items() if name != "volume"]
        assert all(is_same(getattr(found, name), part) for name, part in parts)
        np.testing.assert_array_equal(found.volume.data, alone.volume.data)
        assert called_for(found) == called_for(alone)
        for reduced in ("reduced", "for_frames"):
            one, other = getattr(analysis_of(found), reduced), getattr(analysis_of(alone), reduced)
            assert (one is None) == (other is None)
            if other is not None:
                assert all(is_same(getattr(one, name), getattr(other, name)) for name, _ in parts)


def test_what_scenes_have_in_common_is_the_same_object(scene_file):
    family = SceneFamily()
    first = family.resolve(family.load(scene_file))
    second = family.resolve(family.load(scene_file, settings=SETTINGS[1]))
    different = {name for name, part in vars(first).items() if getattr(second, name) is not part}
    assert different == {"camera", "source"} and differs_in_view(second, first)
    third = family.resolve(family.load(scene_file, settings=SETTINGS[5]))
    assert not differs_in_view(third, second) and third.volume is first.volume


def test_a_depth_cue_is_judged_from_every_camera(scene_file):
    family = SceneFamily()
    cue = SETTINGS[9]
    first = family.resolve(family.load(scene_file, settings=cue))
    second = family.resolve(family.load(scene_file, settings=(*cue, *SETTINGS[1])))
    assert not differs_in_view(second, first)


def test_a_scene_that_is_wrong_does_not_change_the_next_one(scene_file):
    family = SceneFamily()
    family.resolve(family.load(scene_file))
    with pytest.raises(SceneError, match="integration.step"):
        family.load(scene_file, settings=(("integration.step", -1.0), ("camera.position", [1.0, 1.0, 1.0])))
    again = family.resolve(family.load(scene_file, settings=SETTINGS[1]))
    assert is_same(again.camera, load_scene(scene_file, settings=SETTINGS[1]).resolve().camera)


@pytest.mark.parametrize(
    "one, other",
    [(1, 1.0), (True, 1), (0.0, -0.0), ([1], (1,)), ({"a": 1, "b": 2}, {"b": 2, "a": 1}), ("1", 1),
     (np.zeros(2), np.zeros(2, np.float32)), (object(), object())],
)  # fmt: skip
def test_values_that_are_not_the_same(one, other):
    assert not is_same(one, other) and is_same(one, one) and is_same(other, other)
