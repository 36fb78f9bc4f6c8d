"""Half-angle slices against their plain twin, shadow rays, closed forms, and themselves where nothing may differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.shadow_scenes import BALL, DIFFUSE, ball
from helpers.small_scenes import axis_camera, rms
from helpers.twin_scenes import constant_function, ramp, scene
from reference.half_angle import Slabs, render_half_angle_twin

from clvol import Slicing, TransferFunction
from clvol.device.light_volume import check_fits, light_volume_bytes
from clvol.errors import SceneError
from clvol.explanation import explain
from clvol.features import effects
from clvol.features.gradient_storage import DeviceLimits
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.registry import check_scene, integrator_of
from clvol.integrators.slicing.half_angle import half_angle_plan
from clvol.integrators.slicing.half_angle_caster import HalfAngleCaster

SLANTED = {"type": "directional", "direction": [-0.6, -0.8, 0.3]}
TOWARDS_EYE = {"type": "directional", "direction": [1.0, 0.2, -1.3]}
POINT = {"type": "point", "position": [20.0, 50.0, -10.0]}
NEAR = {"position": [40.0, 31.0, -36.0], "target": [11.0, 12.0, 9.0], "up": [0.0, 1.0, 0.0], "fov_degrees": 40.0}
FLAT = {"projection": "orthographic", "height": 34.0, **{k: v for k, v in NEAR.items() if k != "fov_degrees"}}
CLIPS = [
    {"type": "plane", "point": [11, 12, 9], "normal": [1, 0.3, 0.1]},
    {"type": "sphere", "center": [14, 12, 6], "radius": 3.0, "keep": "outside"},
]
SCATTERING = {"resolution": 24, "scattering": 0.7, "scatter_color": [1.0, 0.5, 0.0]}


def half_angle(array=None, function=BALL, *, light=SLANTED, shadow=None, camera=NEAR, size=16, slicing=None,
               step=1.0, classification="post", **tables):
    lights = light if isinstance(light, list) else [light]
    return scene(
        ball() if array is None else array, function, light=lights, camera=camera, material=DIFFUSE,
        shadow={"resolution": 24} if shadow is None else shadow, image={"width": size, "height": size},
        slicing={"geometry": "half-angle", **(slicing or {})},
        integration={"method": "slicing", "step": step, "classification": classification}, **tables,
    )  # fmt: skip


def by_rays(of, step=0.25):
    integration = of.integration.model_copy(update={"method": "raycast", "step": step, "step_error": 0.0})
    shadow = of.shadow.model_copy(update={"method": "rays", "bound": 0.0})
    return replace(of, integration=integration, shadow=shadow)


def rgba(context, of, **how) -> np.ndarray:
    caster = (HalfAngleCaster if of.integration.method == "slicing" else Raycaster)(context, of, **how)
    return caster.render(of.camera, of.image.width, of.image.height).rgba


def turned(degrees: float) -> dict:
    """A light whose direction is this angle off the view of ``FLAT``."""
    forward = np.subtract(FLAT["target"], FLAT["position"])
    forward /= np.linalg.norm(forward)
    across = np.cross(forward, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    a = np.radians(degrees)
    return {"type": "directional", "direction": (np.cos(a) * forward + np.sin(a) * across).tolist()}


TWINS = {
    "directional": {},
    "orthographic": {"camera": FLAT},
    "towards the eye": {"light": TOWARDS_EYE},
    "point": {"light": POINT},
    "spot": {"light": {"type": "spot", "position": POINT["position"], "direction": [-0.3, -1.0, 0.5],
                       "cone_degrees": 20.0, "penumbra": 0.8}},
    "at the front": {"slicing": {"light_at": "front"}},
    "seven": {"slicing": {"slices": 7}},
    "two lights": {"light": [{**TOWARDS_EYE, "casts_shadow": False}, SLANTED]},
    "stretched": {"grid": {"spacing": (1.0, 1.5, 0.8), "origin": (3.0, -4.0, 2.0)}},
    "clipped": {"clip": CLIPS},
    "clipped, point": {"clip": CLIPS, "light": POINT, "camera": FLAT},
    "preintegrated": {"classification": "preintegrated", "clip": CLIPS},
    "noise": {"noise": [{"target": "coordinate", "amplitude": 3.0, "frequency": 2.0}]},
    "pre": {"classification": "pre"},
    "scattering": {"shadow": SCATTERING, "camera": FLAT},
    "scattering, point, clipped": {"shadow": SCATTERING, "light": POINT, "clip": CLIPS},
}


@pytest.mark.parametrize("case", TWINS)
def test_pictures_are_those_of_the_twin(context, case):
    of = half_angle(**TWINS[case])
    got, expected = rgba(context, of), render_half_angle_twin(of)
    assert np.abs(got - expected).max() < 1e-3 and rms(got, expected) < 2e-4  # gradients are stored in bytes
    assert got[..., 3].max() > 0.5


@pytest.mark.parametrize("shape", ((12, 9, 11), (1, 12, 9), (9, 1, 1), (2, 2, 30)))
def test_thin_volumes(context, shape):
    array = np.indices(shape).sum(axis=0).astype(np.float32)
    centre = 0.5 * (np.array(shape[::-1]) - 1)
    camera = {**NEAR, "position": (centre + np.array([0.6, 0.5, -0.7]) * 2.0 * max(shape)).tolist(),
              "target": centre.tolist()}  # fmt: skip
    of = half_angle(array, constant_function(0.1), camera=camera)
    got = rgba(context, of)
    assert np.isfinite(got).all() and np.abs(got - render_half_angle_twin(of)).max() < 1e-3


def test_pictures_come_nearer_to_those_of_shadow_rays(context):
    truth = rgba(context, by_rays(half_angle(size=48)))
    errors = []
    for step in (2.0, 1.0, 0.5):
        errors.append(rms(rgba(context, half_angle(size=48, step=step, shadow={"resolution": 192})), truth))
    assert errors[1] < 0.6 * errors[0] and errors[2] < 0.7 * errors[1] and errors[2] < 1e-3


@pytest.mark.parametrize("degrees", (0, 60, 89.9, 90.1, 120, 180))
def test_light_from_any_side_is_that_of_shadow_rays(context, degrees):
    of = half_angle(size=32, camera=FLAT, light=turned(degrees), step=0.5, shadow={"resolution": 128})
    got, truth = rgba(context, of), rgba(context, by_rays(of))
    assert rms(got, truth) < 2e-3 and np.abs(got[..., 3] - truth[..., 3]).max() < 0.02


def test_pictures_on_either_side_of_the_switch_are_alike(context):
    """At 90 degrees the slices turn by as much. What jumps is within the error of slices."""
    jumps = []
    for step in (1.0, 0.25):
        before, after = (
            rgba(context, half_angle(size=32, camera=FLAT, light=turned(a), step=step, shadow={"resolution": 128}))
            for a in (89.99, 90.01)
        )
        jumps.append(rms(before, after))
    assert 0.0 < jumps[0] < 3e-3 and jumps[1] < 0.5 * jumps[0]


def test_the_switch_is_at_a_right_angle_and_light_goes_up_the_slabs():
    for degrees in (0, 45, 89.9, 90.1, 135, 180):
        of = half_angle(camera=FLAT, light=turned(degrees))
        plan = half_angle_plan(of, of.camera, (24, 24, 24))
        way, forward = np.asarray(of.lights[0].direction), np.asarray(of.camera.basis()[0])
        assert plan.towards_eye == (degrees > 90)
        assert plan.normal @ way > np.cos(np.radians(45.1)) and abs(plan.normal @ forward) > np.cos(np.radians(45.1))
        assert plan.count == Slabs(of).count


TAU, SIDE = -np.log(0.9), 15.0
WHITE = constant_function(0.1, (1.0, 1.0, 1.0))
BEHIND = {"type": "directional", "direction": [-1, 0, -1]}  # lights what faces x, from behind


def test_a_block_of_one_opacity_is_lit_by_the_closed_form(context):
    """With the view, light and eye lose the same."""
    exact = 0.5 * -np.expm1(-2 * TAU * SIDE)
    camera = axis_camera((7.5, 7.5, 7.5), 2, height=4.0)
    errors = []
    for slices in (5, 10, 20):
        of = half_angle(ramp(axis=0).astype(np.float32), WHITE, camera=camera, size=8, slicing={"slices": slices},
                        light={"type": "directional", "direction": [0, 0, 1]})  # fmt: skip
        errors.append(np.abs(rgba(context, of)[..., 0] - exact).max())
    assert errors[2] < 2e-3 and errors[1] < 0.3 * errors[0] and errors[2] < 0.3 * errors[1]


def test_a_block_that_is_lit_from_behind_is_lit_by_the_closed_form(context):
    camera = axis_camera((7.5, 7.5, 7.5), 2, height=0.5)
    z = (np.arange(20000) + 0.5) * SIDE / 20000
    lost = TAU * (z + np.sqrt(2.0) * np.minimum(7.5, SIDE - z))
    exact = np.sqrt(0.5) * TAU * np.exp(-lost).mean() * SIDE
    errors = []
    for step in (4.0, 1.0, 0.25):
        of = half_angle(ramp(-1.0, axis=2).astype(np.float32), WHITE, camera=camera, size=8, light=BEHIND, step=step,
                        shadow={"resolution": 128})  # fmt: skip
        errors.append(abs(rgba(context, of)[..., 0].mean() - exact))
    assert errors[0] < 1e-3 and max(errors[1:]) < 2e-4


@pytest.mark.parametrize("light_at", ("middle", "front"))
def test_nothing_is_lit_behind_opaque_matter(context, light_at):
    """Fog before an opaque wall that is lit from behind, seen from the fog's side."""
    array = ramp(-1.0, axis=2) + 15.0
    array[9:13] += 100.0
    camera = axis_camera((7.5, 7.5, 7.5), 2, height=4.0)
    parallel, near = {"direction": [-0.3, 0, -1]}, {"position": [30.0, 8.0, 90.0]}
    for light in ({"type": "directional", **parallel}, {"type": "point", **near}):
        shown = []
        for opacity in (1.0, 0.0):
            function = TransferFunction([0, 40, 40, 200], [0.1, 0.1, opacity, opacity], [[1.0, 1.0, 1.0]] * 4)
            of = half_angle(array.astype(np.float32), function, camera=camera, light=light, size=8,
                            slicing={"light_at": light_at})  # fmt: skip
            shown.append(rgba(context, of))
        dark, lit = shown
        assert dark[..., :3].max() < 1e-5 and dark[..., 3].min() > 0.99 and lit[..., 0].min() > 0.03


