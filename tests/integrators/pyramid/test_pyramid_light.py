"""Lights, cut faces, depth cues and opacity factors by the method "pyramid": against its twin, and the ray caster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.pyramid_scenes import CAMERA, rendered, twin_picture
from helpers.small_scenes import SMOOTH, picture, rms, waves

from clvol import Scene, Volume
from clvol.device.voxels import as_rendered
from clvol.errors import SceneError
from clvol.explanation import kernel_hash
from clvol.features import reduced_for_frames
from clvol.integrators.pyramid.caster import PyramidCaster, pyramid_switches
from clvol.integrators.pyramid.march import brightest
from clvol.integrators.registry import check_scene

SUN = {"type": "directional", "direction": (0.5, 0.6, 1.0)}
LAMPS = [{"type": "point", "position": (-30.0, 0.0, -20.0), "color": [1.0, 0.5, 0.2]}, {"type": "headlight"}]
PLANE = {"point": (20.0, 15.0, 18.0), "normal": (1.0, 0.6, 0.3)}
STEEP = {"points": [{"magnitude": 0, "opacity": 0}, {"magnitude": 8, "opacity": 1}]}
ALONG = {"points": [{"derivative": 0, "opacity": 0.2}, {"derivative": 6, "opacity": 1}]}


def scene(array=None, method="pyramid", function=SMOOTH, size=(40, 36), camera=CAMERA, **tables):
    integration = {
        "classification": "preintegrated", "step": 0.7, "method": method, "early_termination": 0.0, "step_error": 0.0,
        **tables.pop("integration", {}),
    }  # fmt: skip
    array = waves((40, 37, 45), np.uint8) if array is None else array
    return Scene(
        volume=array if isinstance(array, Volume) else Volume(array), transfer_function=function, camera=camera,
        image={"width": size[0], "height": size[1]}, integration=integration, **tables,
    ).resolve()  # fmt: skip


def by_rays(resolved, **integration):
    changed = {"method": "raycast", **integration}
    return replace(resolved, integration=resolved.integration.model_copy(update=changed))


def check(context, resolved, tolerance=6e-4, **how) -> np.ndarray:
    """The twin's picture, and the caster's own."""
    caster = PyramidCaster(context, resolved, **how)
    data, twin = rendered(caster), twin_picture(caster, reduced_for_frames(resolved).clips)
    difference = np.abs(data.rgba - twin.rgba).max(axis=-1)
    assert np.quantile(difference, 0.99) < tolerance and difference.max() < 0.05
    assert twin.rgba[..., 3].max() > 0.3
    return data.rgba


TABLES = {
    "lit and cut": {"light": [SUN], "clip": [PLANE]},
    "lamps, one-sided, fading": {"light": LAMPS, "material": {"two_sided": False, "fade": 2.0, "shininess": 7.0}},
    "cued and lit": {"light": [SUN], "depth_cue": {"start": 60.0, "end": 110.0, "color": [0.2, 0.3, 0.9]}},
    "cued": {"depth_cue": {"start": 60.0, "end": 110.0}},
    "by gradients": {"gradient_opacity": STEEP, "directional_opacity": ALONG, "light": [SUN]},
    "Sobel": {"light": [SUN], "gradient": {"operator": "sobel", "storage": "on-the-fly"}},
    "cubic": {"light": [SUN], "integration": {"filter": "cubic"}},
}


@pytest.mark.parametrize("name", TABLES)
def test_the_picture_is_the_twins(context, name):
    resolved = scene(**TABLES[name])
    plain = {key: table for key, table in TABLES[name].items() if key in ("clip", "integration")}
    lit = check(context, resolved)
    if name == "lit and cut":  # light changes something
        assert rms(lit, rendered(PyramidCaster(context, scene(**plain))).rgba) > 0.01


@pytest.mark.parametrize("name", ["cued and lit", "by gradients", "lit and cut"])
@pytest.mark.slow  # programs of one pixel a work-item
def test_segments_lit_one_by_one_are_those_of_a_queue(context, name):
    resolved = scene(size=(21, 18), **TABLES[name])
    packets, single = (
        rendered(PyramidCaster(context, resolved, **how)) for how in ({"lanes": 16}, {"lanes": 1, "workers": 16})
    )
    np.testing.assert_allclose(single.rgba, packets.rgba, atol=3e-5)
    assert single.counters == packets.counters


def test_full_levels_are_the_lit_ray_casters(context):
    """As steps become short both go to the same picture, at the same gradients."""
    tables = TABLES["lit and cut"]
    errors = []
    for step in (0.8, 0.2):
        asked = scene(integration={"step": step}, pyramid={"oracle": "minimum"}, **tables)
        errors.append(rms(rendered(PyramidCaster(context, asked)).rgba, picture(context, by_rays(asked)).rgba))
    assert errors[1] < 0.35 * errors[0] and errors[0] < 6e-3
    allowed = scene(integration={"step": 0.2}, pyramid={"epsilon": 0.01}, **tables)
    data = rendered(PyramidCaster(context, allowed))
    assert rms(data.rgba, picture(context, by_rays(allowed)).rgba) < 5e-3
    counted = data.counters
    assert 0 < counted["lit_samples"] <= counted["gradients"] <= counted["accumulations"]


@pytest.mark.slow  # a program more
def test_constant_cells_need_no_gradient_and_change_nothing(context, monkeypatch):
    array = np.full((70, 70, 70), 40, np.uint8)
    array[24:48, 24:48, 24:48] = 40 + np.arange(24, dtype=np.uint8)[:, None, None] * 6
    camera = {"position": (-70.0, -50.0, -90.0), "target": (35.0, 35.0, 35.0), "fov_degrees": 36.0}
    resolved = scene(array, light=[SUN], camera=camera)
    assert pyramid_switches(as_rendered(resolved), 16)["CONSTANT_CELLS"] == 1
    found = rendered(PyramidCaster(context, resolved, lanes=16))
    monkeypatch.setattr("clvol.integrators.pyramid.caster.uses_constant_cells", lambda *_: False)
    every = rendered(PyramidCaster(context, resolved, lanes=16))
    np.testing.assert_allclose(found.rgba, every.rgba, atol=2e-6)
    assert found.counters["lit_samples"] == every.counters["lit_samples"] > 0
    if found.counters["gradients"] < found.counters["accumulations"]:  # where segments are queued
        assert found.counters["gradients"] < 0.5 * every.counters["gradients"]


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 30, 25), (3, 2, 25)])
def test_thin_volumes_and_holes_are_lit(context, shape):
    array = waves((7, 30, 25))[: shape[0], : shape[1], : shape[2]].copy()
    array[0, 0, 3] = np.nan
    resolved = scene(Volume(array), camera=None, light=[SUN], integration={"step": 0.25}, size=(21, 24))
    caster = PyramidCaster(context, resolved)
    data, twin = rendered(caster), twin_picture(caster)
    assert np.isfinite(data.rgba).all()
    np.testing.assert_allclose(data.rgba, twin.rgba, atol=2e-3)


@pytest.mark.slow
def test_shadows_and_scattering_of_a_light_volume_are_the_ray_casters(context):
    for shadow in ({"method": "volume", "resolution": 32}, {"resolution": 24, "scattering": 0.4}):
        asked = scene(light=[SUN], shadow=shadow, pyramid={"oracle": "minimum"}, integration={"step": 0.3})
        caster = PyramidCaster(context, asked)
        shown, cast = rendered(caster).rgba, picture(context, by_rays(asked)).rgba
        unshadowed = picture(context, by_rays(replace(asked, shadow=None))).rgba
        assert rms(shown, cast) < 1.5e-3 < 0.1 * rms(unshadowed, cast)
        moved = caster.for_scene(replace(asked, integration=asked.integration.model_copy(update={"step": 0.6})))
        np.testing.assert_array_equal(
            rendered(moved).rgba, rendered(PyramidCaster(context, moved.resolved)).rgba
        )  # fmt: skip


@pytest.mark.slow
def test_tiles_and_devices_do_not_show(context):
    resolved = scene(size=(67, 33), light=[SUN], clip=[PLANE])
    small, large = (rendered(PyramidCaster(context, resolved, tile=tile)) for tile in (32, 64))
    np.testing.assert_array_equal(small.rgba, large.rgba)
    np.testing.assert_array_equal(small.depth, large.depth)


def test_effects_without_consequence_change_no_program():
    unused = scene(light=[{**SUN, "intensity": 0.0}], material={"fade": 3.0}, shadow={"method": "rays"})
    assert kernel_hash(unused) == kernel_hash(scene()) != kernel_hash(scene(light=[SUN]))


def test_errors_that_light_makes_larger_are_allowed_less():
    assert brightest(reduced_for_frames(scene())) == 1.0
    bright = {"light": [{**SUN, "intensity": 5.0}], "material": {"ambient": 0.1, "diffuse": 0.7, "specular": 0.2}}
    assert brightest(reduced_for_frames(scene(**bright))) == pytest.approx(4.6)


@pytest.mark.parametrize(
    ("tables", "where"),
    [
        ({"light": [SUN], "shadow": {"method": "rays"}}, "shadow.method: got 'rays'"),
        ({"light": [SUN], "shadow": {}, "clip": [PLANE]}, "integration.method: got 'pyramid' in a scene with clips"),
        ({"noise": [{"target": "value", "amplitude": 3.0}]}, "integration.method: got 'pyramid' in .* noise"),
    ],
)
def test_what_needs_rays_of_its_own_is_refused(tables, where):
    with pytest.raises(SceneError, match=where):
        check_scene(scene(**tables))
    check_scene(scene(method="raycast", **tables))
