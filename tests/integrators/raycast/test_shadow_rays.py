"""Rays to lights are integrated as the eye's are: against a twin of tiny steps, and against its own steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.shadow_scenes import BALL, RAYS, ball, inside, shadowed, share
from reference.medium import Medium
from reference.shadow import Shadows

from clvol import TransferFunction
from clvol.integrators.raycast.caster import Raycaster

TOWARDS = np.array([0.6, 0.8, 0.0])  # the way that the light of shadowed() comes from
PLACES = inside(160, 0.0, 23.0)
NARROW = TransferFunction([0, 7, 7.4, 7.8, 24], [0, 0, 0.6, 0, 0], [[1, 1, 1]] * 5)
STEPS = (1.0, 0.5, 0.25, 0.125)
FINE = 1 / 64


@pytest.fixture(autouse=True)
def not_reduced(monkeypatch):
    """As in test_shadows.py: nothing of a scene is left out."""
    monkeypatch.setattr("clvol.integrators.raycast.caster.reduced_for_frames", lambda resolved: resolved)


def lit(function, classification, step, shadow=RAYS, **integration):
    integration |= {"classification": classification, "step": step, "table_size": 1024}
    return shadowed(ball(), function, shadow=shadow, integration=integration)


def of_twin(resolved, places=PLACES) -> np.ndarray:
    """The share of the light that arrives at ``places``, in double precision."""
    shadows = Shadows(resolved, Medium(resolved))
    towards = np.tile(TOWARDS, (len(places), 1))
    return np.exp(-shadows.optical_depth(places, towards, np.full(len(places), np.inf)))


def rms(difference) -> float:
    return float(np.sqrt(np.mean(np.square(difference))))


@pytest.mark.slow
@pytest.mark.parametrize("classification", ["preintegrated", "post", "pre"])
def test_their_error_falls_with_the_square_of_the_step(context, classification):
    for function, first in ((BALL, 1e-3), (NARROW, 0.1)):
        exact = of_twin(lit(function, classification, FINE))
        errors = []
        for step in STEPS:
            of = lit(function, classification, step)
            errors.append(rms(share(context, of, PLACES) - exact))
        order = np.log2(errors[0] / errors[-1]) / np.log2(STEPS[0] / STEPS[-1])
        assert errors[0] < first and 1.6 < order < 2.6, (errors, order)


@pytest.mark.parametrize("classification", ["preintegrated", "post", "pre"])
def test_each_segment_is_the_eyes(context, classification):
    """The twin's, of the same step: the same classification, chords, and last, shorter steps."""
    for step in (0.37, 1.0, 2.6):
        of = lit(BALL, classification, step)
        np.testing.assert_allclose(share(context, of, PLACES), of_twin(of), atol=3e-4)  # the tables' own


def test_a_narrow_peak_is_not_missed(context):
    """Pre-integrated, at the default step. What was a midpoint rule is off by 0.07 there."""
    exact = of_twin(lit(NARROW, "preintegrated", FINE))
    found = share(context, lit(NARROW, "preintegrated", 1.0), PLACES)
    assert rms(found - exact) < 5e-3 and rms(1.0 - exact) > 0.2
    midpoints = of_twin(lit(NARROW, "post", 1.0))
    assert rms(midpoints - exact) > 10 * rms(found - exact)


@pytest.mark.slow
def test_light_volumes_have_the_same_rays(context):
    points = np.stack(np.meshgrid(*[np.linspace(0, 23, 6)] * 3), axis=-1).reshape(-1, 3)
    of = lit(NARROW, "preintegrated", 1.0, shadow={"resolution": 6})
    exact = of_twin(lit(NARROW, "preintegrated", FINE), points)
    assert rms(share(context, of, points) - exact) < 5e-3


@pytest.mark.parametrize("shadow", [RAYS, {"resolution": 6}], ids=["rays", "volume"])
def test_the_step_is_the_scenes_unless_stated(context, shadow):
    coarse, fine = (lit(BALL, "preintegrated", step, shadow) for step in (2.0, 0.25))
    stated = lit(BALL, "preintegrated", 2.0, {**shadow, "step": 0.25})
    places = PLACES[:32]
    expected = share(context, fine, places)
    np.testing.assert_allclose(share(context, stated, places), expected, atol=1e-6)
    assert np.abs(share(context, coarse, places) - expected).max() > 1e-3
    # Nor does an engine go on with the step of the scene that it was made from.
    engine = Raycaster(context, coarse)
    integration = coarse.integration.model_copy(update={"step": 0.25})
    other = engine.for_scene(replace(coarse, integration=integration))
    image = coarse.image
    again, anew = (
        caster.render(coarse.camera, image.width, image.height).rgba
        for caster in (other, Raycaster(context, replace(coarse, integration=integration)))
    )
    assert np.array_equal(again, anew)


def test_filters_are_the_scenes(context):
    of = lit(BALL, "post", 0.5, filter="cubic")
    np.testing.assert_allclose(share(context, of, PLACES), of_twin(of), atol=1e-4)
