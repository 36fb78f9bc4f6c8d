"""Associated colours: light that is emitted whatever is absorbed."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import blobs, oblique, picture, scene
from helpers.small_scenes import axis_camera
from reference import render_twin

from clvol import Renderer, Volume
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import called_for, reduced

SHAPE = (13, 15, 17)
FIELD = blobs(SHAPE, 3, 200.0, np.uint8)
# A flame: light from values that absorb nothing, smoke that emits nothing, and a step.
POINTS = [
    {"value": 20.0, "opacity": 0.0, "color": [0.0, 0.0, 0.0]},
    {"value": 60.0, "opacity": 0.0, "color": [0.9, 0.3, 0.05]},
    {"value": 90.0, "opacity": 0.1, "color": [0.0, 0.0, 0.0]},
    {"value": 130.0, "opacity": 0.3, "color": [0.1, 0.2, 0.6]},
    {"value": 130.0, "opacity": 0.2, "color": [0.5, 0.8, 0.9]},
]


def glowing(array=FIELD, points=POINTS, emission=1.0, associated=True, **tables):
    function = {"points": points, "opacity_unit": 2.0, "associated": associated}
    function |= {"emission": emission} if associated else {}
    return scene(array, function, **{"camera": oblique(SHAPE), **tables})


@pytest.mark.every_case
@pytest.mark.parametrize("classification", ["post", "preintegrated"])
def test_associated_colours_are_the_twins(context, classification):
    resolved = reduced(glowing(integration={"classification": classification}, emission=3.0))
    assert "associated colours" in called_for(resolved)
    rgba = picture(context, resolved).rgba
    np.testing.assert_allclose(rgba, render_twin(resolved), atol=2e-4)
    assert rgba[..., :3].max() > 1.0  # brighter than white


@pytest.mark.slow  # Intel's compiler
def test_other_devices_show_the_same_light(other_device, contexts):
    resolved = reduced(glowing(integration={"classification": "preintegrated"}))
    np.testing.assert_allclose(picture(contexts(other_device), resolved).rgba, render_twin(resolved), atol=2e-4)


@pytest.mark.parametrize("step", [0.5, 3.0])
def test_a_slab_that_absorbs_nothing_emits_in_proportion_to_its_length(context, step):
    points = [{"value": 0.0, "opacity": 0.0, "color": [0.5, 0.25, 1.0]}]
    block = Volume(np.full((9, 9, 9), 7, np.uint8))
    camera = axis_camera((4.0, 4.0, 4.0), 2, height=2.0)
    table = {"points": points, "opacity_unit": 4.0, "associated": True, "color_space": "linear"}
    resolved = reduced(scene(block, table, camera=camera, size=(3, 3), integration={"step": step}))
    rgba = picture(context, resolved).rgba
    np.testing.assert_allclose(rgba[..., :3], np.broadcast_to([1.0, 0.5, 2.0], (3, 3, 3)), rtol=2e-6)
    assert not rgba[..., 3].any()


def test_a_slab_of_even_light_and_opacity_is_the_closed_form(context):
    points = [{"value": 0.0, "opacity": 0.3, "color": [0.5, 0.25, 1.0]}]
    block, camera = Volume(np.full((9, 9, 9), 7, np.uint8)), axis_camera((4.0, 4.0, 4.0), 2, height=2.0)
    table = {"points": points, "associated": True, "color_space": "linear", "opacity_unit": 1.0}
    rgba = picture(context, reduced(scene(block, table, camera=camera, size=(3, 3)))).rgba
    rate = -np.log(0.7)
    expected = np.array([0.5, 0.25, 1.0]) * (1.0 - np.exp(-8.0 * rate)) / rate
    np.testing.assert_allclose(rgba[..., :3], np.broadcast_to(expected, (3, 3, 3)), rtol=1e-5)


def test_leaping_over_empty_space_misses_no_light(context):
    sparse = np.where(FIELD > 120, FIELD, 0).astype(np.uint8)
    wide = np.zeros((40, 40, 40), np.uint8)
    wide[20:33, 4:19, 10:27] = sparse
    points = [
        {"value": value, "opacity": 0.0, "color": color} for value, color in ((100.0, [0, 0, 0]), (200.0, [1, 0.5, 0]))
    ]
    tables = {"camera": oblique(wide.shape), "integration": {"classification": "preintegrated"}}
    resolved = reduced(glowing(wide, points, **tables))
    leaping, marching = (picture(context, resolved, skip=skip) for skip in (True, False))
    assert np.array_equal(leaping.rgba, marching.rgba) and leaping.rgba.max() > 0.05
    assert leaping.samples < 0.6 * marching.samples


@pytest.mark.slow
def test_masks_clips_and_cues_act_on_light_and_lights_do_not(context):
    mask = {"file": Volume((FIELD > 50).astype(np.uint8)), "role": "mask"}
    resolved = reduced(glowing(
        field=[mask], clip=[{"point": [8.0, 7.0, 6.0], "normal": [1.0, 0.3, 0.0]}],
        depth_cue={"start": 20.0, "end": 60.0, "color": [0.2, 0.2, 0.3]},
        light=[{"type": "headlight"}], isosurface=[{"value": 150.0, "opacity": 0.4}],
    ))  # fmt: skip
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=1e-3)


def test_light_alone_is_no_blank_picture(device, recwarn):
    faint = [each | {"opacity": 0.0} for each in POINTS]
    with Renderer(glowing(points=faint), devices=[device]) as renderer:
        frame = renderer.render()
    assert frame.rgba[..., :3].max() > 0.1 and not frame.rgba[..., 3].any()
    assert not [str(each.message) for each in recwarn if "blank" in str(each.message)]


@pytest.mark.parametrize("change", [{"emission": 0.0}, {"points": [POINTS[0] | {"opacity": 0.2}]}])
def test_without_light_nothing_is_called_for(change):
    dark = glowing(**change)
    points = change.get("points", POINTS)
    black = [each | {"color": [0.0, 0.0, 0.0]} for each in points]
    assert "associated colours" not in called_for(dark)
    assert kernel_hash(dark) == kernel_hash(glowing(points=black, associated=False))


def test_stored_numbers_have_the_light_of_their_values(context):
    volume = Volume(FIELD, slope=0.5, offset=-10.0)
    points = [each | {"value": 0.5 * each["value"] - 10.0} for each in POINTS]
    one, other = reduced(glowing(volume, points)), reduced(glowing())
    np.testing.assert_allclose(picture(context, one).rgba, picture(context, other).rgba, atol=1e-6)


@pytest.mark.parametrize(
    "tables, what",
    [
        ({"integration": {"compositing": "maximum"}}, "integration.compositing: got 'maximum' with associated"),
        ({"integration": {"classification": "pre"}}, "integration.classification: got 'pre' with associated"),
        ({"animation": {"cycle": 0.5}}, "animation.cycle"),
        ({"integration": {"method": "pyramid", "classification": "preintegrated"}}, "calls for associated colours"),
    ],
)
def test_what_does_not_go_with_associated_colours_is_refused(tables, what):
    with pytest.raises(SceneError, match=what):
        explain(glowing(**tables))


def test_emission_is_of_associated_colours_alone():
    with pytest.raises(SceneError, match="no emission without associated"):
        scene(FIELD, {"points": POINTS, "emission": 2.0})