@pytest.mark.parametrize("tables", ({}, {"shadow": SCATTERING, "clip": CLIPS, "classification": "preintegrated"}),
                         ids=("plain", "all"))  # fmt: skip
def test_leaping_changes_no_bit_and_samples_less(context, tables):
    of = half_angle(ball(40, (20.0, 22.0, 18.0)), **tables)
    frames = []
    for skip in (True, False):
        caster = HalfAngleCaster(context, of)
        caster.switches["SKIP_EMPTY"] = int(skip)
        frames.append(caster.render(of.camera, 16, 16))
    assert np.array_equal(frames[0].rgba, frames[1].rgba)
    assert 0 < frames[0].samples < 0.6 * frames[1].samples
    counts = [frame.counters["shadow_samples"] for frame in frames]
    assert 0 < counts[0] < 0.6 * counts[1]


@pytest.mark.slow  # single rays are a program of their own
def test_packets_of_rays_and_single_rays_agree(context):
    of = half_angle(shadow=SCATTERING)
    assert np.abs(rgba(context, of, lanes=1) - rgba(context, of, lanes=16)).max() < 2e-6


def test_tiles_and_bands_change_no_bit(context, monkeypatch):
    of = half_angle(size=24)
    whole = rgba(context, of)
    assert np.array_equal(whole, rgba(context, of, tile=(8, 8)))
    monkeypatch.setattr("clvol.integrators.slicing.half_angle_caster._SECONDS_A_SAMPLE", 1e-3)
    assert np.array_equal(whole, rgba(context, of))


