"""Errors against the integral over each pixel: the truth itself, and pictures that hold an error against it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import axis_camera

from clvol import Scene, TransferFunction, Volume
from clvol.accuracy.error_target import render_to_error
from clvol.accuracy.pixel_area import integrate_pixels
from clvol.accuracy.settings import canonical, scene_settings, scene_tunables
from clvol.errors import RenderError, SceneError
from clvol.integrators.reference.picture import render_reference

EDGE = TransferFunction([100.0, 101.0], [0.0, 0.9], [[1.0, 0.5, 0.2], [1.0, 0.5, 0.2]])


def ball(n: int = 16) -> np.ndarray:
    z, y, x = np.meshgrid(*3 * [np.arange(n) - (n - 1) / 2], indexing="ij")
    return (100.0 + 30.0 * (0.36 * n - np.sqrt(x * x + y * y + z * z))).astype(np.float32)


def scene(size: int = 10, **image) -> Scene:
    view = axis_camera((7.5, 7.5, 7.5), axis=2, height=15.0)
    return Scene(volume=Volume(ball()), transfer_function=EDGE, camera=view,
                 image={"width": size, "height": size, **image})  # fmt: skip


def of_many_rays(device) -> np.ndarray:
    """The scene's pixels, as means of 16 by 16 rays."""
    rgba = render_reference(scene(10 * 16).resolve(), [device], 1e-6)[0]
    return rgba.reshape(10, 16, 10, 16, 4).mean(axis=(1, 3))


def test_the_truth_of_a_pixel_is_the_mean_over_it(device):
    resolved = scene().resolve()
    pixels = np.stack(np.meshgrid(np.arange(5), np.arange(10), indexing="ij"), axis=-1).reshape(-1, 2)
    found, counters = integrate_pixels(resolved, [device], 1e-6, pixels, 1e-3)
    many = of_many_rays(device)
    difference = found - many[pixels[:, 0], pixels[:, 1]]
    assert np.sqrt(np.mean(difference**2)) < 5e-3 and np.abs(difference).max() < 0.05
    assert 25 * len(pixels) <= counters["rays"] < 225 * len(pixels)
    one = render_reference(resolved, [device], 1e-6, pixels)[0]
    assert np.sqrt(np.mean((one - many[pixels[:, 0], pixels[:, 1]]) ** 2)) > 3e-2


@pytest.mark.slow  # a search for settings
def test_a_picture_holds_its_error_over_pixels(device):
    frame = render_to_error(scene(), 0.02, devices=[device], pixel_area=True)
    accuracy = frame.stats["accuracy"]
    assert np.sqrt(np.mean((frame.rgba - of_many_rays(device)) ** 2)) <= 0.02
    assert accuracy["of"] == "pixel areas" and accuracy["bound"] <= 0.02
    assert accuracy["settings"]["image.samples"] > 1
    assert "over each pixel" in accuracy["how"]
    plain = render_to_error(scene(), 0.02, devices=[device])
    assert plain.stats["accuracy"]["of"] == "pixel centres" and plain.stats["rays"] <= 100
    with pytest.raises(RenderError, match="16 rays per pixel at most"):
        render_to_error(scene(), 1e-7, devices=[device], pixel_area=True)


def test_rays_per_pixel_are_tried_only_where_pixels_are_areas():
    resolved = scene().resolve()
    assert not {"image.samples", "image.edge_threshold"} & scene_tunables(resolved).keys()
    tunables = scene_tunables(resolved, area=True)
    assert tunables["image.samples"].values == (1, 2, 4, 8, 16)
    assert tunables["image.edge_threshold"].values[-1] == 0.0
    settings = {**scene_settings(resolved, tunables), "image.edge_threshold": 0.3}
    assert canonical(resolved, tunables, settings)["image.edge_threshold"] == 0.02  # one ray: it has no effect
    assert canonical(resolved, tunables, {**settings, "image.samples": 4})["image.edge_threshold"] == 0.3


def test_another_filter_than_the_mean_over_a_pixel_is_refused(device):
    with pytest.raises(SceneError, match="image.pixel_filter: got 'tent'.*expected 'box'"):
        render_to_error(scene(pixel_filter="tent"), 0.1, devices=[device], pixel_area=True)
