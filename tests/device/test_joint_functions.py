"""Joint transfer functions: of the volume's value and those of one or two further fields."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import blobs, oblique, picture, scene
from reference import render_twin

from clvol import TransferFunction, Volume
from clvol.errors import SceneError
from clvol.explanation import kernel_hash
from clvol.features import called_for, effects, reduced

SHAPE = (13, 15, 17)
FIRST, SECOND, THIRD = (blobs(SHAPE, seed, 200.0, np.uint8) for seed in (3, 8, 5))
CLEAR = TransferFunction([0.0, 200.0], [0.0, 0.05], [[0.2, 0.2, 0.9]] * 2)


def points(opacity: float, color) -> list[dict]:
    return [
        {"value": 20.0, "opacity": 0.0, "color": color},
        {"value": 90.0, "opacity": opacity, "color": color},
        {"value": 200.0, "opacity": 0.5 * opacity, "color": color},
    ]


def value_field(array, **keys) -> dict:
    grid = {key: keys.pop(key) for key in ("spacing", "origin", "slope", "offset") if key in keys}
    return {"file": Volume(array, **grid), "role": "value", **keys}


TWO = [
    {"values": [60.0], "points": points(0.4, [0.9, 0.6, 0.1])},
    {"values": [150.0], "points": points(0.2, [0.1, 0.9, 0.2])},
]
THREE = [
    {"values": [a, b], "points": points(opacity, color)}
    for a, b, opacity, color in (
        (120.0, 100.0, 0.5, [1.0, 1.0, 0.2]), (120.0, 0.0, 0.3, [0.9, 0.1, 0.1]), (0.0, 100.0, 0.2, [0.1, 0.9, 0.1]),
    )
]  # fmt: skip


def joint(layers=TWO, *fields, array=FIRST, **tables):
    fields = fields or (value_field(SECOND, base=0.0),)
    return scene(array, CLEAR, transfer_layer=layers, field=fields, camera=oblique(SHAPE), **tables)


@pytest.mark.every_case
@pytest.mark.parametrize("classification", ["post", "preintegrated"])
def test_a_function_of_two_fields_is_the_twins(context, classification):
    resolved = reduced(joint(integration={"classification": classification}))
    names = called_for(resolved)
    assert "joint transfer function" in names and "gradients" not in names
    data = picture(context, resolved)
    np.testing.assert_allclose(data.rgba, render_twin(resolved), atol=3e-5)
    assert data.counters["field_samples"] > 0 and "gradients" not in data.counters
    alone = picture(context, reduced(joint([TWO[0] | {"points": points(0.0, [0, 0, 0])}]))).rgba
    assert abs(alone - data.rgba).max() > 0.05


def test_a_function_of_three_fields_is_the_twins(context):
    resolved = reduced(joint(THREE, value_field(SECOND, base=0.0), value_field(THIRD, base=0.0)))
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=3e-5)


@pytest.mark.exhaustive  # a program of a minute
def test_other_devices_render_the_same(other_device, contexts):
    resolved = reduced(joint(THREE, value_field(SECOND, base=0.0), value_field(THIRD, base=0.0)))
    np.testing.assert_allclose(picture(contexts(other_device), resolved).rgba, render_twin(resolved), atol=3e-5)


@pytest.mark.slow
def test_shadows_follow_a_joint_function(context):
    light = [{"type": "directional", "direction": [0.3, -1.0, 0.5]}]
    resolved = reduced(joint(THREE, value_field(SECOND, base=0.0), value_field(THIRD, base=0.0), light=light,
                             shadow={"method": "rays", "bound": 0.0}))  # fmt: skip
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=3e-3)


@pytest.mark.slow
def test_leaping_changes_no_bit(context):
    sparse = np.where(FIRST > 150, FIRST, 0).astype(np.uint8)
    hidden = [TWO[0] | {"points": [{"value": 149.0, "opacity": 0, "color": [1, 1, 1]}, *points(0.5, [1, 0, 0])[2:]]}]
    resolved = scene(sparse, TransferFunction([0.0], [0.0], [[0, 0, 0]]), transfer_layer=hidden,
                     field=[value_field(SECOND)], camera=oblique(SHAPE))  # fmt: skip
    leaping, marching = (picture(context, reduced(resolved), skip=skip) for skip in (True, False))
    assert np.array_equal(leaping.rgba, marching.rgba) and leaping.rgba.max() > 0.0


def test_where_a_field_has_no_value_the_function_holds(context):
    holes = SECOND.astype(np.float32)
    holes[:, :, 9:] = np.nan
    far = value_field(SECOND, origin=(100.0, 0.0, 0.0), base=0.0)
    plain = picture(context, reduced(scene(FIRST, CLEAR, camera=oblique(SHAPE)))).rgba
    outside = picture(context, reduced(joint(TWO, far))).rgba
    np.testing.assert_allclose(outside, plain, atol=2e-5)
    resolved = reduced(joint(TWO, value_field(holes, base=0.0)))
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=3e-5)


def test_a_field_with_a_slope_is_stated_in_its_values(context):
    stored = reduced(joint())
    layers = [layer | {"values": [0.5 * layer["values"][0] - 10.0]} for layer in TWO]
    sloped = reduced(joint(layers, value_field(SECOND, slope=0.5, offset=-10.0, base=-10.0)))
    np.testing.assert_array_equal(picture(context, sloped).rgba, picture(context, stored).rgba)


def test_layers_equal_to_the_function_call_for_nothing():
    color = CLEAR.colors[0].tolist()
    same = [{"value": float(v), "opacity": float(o), "color": color} for v, o in zip(CLEAR.values, CLEAR.opacities)]
    table = {"points": same, "color_space": "linear"}
    layers = [{"values": [60.0], "points": same}]
    tables = {"camera": oblique(SHAPE)}
    idle = scene(FIRST, table, transfer_layer=layers, field=[value_field(SECOND)], **tables)
    told = {effect.name: effect for effect in effects(idle)}["joint transfer function"]
    assert not told.called_for and "the transfer function itself" in told.reason
    assert kernel_hash(idle) == kernel_hash(scene(FIRST, table, **tables)) and not reduced(idle).fields


@pytest.mark.parametrize(
    "layers, fields, what",
    [
        (THREE[:2], 2, "no layer at values"),
        (TWO, 2, "1 values beside 2 fields"),
        (THREE, 1, "2 values beside 1 fields"),
        ([TWO[0], TWO[0]], 1, "two functions for the same values"),
        ([TWO[0] | {"values": [-5.0]}], 1, "below"),
        ([], 1, "0 values beside 1 fields"),
        ([TWO[0] | {"magnitude": 3.0}], 1, "either a magnitude or values"),
    ],
)
def test_layers_that_are_no_grid_are_refused(layers, fields, what):
    with pytest.raises(SceneError, match=what):
        joint(layers, *[value_field(each, base=0.0) for each in (SECOND, THIRD)[:fields]])