def test_a_caster_shows_each_camera_as_a_new_one_would(context):
    of = half_angle()
    kept = HalfAngleCaster(context, of)
    for position in ([0.0, 0.0, -60.0], [60.0, 10.0, 0.0], [0.0, 50.0, 40.0]):
        camera = of.camera.model_copy(update={"position": position})
        anew = HalfAngleCaster(context, replace(of, camera=camera))
        assert np.array_equal(kept.render(camera, 16, 16).rgba, anew.render(camera, 16, 16).rgba)


def test_wide_views_from_within_the_volume_are_those_of_the_twin(context):
    """Some rays run along the slices."""
    camera = {**NEAR, "position": [12.0, 12.0, 2.0], "target": [11.0, 12.0, 9.0], "fov_degrees": 130.0}
    of = half_angle(camera=camera)
    assert np.abs(rgba(context, of) - render_half_angle_twin(of)).max() < 2e-3


def test_a_scattering_cone_of_no_width_is_the_light_itself(context):
    shadow = {"resolution": 24, "scattering": 1.0, "scatter_color": [0, 0, 0], "cone_degrees": 0}
    assert np.abs(rgba(context, half_angle(shadow=shadow)) - rgba(context, half_angle())).max() < 1e-5


def test_depth_is_where_opacity_reaches_one_half(context):
    of = half_angle(step=0.25)
    got, truth = (
        caster(context, scene_).render(of.camera, 32, 32).depth
        for caster, scene_ in ((HalfAngleCaster, of), (Raycaster, by_rays(of)))
    )
    both = np.isfinite(got) & np.isfinite(truth)
    assert both.sum() > 20 and np.abs(got[both] - truth[both]).max() < 0.1
    assert (np.isfinite(got) != np.isfinite(truth)).sum() < 3


