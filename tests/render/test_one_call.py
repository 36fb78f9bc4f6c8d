"""clvol.render(x, ...): a picture in one call, and errors of the Python interface that say what to write."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import clvol
from clvol.errors import SceneError, UsageError, VolumeError

SMALL = {"width": 20, "height": 16}
FUNCTION = {"preset": "grayscale"}


@pytest.fixture(scope="module")
def voxels():
    array = np.zeros((6, 7, 8), np.uint8)
    array[2:5, 2:5, 2:6] = 200
    return array


def test_everything_that_is_a_volume_gives_the_same_picture(device, voxels, tmp_path):
    keys = {"image": SMALL, "transfer_function": FUNCTION, "devices": [device]}
    scene = clvol.Scene(volume=clvol.Volume(voxels), image=SMALL, transfer_function=FUNCTION)
    with clvol.Renderer(scene, devices=[device]) as renderer:
        expected = renderer.render()
        by_dict = renderer.render(camera={"projection": "orthographic"})
        by_object = renderer.render(camera=clvol.Camera(projection="orthographic"))
    assert np.array_equal(by_dict.rgba, by_object.rgba) and not np.array_equal(by_dict.rgba, expected.rgba)
    np.save(tmp_path / "a.npy", voxels)
    (tmp_path / "s.toml").write_text('[volume]\nfile = "a.npy"\n[image]\nwidth = 9\nheight = 16\n')
    for x, more in (
        (voxels, keys),
        (clvol.Volume(voxels), keys),
        (tmp_path / "a.npy", keys),
        (str(tmp_path / "s.toml"), {**keys, "image": {"width": 20}}),
        (scene, {"devices": [device]}),
    ):
        assert np.array_equal(clvol.render(x, **more).rgba, expected.rgba)
    assert clvol.render(scene, devices=[device], depth=False).depth is None


@pytest.mark.parametrize(
    "first", ["", "from clvol.render import Renderer", "import clvol.render.frame", "from clvol import Frame"]
)
def test_render_is_callable_whatever_was_imported_first(first):
    code = f"import clvol\n{first}\nassert callable(clvol.render)\nfrom clvol import render\nassert callable(render)"
    assert subprocess.run([sys.executable, "-c", code], timeout=300).returncode == 0


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda v: clvol.Scene(v), SceneError, r"expected keywords: clvol\.Scene\(volume=…\)"),
        (lambda v: clvol.Scene({"volume": 1}), SceneError, r"expected keywords: clvol\.Scene\(\*\*table\)"),
        (lambda v: clvol.Camera((1, 2, 3)), SceneError, r"clvol\.Camera: got \[1, 2, 3\] by position"),
        (lambda v: clvol.Scene(volume=3), SceneError, "volume: got 3, expected a table"),
        (lambda v: clvol.Scene(volume=v.data), SceneError, r"volume: got an array of .*clvol\.Volume\(array, "),
        (lambda v: clvol.Renderer(v), UsageError, r"got a Volume, expected a scene: clvol\.Scene\(volume=…\)"),
        (lambda v: clvol.Renderer("a.toml"), UsageError, r"clvol\.load_scene\('a\.toml'\)"),
        (lambda v: clvol.Renderer({}), UsageError, r"clvol\.Scene\(\*\*tables\)"),
        (lambda v: clvol.render({}), UsageError, r"clvol\.render\(clvol\.Scene\(\*\*tables\)\)"),
        (lambda v: clvol.render(None), VolumeError, "None, expected an array"),
        (lambda v: clvol.render(v, images={}), UsageError, r"unknown keyword images, .*did you mean 'image'\?"),
        (lambda v: clvol.render(v, volume={}), UsageError, "either voxels or volume"),
        (lambda v: clvol.render(v, camera=3), SceneError, "camera: got 3, expected a table"),
        (lambda v: clvol.render(v, image={"wide": 3}), SceneError, r"image\.wide: unknown key"),
        (lambda v: clvol.render("none.nrrd"), (SceneError, VolumeError), "none.nrrd"),
    ],
)
def test_errors_say_what_to_write_instead(voxels, call, error, message):
    with pytest.raises(error, match=message) as caught:
        call(clvol.Volume(voxels))
    assert "\n" not in str(caught.value)


def test_a_camera_takes_the_place_of_that_of_a_picture(device, voxels, tmp_path):
    np.save(tmp_path / "a.npy", voxels)
    keys = {"image": SMALL, "transfer_function": FUNCTION, "devices": [device]}
    clvol.render(tmp_path / "a.npy", camera={"projection": "orthographic"}, **keys).save(tmp_path / "p.exr")
    again = clvol.render(tmp_path / "p.exr", camera={"projection": "perspective"}, devices=[device])
    assert np.array_equal(again.rgba, clvol.render(tmp_path / "a.npy", **keys).rgba)
