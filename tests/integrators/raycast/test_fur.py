"""Fur: hairs as long as noise says at their roots, against the twin; and where it is idle or cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.shadow_scenes import DIFFUSE, SLANTED, ball
from helpers.twin_scenes import scene
from reference import render_twin

from clvol import TransferFunction, Volume
from clvol.bricks.render import bricks_of
from clvol.device.noise import fractal_noise, noise_tile
from clvol.errors import SceneError
from clvol.explanation import kernel_hash
from clvol.features import called_for, effects, reduced
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.same_starts import Facts
from clvol.integrators.registry import check_scene

SHOWN = TransferFunction([0, 5, 10, 10.5, 40], [0.4, 0.3, 0.3, 0, 0], [[1.0, 0.5, 0.2]] * 5)
FUR = {"target": "fur", "amplitude": 6.0, "frequency": 1.5, "seed": 4, "root": 5.0, "tip": 10.0}
KINDS = ("post", "preintegrated")


def furry(fur=FUR, volume=None, function=SHOWN, kind="post", **tables):
    integration = {"classification": kind, "early_termination": 0.0, **tables.pop("integration", {})}
    tables.setdefault("gradient", {"storage": "on-the-fly"})
    noise = {} if fur is None else {"noise": fur if isinstance(fur, list) else [fur]}
    data = ball() if volume is None else volume
    return scene(data, function, integration=integration, image={"width": 20, "height": 18}, **noise, **tables)


def pictured(context, of):
    return Raycaster(context, of).render(of.camera, 20, 18).rgba


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_are_the_twins(contexts, each_device, kind):
    of = furry(kind=kind)
    found = pictured(contexts(each_device), of)
    assert np.abs(found - render_twin(of)).max() < 1e-3
    bald = render_twin(furry(None, kind=kind))
    assert np.abs(found - bald).max() > 0.1
    assert (found[..., 3] <= bald[..., 3] + 1e-5).all()


def test_hairs_stand_along_the_gradient_as_long_as_noise_says(context):
    """In a ramp along z, rays along z see one hair each: full up to its length, and nothing of it beyond."""
    n = 17
    volume = np.broadcast_to(np.arange(n, dtype=np.float32)[:, None, None], (n, n, n)).copy()
    fur = {**FUR, "amplitude": 1e6, "root": 4.0, "tip": 12.0}
    even = TransferFunction([0, 40], [0.1, 0.1], [[1.0, 1.0, 1.0]] * 2)
    camera = {"projection": "orthographic", "position": [8.0, 8.0, -30.0], "target": [8.0, 8.0, 8.0], "height": 12.0}
    of = furry(fur, Volume(volume), even, camera=camera, integration={"step": 0.02})
    found = pictured(context, of)[..., 3]
    origins, _ = of.camera.world_rays(20, 18)
    roots = np.concatenate([origins[..., :2], np.full((18, 20, 1), 4.0)], axis=-1)
    lower, upper = of.volume.grid.index_bounds()
    tiles = (roots - lower) * fur["frequency"] / (upper - lower).max()
    hair = 0.5 + 0.5 * fractal_noise(noise_tile(4), of.fur[0], tiles)[..., 3]
    length = 4.0 + 8.0 * hair - lower[2]
    unit = even.opacity_unit
    np.testing.assert_allclose(found, 1.0 - 0.9 ** (length / unit), atol=2e-3)
    assert np.ptp(hair) > 0.5


def lit(velocity=(0.0, 0.0, 0.0)):
    """Two kinds of hairs on values that noise stirs, in light with shadows; the axes of the data are turned."""
    more = {**FUR, "frequency": 0.7, "octaves": 2, "seed": 1, "tip": 12.0, "amplitude": 3.0}
    stirred = {"target": "value", "amplitude": 0.7, "frequency": 1.0}
    volume = Volume(ball(), spacing=(1.0, 0.8, 1.25), direction=[[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    tables = {"light": [SLANTED], "shadow": {"resolution": 6}, "material": DIFFUSE}
    fur = {**FUR, "velocity": velocity}
    return furry([fur, more, stirred], volume, kind="preintegrated", **tables)


def test_in_light_and_shadows_of_other_hairs(context):
    of = lit()
    found = pictured(context, of)
    assert np.abs(found - render_twin(of)).max() < 3e-3 and found[..., 3].max() > 0.3


def test_holes_plateaus_and_tips_below_roots(context):
    """Voxels that are not numbers show nothing; where there is no gradient a place is its own root; and hairs grow
    towards lower values just as well."""
    volume = ball()
    volume[:, :, 14:17] = np.nan
    volume[18:] = 8.0
    falling = TransferFunction([-40, -10.5, -10, -5, 0], [0, 0, 0.3, 0.3, 0.4], [[1.0, 0.5, 0.2]] * 5)
    for of in (furry(volume=volume), furry({**FUR, "root": -5.0, "tip": -10.0}, -volume, falling)):
        found = pictured(context, of)
        assert np.isfinite(found).all() and found[..., 3].max() > 0.3
        assert np.abs(found - render_twin(of)).max() < 2e-3


def test_fur_that_moves_is_that_of_its_time(context):
    moving = lit((1.0, 0.5, 0.0))
    caster = Raycaster(context, moving)
    still = caster.render(moving.camera, 20, 18).rgba
    later = caster.for_scene(moving.at(0.3)).render(moving.camera, 20, 18).rgba
    np.testing.assert_array_equal(later, pictured(context, moving.at(0.3)))
    assert np.abs(later - still).max() > 0.01


def test_empty_space_is_leapt_over_alike(context):
    """Hairs take opacity away, so that what shows nothing without them shows nothing with them."""
    of = furry()
    leaping, walking = (Raycaster(context, of, skip=skip).render(of.camera, 20, 18) for skip in (True, False))
    np.testing.assert_array_equal(leaping.rgba, walking.rgba)
    assert leaping.counters["gradients"] == walking.counters["gradients"] > 0


def test_rays_of_other_fur_start_afresh():
    of, volume = furry(), Volume(ball())
    of = replace(of, volume=volume)
    for fur in ({**FUR, "tip": 9.0}, {**FUR, "amplitude": 1.0}):
        other = replace(of, fur=furry(fur).fur)
        assert Facts.of(other).reason_afresh(Facts.of(of)) == "the noise changed"
    assert Facts.of(replace(of)).reason_afresh(Facts.of(of)) is None


def test_it_is_called_for_where_hairs_grow():
    assert "fur" in called_for(furry()) and "gradients" in called_for(furry()) and "noise" not in called_for(furry())
    plain = furry(None)
    for idle, reason in (
        (plain, "the scene has no fur"),
        (furry({**FUR, "amplitude": 0.0}), "the noise's amplitude is 0"),
        (furry({**FUR, "root": 90.0, "tip": 99.0}), "no value of the volume lies beyond the root"),
        (furry(integration={"compositing": "maximum"}), "does not weight opacities"),
    ):
        told = {effect.name: effect for effect in effects(idle)}["fur"]
        assert not told.called_for and reason in told.reason and reduced(idle).fur == ()
        if idle.integration.compositing == "over":
            assert kernel_hash(idle) == kernel_hash(plain) != kernel_hash(furry())


@pytest.mark.parametrize(
    ("integration", "told"),
    [
        ({"method": "pyramid", "classification": "preintegrated"}, "'pyramid' in a scene that calls for fur"),
        ({"method": "slicing"}, "'slicing' in a scene that calls for"),
        ({"quadrature": "cells"}, "'cells' in a scene that calls for"),
        ({"classification": "pre"}, "'pre' in a scene that calls for fur"),
    ],
)
def test_methods_without_it_refuse_it(integration, told):
    with pytest.raises(SceneError, match=told):
        check_scene(furry(integration=integration))


def test_bricks_refuse_it():
    even = {"early_termination": 0.0, "step_error": 0.0, "classification": "preintegrated"}
    with pytest.raises(SceneError, match="fixed to the whole volume"):
        bricks_of(furry(integration=even), 2)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"root": None}, "noise.0.root"), ({"tip": 5.0}, "another value than the root's"),
        ({"amplitude": -1.0}, "not negative"), ({"target": "value"}, "noise.0.root"),
    ],
)  # fmt: skip
def test_ends_of_hairs_are_stated_for_fur_alone(keys, told):
    stated = {key: value for key, value in {**FUR, **keys}.items() if value is not None}
    with pytest.raises(SceneError, match=told):
        furry(stated)