# --- only what is called for ----------------------------------------------------------------------


def test_without_shadows_slices_are_those_across_the_view(context):
    unlit = half_angle()
    unlit = replace(unlit, lights=(), shadow=None)
    plain = replace(unlit, slicing=Slicing(geometry="view-aligned"))
    assert explain(unlit)["kernel_hash"] == explain(plain)["kernel_hash"] != explain(half_angle())["kernel_hash"]
    caster = integrator_of(unlit)
    assert dict(caster.programs(unlit, 16)) == dict(caster.programs(plain, 16))


def test_other_methods_are_not_changed_by_the_table():
    of = by_rays(half_angle())
    assert explain(of)["kernel_hash"] == explain(replace(of, slicing=Slicing()))["kernel_hash"]


def test_the_effect_is_explained():
    found = {effect.name: effect for effect in effects(half_angle())}["half-angle slices"]
    assert found.called_for and "light" in found.reason
    idle = {effect.name: effect for effect in effects(by_rays(half_angle()))}["half-angle slices"]
    assert not idle.called_for and "raycast" in idle.reason


def test_an_empty_function_shows_nothing(context):
    of = half_angle(function=constant_function(0.0))
    assert not rgba(context, of).any()


def test_clips_that_leave_nothing_show_nothing(context):
    of = half_angle(clip=[{"type": "plane", "point": [1000, 0, 0], "normal": [1, 0, 0]}])
    assert not rgba(context, of).any()


def test_what_slices_cannot_show_is_refused():
    def refused(message, **how):
        with pytest.raises(SceneError, match=message):
            check_scene(half_angle(**how))

    refused("2 lights that cast shadows", light=[SLANTED, POINT])
    refused("light.0..position.*a light farther away", light={"type": "point", "position": [11.0, 12.0, 40.0]})
    refused("a light farther away", light={"type": "point", "position": [11.5, 11.5, 11.5]})
    refused("slicing.accumulate", slicing={"accumulate": "uint8"})
    refused("slicing.opacity_correction", slicing={"opacity_correction": False})
    refused("shadow.method: got 'rays'", shadow={"method": "rays"})
    refused("calls for isosurfaces", isosurface=[{"value": 5.0, "opacity": 1.0}])
    check_scene(half_angle(light=[SLANTED, {**POINT, "casts_shadow": False}]))


def test_light_that_does_not_fit_is_refused():
    of = half_angle(shadow={"resolution": 100})
    needed = light_volume_bytes(of)
    assert needed > 4 * 100**2 * Slabs(of).count
    check_fits(of, DeviceLimits(memory=needed, buffer=needed))
    with pytest.raises(SceneError, match="shadow.resolution: got 100: the light of half-angle slices takes"):
        check_fits(of, DeviceLimits(memory=2**40, buffer=needed - 1))
