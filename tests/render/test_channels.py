"""Several values per voxel: channels with colours of their own, blended as pictures or mixed as one medium."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.effect_scenes import blobs, oblique
from reference import render_twin
from reference.channels import render_channels

from clvol import Renderer, Scene, TransferFunction, Volume
from clvol.errors import SceneError, UsageError
from clvol.explanation import explain, kernel_hash
from clvol.features import called_for
from clvol.integrators.channels import blended, shown_channels
from clvol.scene.channel import ChannelSettings
from clvol.scene.channel_scenes import channel_scenes

SIZE = {"width": 23, "height": 19}
NUCLEI, FIBRES = (Volume(blobs(seed=seed, top=200.0, dtype=np.uint8)) for seed in (3, 8))
GREEN, RED = (0.0, 1.0, 0.0), (1.0, 0.1, 0.0)
CHANNELS = (
    {"color": GREEN, "range": (40.0, 190.0), "opacity": 0.3},
    {"file": FIBRES, "color": RED, "range": (30.0, 160.0), "gamma": 0.7, "opacity": 0.2},
)


def scene(channels=CHANNELS, volume=NUCLEI, **tables) -> Scene:
    integration = {"early_termination": 0.0, "classification": "post", **tables.pop("integration", {})}
    return Scene(
        volume=volume, channel=channels, image=SIZE, integration=integration,
        transfer_function={"opacity_unit": 1.0, **tables.pop("transfer_function", {})},
        camera=oblique(volume.shape), **tables,
    )  # fmt: skip


def rendered(device, made: Scene, **how):
    with Renderer(made, devices=[device]) as renderer:
        return renderer.render(**how)


@pytest.mark.parametrize("blend", ["additive", "screen", "maximum"])
def test_pictures_of_channels_are_blended_as_defined(each_device, blend):
    resolved = scene(integration={"blend": blend}).resolve()
    frame = rendered(each_device, resolved)
    np.testing.assert_allclose(frame.rgba, render_channels(resolved), atol=2e-5)
    assert frame.rgba[..., 0].max() > 0.1 and frame.rgba[..., 1].max() > 0.1
    assert frame.stats["channels"]["count"] == 2 and frame.stats["channels"]["blend"] == blend
    assert sum(frame.stats["channels"]["samples"]) == frame.stats["samples"]


def test_each_channel_of_an_added_picture_is_rendered_bit_for_bit_as_alone(device):
    resolved = scene().resolve()
    together = rendered(device, resolved)
    alone = [rendered(device, each) for each in channel_scenes(resolved)]
    np.testing.assert_array_equal(together.rgba, blended([frame.rgba for frame in alone], "additive"))
    np.testing.assert_array_equal(together.depth, np.minimum(alone[0].depth, alone[1].depth))
    assert together.stats["samples"] == sum(frame.stats["samples"] for frame in alone)


@pytest.mark.slow  # programs of its own
def test_a_projection_is_the_maximum_of_each_channel(device):
    resolved = scene(integration={"compositing": "maximum"}).resolve()
    np.testing.assert_allclose(rendered(device, resolved).rgba, render_channels(resolved), atol=2e-5)


def test_mixed_channels_are_one_medium(each_device):
    resolved = scene(integration={"blend": "mix"}).resolve()
    assert resolved.mixed_channels == 2 and not resolved.channels
    assert {"channels", "density field"} <= set(called_for(resolved))
    np.testing.assert_allclose(rendered(each_device, resolved).rgba, render_twin(resolved), atol=2e-5)


@pytest.mark.slow  # programs of its own
def test_the_order_of_mixed_channels_changes_nothing(device):
    first = {key: value for key, value in CHANNELS[1].items() if key != "file"}
    turned = scene((first, {"file": NUCLEI, **CHANNELS[0]}), FIBRES, integration={"blend": "mix"})
    one, other = (rendered(device, made).rgba for made in (scene(integration={"blend": "mix"}), turned))
    np.testing.assert_allclose(one, other, atol=2e-5)


@pytest.mark.slow  # programs of its own
def test_six_channels_mix(device):
    more = [{"file": FIBRES, "color": RED, "range": (30.0 + k, 160.0), "opacity": 0.05} for k in range(5)]
    resolved = scene((CHANNELS[0], *more), integration={"blend": "mix"}).resolve()
    np.testing.assert_allclose(rendered(device, resolved).rgba, render_twin(resolved), atol=3e-5)


def test_a_channel_that_shows_nothing_costs_nothing(device):
    hidden = CHANNELS[1] | {"range": (250.0, 255.0)}
    both, one = scene((CHANNELS[0], hidden)).resolve(), scene(CHANNELS[:1]).resolve()
    assert kernel_hash(both) == kernel_hash(one) and "channels" not in called_for(both)
    first, second = rendered(device, both), rendered(device, one)
    np.testing.assert_array_equal(first.rgba, second.rgba)
    assert first.stats["samples"] == second.stats["samples"]


def test_nothing_visible_is_a_blank_picture(device):
    hidden = [each | {"range": (250.0, 255.0)} for each in CHANNELS]
    resolved = scene(hidden).resolve()
    assert len(shown_channels(resolved)) == 1
    with pytest.warns(UserWarning):
        assert not rendered(device, resolved).rgba.any()


def test_one_channel_is_the_same_scene_as_its_function(device):
    points = [{"value": 40.0, "opacity": 0.0, "color": GREEN}, {"value": 190.0, "opacity": 0.3, "color": GREEN}]
    plain = scene((), transfer_function={"points": points}).resolve()
    one = scene(CHANNELS[:1]).resolve()
    assert kernel_hash(plain) == kernel_hash(one) and not one.channels
    np.testing.assert_array_equal(rendered(device, plain).rgba, rendered(device, one).rgba)


@pytest.mark.slow  # programs of its own
def test_lit_channels_each_by_their_own_gradient(device):
    resolved = scene(light=[{"type": "headlight"}]).resolve()
    frame = rendered(device, resolved)
    np.testing.assert_allclose(frame.rgba, render_channels(resolved), atol=1e-4)
    assert frame.stats["counters"]["lit_samples"] > 0


@pytest.mark.slow  # programs of its own
def test_several_rays_per_pixel_are_means_of_added_light(device):
    made = scene().model_copy(update={"image": {**SIZE, "samples": 4, "refine": "all"}})
    frame, plain = rendered(device, made), rendered(device, scene())
    assert frame.stats["rays"] >= 4 * plain.stats["rays"]
    assert abs(frame.rgba - plain.rgba).mean() < 0.02


@pytest.mark.parametrize("spacing", [1, 4])
def test_devices_share_pictures_of_channels(device, other_device, spacing):
    made = scene().model_copy(update={"image": {"width": 70, "height": 50, "ray_spacing": spacing}})
    with Renderer(made, devices=[device]) as one, Renderer(made, devices=[device, other_device]) as both:
        alone, shared = one.render(), both.render()
    assert shared.stats["schedule"]["devices"][0]["tiles"] > 0
    np.testing.assert_allclose(shared.rgba, alone.rgba, atol=2e-5)
    np.testing.assert_allclose(shared.depth, alone.depth, atol=1e-3)


@pytest.mark.slow  # programs of its own
def test_another_time_and_camera_change_no_channel(device):
    resolved = scene().resolve()
    with Renderer(resolved, devices=[device]) as renderer:
        first = renderer.render()
        renderer.render(camera=oblique(NUCLEI.shape, away=3.0), time=1.0)
        again = renderer.render(time=0.0)
        with pytest.raises(UsageError, match="set_scene"):
            renderer.set_transfer_function(TransferFunction([0.0], [0.5], [[1, 1, 1]]))
    np.testing.assert_array_equal(first.rgba, again.rgba)


@pytest.mark.slow  # programs of other methods
@pytest.mark.parametrize("method", ["slicing", "multiresolution", "pyramid"])
def test_other_methods_render_each_channel_as_alone(device, method):
    resolved = scene(integration={"method": method, "classification": "preintegrated"}).resolve()
    together = rendered(device, resolved)
    alone = [rendered(device, each).rgba for each in channel_scenes(resolved)]
    assert together.rgba[..., 3].max() > 0.1
    np.testing.assert_array_equal(together.rgba, blended(alone, "additive"))


@pytest.mark.slow  # the program of the exact integral
def test_the_exact_integral_of_channels(device):
    resolved = scene(integration={"method": "reference", "classification": "preintegrated"}).resolve()
    small_steps = resolved.integration.model_copy(update={"step": 0.1})
    exact = render_channels(replace(resolved, integration=small_steps))
    np.testing.assert_allclose(rendered(device, resolved).rgba, exact, atol=3e-4)


@pytest.mark.parametrize(
    "tables, what",
    [
        ({"isosurface": [{"value": 100.0}]}, "isosurfaces"),
        ({"field": [{"file": FIBRES, "role": "density",
                     "points": [{"value": 0, "opacity": 0.5, "color": RED}]}]}, "density field"),
    ],
)  # fmt: skip
def test_what_belongs_to_one_channel_is_refused_for_pictures_of_several(tables, what):
    with pytest.raises(SceneError, match=f"integration.blend: got 'additive' in a scene that calls for {what}"):
        explain(scene(**tables).resolve())
    explain(scene(**tables, integration={"blend": "mix"}).resolve())


@pytest.mark.parametrize(
    "change, what",
    [
        ({"range": (9.0, 9.0)}, r"channel.0.range.*ascending"),
        ({"gamma": 0.0}, "channel.0.gamma"),
        ({"points": [{"value": 0, "opacity": 1, "color": RED}]}, "either points or color"),
    ],
)
def test_a_wrong_channel_is_one_line(change, what):
    with pytest.raises(SceneError, match=what):
        scene((CHANNELS[0] | change,))


def test_contradictions_are_refused():
    with pytest.raises(SceneError, match=r"transfer_function.preset.*channels have their own"):
        scene(transfer_function={"preset": "hot"})
    with pytest.raises(SceneError, match=r"channel.1.file: missing"):
        scene((CHANNELS[0], {"color": RED})).resolve()
    with pytest.raises(SceneError, match="channel: got 7.*at most 6"):
        scene([CHANNELS[0]] * 7)


def test_gamma_bends_the_opacity():
    settings = ChannelSettings(color=RED, range=(10.0, 20.0), gamma=0.5, opacity=0.4)
    function = settings.function(1.0, np.asarray)
    values = np.linspace(10.0, 20.0, 41)
    np.testing.assert_allclose(function.opacity(values), 0.4 * ((values - 10.0) / 10.0) ** 0.5, atol=0.4 * 0.02)
    straight = settings.model_copy(update={"gamma": 1.0}).function(1.0, np.asarray)
    np.testing.assert_allclose(straight.values, [10.0, 20.0])
