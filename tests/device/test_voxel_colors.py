"""Volumes of colours: RGB and RGBA voxels show their own colours, and are classified by one value of them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import blobs, oblique, picture, scene
from reference import render_twin

from clvol import Scene, TransferFunction, Volume
from clvol.device.voxel_colors import BLUE, RED_GREEN, linear_light, packed_colors
from clvol.errors import SceneError, VolumeError
from clvol.explanation import kernel_hash
from clvol.features import called_for, reduced
from clvol.render.isolation.scene_message import decoded, encoded
from clvol.scene.channel_scenes import channel_scenes

SHAPE = (13, 15, 17)
VEIL = TransferFunction([20.0, 220.0], [0.0, 0.3], [[0.0, 0.0, 0.0]] * 2)
PACKED = 6e-4  # error of a colour by packing


def colors(dtype=np.uint8, alpha: bool = False) -> np.ndarray:
    top = 1.0 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    parts = [blobs(SHAPE, seed, top, dtype) for seed in (1, 2, 3, 4)[: 3 + alpha]]
    return np.stack(parts, axis=-1)


def made(volume, function=VEIL, **tables):
    return scene(volume, function, camera=oblique(SHAPE), **tables)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_packing_is_finer_than_eight_encoded_bits(dtype):
    volume = Volume.from_colors(colors(dtype))
    words = packed_colors(volume.colors)
    for part, levels, shift in zip(volume.colors.channels, (RED_GREEN, RED_GREEN, BLUE), (0, 11, 22)):
        found = ((words >> shift & levels) / levels) ** 2
        assert abs(np.sqrt(found) - np.sqrt(linear_light(part))).max() <= 0.5 / levels + 1e-6


@pytest.mark.every_case
@pytest.mark.parametrize("value", ["luminance", "brightness"])
def test_a_colored_volume_is_the_twins(context, value):
    resolved = reduced(made(Volume.from_colors(colors(), value)))
    assert "color field" in called_for(resolved)
    data = picture(context, resolved)
    np.testing.assert_allclose(data.rgba, render_twin(resolved), atol=PACKED)
    assert np.ptp(data.rgba[..., :3], axis=-1).max() > 0.1
    assert data.counters["field_samples"] > 0


def test_other_devices_show_the_same_colors(other_device, contexts):
    resolved = reduced(made(Volume.from_colors(colors())))
    np.testing.assert_allclose(picture(contexts(other_device), resolved).rgba, render_twin(resolved), atol=PACKED)


def test_one_color_everywhere_is_that_of_a_function(context):
    values = blobs(SHAPE, 5, 255, np.uint8)
    stated = np.broadcast_to(np.array([255, 128, 0], np.uint8), (*SHAPE, 3))
    field = {"file": Volume.from_colors(stated), "role": "color"}
    orange = TransferFunction(VEIL.values, VEIL.opacities, ["#ff8000"] * 2)
    one = picture(context, reduced(made(values, field=[field]))).rgba
    np.testing.assert_allclose(one, picture(context, reduced(made(values, orange))).rgba, atol=PACKED)


@pytest.mark.slow
def test_colors_of_another_grid_are_of_a_place_in_the_world(context):
    halves = np.zeros((2, 2, 4, 3), np.uint8)
    halves[..., :2, 0], halves[..., 2:, 2] = 255, 255
    grid = {"spacing": (6.0, 40.0, 40.0), "origin": (-1.0, -10.0, -10.0)}
    field = {"file": Volume.from_colors(halves, **grid), "role": "color"}
    resolved = reduced(made(blobs(SHAPE, 5, 255, np.uint8), field=[field]))
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=PACKED)


def test_transparent_voxels_do_not_darken_their_neighbours():
    rgba = np.zeros((5, 5, 5, 4), np.uint8)
    rgba[2, 2, 2] = 255, 200, 100, 255
    words = packed_colors(Volume.from_colors(rgba, "alpha").colors)
    assert (words[1:4, 1:4, 1:4] == words[2, 2, 2]).all() and words[0, 0, 0] == 0


def test_alpha_is_the_value(context):
    rgba = colors(alpha=True)
    volume = Volume.from_colors(rgba, "alpha")
    assert np.array_equal(volume.data, rgba[..., 3]) and volume.colors.alpha is not None
    resolved = reduced(made(volume))
    assert abs(picture(context, resolved).rgba).max() > 0.1


def test_a_volume_of_colors_that_shows_nothing_calls_for_none():
    clear = TransferFunction([0.0], [0.0], [[0.0, 0.0, 0.0]])
    colored, plain = (made(v, clear) for v in (Volume.from_colors(colors()), Volume(colors()[..., 0])))
    assert "color field" not in called_for(colored) and kernel_hash(colored) == kernel_hash(plain)


def test_colors_reach_another_process():
    resolved = made(Volume.from_colors(colors()))
    numbers = {id(volume): k for k, volume in enumerate(resolved.volumes)}
    assert len(numbers) == 4
    sent = encoded(resolved, lambda volume: numbers[id(volume)])
    again = decoded(sent, dict(enumerate(resolved.volumes)))
    assert again.fields[0].colors_of_voxels.green is resolved.fields[0].colors_of_voxels.green


def test_a_tiff_of_colors_shows_them_unasked(tmp_path):
    import tifffile

    path = tmp_path / "slices.tif"
    tifffile.imwrite(path, colors(), photometric="rgb")
    scene_of_file = Scene(volume=path)
    resolved = scene_of_file.resolve()
    assert [field.role for field in resolved.fields] == ["color"] and not resolved.channels
    luma = colors().astype(float) @ (0.2126, 0.7152, 0.0722)
    assert abs(resolved.volume.data - luma).max() <= 0.5 + 1e-9
    assert 'color = "luminance"' in scene_of_file.completed().to_toml()
    assert len(channel_scenes(resolved)) == 1
    tifffile.imwrite(path, colors(alpha=True), photometric="rgb", extrasamples=["unassalpha"])
    assert 'color = "alpha"' in Scene(volume=path).completed().to_toml()


def test_what_has_no_colors_is_refused(tmp_path):
    import tifffile

    path = tmp_path / "grey.tif"
    tifffile.imwrite(path, colors()[..., 0])
    with pytest.raises(VolumeError, match="one value per voxel, expected red, green and blue"):
        Scene(volume={"file": str(path), "color": "luminance"}).resolve()
    with pytest.raises(SceneError, match="either channel or color"):
        Scene(volume={"file": str(path), "color": "luminance", "channel": 0})
    with pytest.raises(VolumeError, match="shape .* expected an array"):
        Volume.from_colors(np.zeros((3, 3, 3)))
    with pytest.raises(VolumeError, match="without alpha"):
        Volume.from_colors(colors(), "alpha")
    with pytest.raises(SceneError, match="one value per voxel for the role 'color'"):
        made(colors()[..., 0], field=[{"file": Volume(colors()[..., 0]), "role": "color"}])
