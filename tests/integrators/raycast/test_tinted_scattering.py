"""Noise of what attenuates scattered light: light volumes against the twin, and what it may not do."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.shadow_scenes import BALL, BLOCK, SLANTED, arriving, ball, inside, shadowed
from reference import render_twin
from reference.noise import fractal_noise
from reference.shadow import cone_directions, turned

from clvol.device.noise import noise_tile
from clvol.errors import SceneError
from clvol.explanation import kernel_hash
from clvol.features import called_for, effects, reduced
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.registry import check_scene

TAU = -np.log(0.9)  # of BLOCK, a world length
NOISE = {"target": "attenuation", "amplitude": 0.6, "frequency": 2.0, "octaves": 2, "seed": 5}
SCATTERING = {"resolution": 16, "scattering": 0.8, "scatter_color": [0.9, 0.5, 0.2], "cone_degrees": 40.0}


def tinted(noise=NOISE, shadow=SCATTERING, **tables):
    terms = noise if isinstance(noise, list) else [noise]
    return shadowed(ball(), BALL, SLANTED, shadow, noise=terms, image={"width": 16, "height": 16}, **tables)


@pytest.fixture(autouse=True)
def not_reduced(monkeypatch):
    """Blocks of one value are not lit, so nothing of theirs would be shadowed."""
    monkeypatch.setattr("clvol.integrators.raycast.caster.reduced_for_frames", lambda resolved: resolved)


def test_light_that_arrives_is_tinted_by_a_channel_of_noise_each(context):
    """At the points of the light volume, through a block of one extinction: exactly the sum over the cone."""
    of = shadowed(BLOCK, light=SLANTED, shadow=SCATTERING, noise=[NOISE])
    places = inside(64).round()
    noise = fractal_noise(of.attenuation_noise[0], noise_tile(5), of.volume.grid, places, 0.0)[:, :3]
    less = np.clip(1.0 - np.array(SCATTERING["scatter_color"]) + 0.6 * noise, 0.0, 1.0)
    assert (less == 0.0).any() and np.ptp(less[:, 0]) > 0.2

    def depth(towards):
        with np.errstate(divide="ignore", invalid="ignore"):
            ways = np.where(towards > 0, (15.0 - places) / towards, -places / towards)
        return TAU * np.where(towards == 0, np.inf, ways).min(axis=1)[:, None]

    towards = np.broadcast_to([0.6, 0.8, 0.0], places.shape)
    cone = np.mean([np.exp(-depth(turned(towards, local)) * less) for local in cone_directions(40.0)], axis=0)
    found, _ = arriving(Raycaster(context, of), places)
    np.testing.assert_allclose(found, 0.2 * np.exp(-depth(towards)) + 0.8 * cone, atol=3e-5)


def test_pictures_are_the_twins_and_are_tinted(context):
    of = tinted()
    found = Raycaster(context, of).render(of.camera, 16, 16).rgba
    expected = render_twin(of)
    assert np.abs(found - expected).max() < 1e-3 and expected[..., 3].max() > 0.3
    plain = shadowed(ball(), BALL, SLANTED, SCATTERING, image={"width": 16, "height": 16})
    assert np.abs(found - Raycaster(context, plain).render(of.camera, 16, 16).rgba).max() > 0.01


def test_noise_that_moves_tints_anew_at_each_time(context):
    moving = tinted({**NOISE, "velocity": [1.0, 0.5, 0.0]})
    caster = Raycaster(context, moving)
    still = caster.render(moving.camera, 16, 16).rgba
    later = caster.for_scene(moving.at(0.3))
    afresh = Raycaster(context, moving.at(0.3))
    found = later.render(moving.camera, 16, 16).rgba
    np.testing.assert_array_equal(found, afresh.render(moving.camera, 16, 16).rgba)
    assert np.abs(found - still).max() > 1e-3


def test_it_is_called_for_where_light_is_scattered():
    assert "attenuation noise" in called_for(tinted()) and "noise" not in called_for(tinted())
    no_light = {"resolution": 16}
    for idle, reason in (
        (tinted({**NOISE, "amplitude": 0.0}), "the noise's amplitude is 0"),
        (tinted(shadow=no_light), "no light is scattered"),
        (shadowed(ball(), BALL, SLANTED, SCATTERING), "no noise of attenuation"),
    ):
        told = {effect.name: effect for effect in effects(idle)}["attenuation noise"]
        assert not told.called_for and reason in told.reason and reduced(idle).attenuation_noise == ()
    plain = shadowed(ball(), BALL, SLANTED, SCATTERING, image={"width": 16, "height": 16})
    assert kernel_hash(tinted({**NOISE, "amplitude": 0.0})) == kernel_hash(plain) != kernel_hash(tinted())


def test_half_angle_slices_refuse_it():
    """Their light scatters from slice to slice, and attenuates there."""
    with pytest.raises(SceneError, match="attenuation noise"):
        check_scene(tinted(slicing={"geometry": "half-angle"}, integration={"method": "slicing"}))
