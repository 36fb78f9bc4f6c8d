"""Light at both ends of pre-integrated segments: against the plain twin, and what it gains."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, LIGHTS, MATERIAL, ball, blobs, oblique, picture, scene, twin

from clvol import TransferFunction
from clvol.errors import SceneError
from clvol.explanation import kernel_hash
from clvol.features import called_for, effects
from clvol.integrators.registry import check_scene

SHAPE = (15, 17, 19)
AT_ENDS = {"material": {**MATERIAL, "light_at": "ends"}}
LIT = {"light": LIGHTS, "gradient": {"storage": "on-the-fly"}, "camera": oblique(SHAPE)}
PEAKS = TransferFunction(
    [0.0, 0.3, 0.33, 0.36, 0.6, 0.63, 0.66, 1.0], [0.0, 0.0, 0.6, 0.0, 0.0, 0.9, 0.0, 0.0],
    [[0.2, 0.4, 0.9]] * 4 + [[0.9, 0.5, 0.2]] * 4,
)  # fmt: skip


def preintegrated(function=HAZE, step=1.0, array=None, **tables):
    integration = {"classification": "preintegrated", "step": step, **tables.pop("integration", {})}
    return scene(blobs(SHAPE) if array is None else array, function, integration=integration, **{**LIT, **tables})


CASES = {
    "smooth": {},
    "long step": {"step": 2.9},
    "peaks": {"function": PEAKS, "step": 2.0},
    "opaque": {"function": TransferFunction([0.0, 0.4, 0.7, 1.0], [0.0, 0.0, 1.0, 1.0], HAZE.colors)},
    "cut": {"clip": [{"point": [9.0, 8.0, 7.0], "normal": [1.0, 0.4, -0.3]}]},
}


@pytest.mark.parametrize("case", [
    each if each != "cut" else pytest.param(each, marks=pytest.mark.slow) for each in CASES
])  # with clips it is another program
def test_pictures_lit_at_both_ends_are_the_twins(context, case):
    """The mean place is that of a series for thin pieces: within 0.01 of a piece, by which light differs little."""
    resolved = preintegrated(**AT_ENDS, **CASES[case])
    found, expected = picture(context, resolved).rgba, twin(resolved)
    assert expected[..., 3].max() > 0.1
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)
    middle = twin(preintegrated(material=MATERIAL, **CASES[case]))
    assert np.abs(middle - expected).max() > 2e-3


def test_narrow_peaks_in_long_steps_are_lit_where_they_are(context):
    """Shells of a ball: light in the middle of a segment is off by up to half a step. Half the pixels' light is at most
    half as wrong; at silhouettes, where a segment enters and leaves a shell, neither is right."""
    array = ball((33, 33, 33)) / 16.0
    shell = TransferFunction([0.0, 0.68, 0.7, 0.72, 2.0], [0.0, 0.0, 0.9, 0.0, 0.0], [[1.0, 0.9, 0.8]] * 5)

    def light(step, light_at):
        material = {**MATERIAL, "light_at": light_at}
        rgba = picture(context, preintegrated(shell, step, array, material=material, camera=oblique(array.shape),
                                              size=(60, 50))).rgba  # fmt: skip
        return rgba[..., :3] / np.maximum(rgba[..., 3:], 1e-6), rgba[..., 3] > 0.2

    exact, there = light(0.1, "ends")
    middle, ends = (np.median(np.abs(light(2.0, at)[0] - exact)[there]) for at in ("middle", "ends"))
    assert ends < 0.65 * middle


def test_it_is_called_for_where_segments_are_pre_integrated():
    name = "light at both ends"
    assert name in called_for(preintegrated(**AT_ENDS))
    for idle, reason in (
        (preintegrated(material=MATERIAL), "lit in their middle"),
        (preintegrated(**AT_ENDS, integration={"classification": "post"}), "whose segments have one value"),
        (preintegrated(**{**AT_ENDS, "light": []}), "no light"),
    ):
        told = {effect.name: effect for effect in effects(idle)}[name]
        assert not told.called_for and reason in told.reason
    post, middle = ({"integration": {"classification": "post"}, **more} for more in (AT_ENDS, {"material": MATERIAL}))
    assert kernel_hash(preintegrated(**post)) == kernel_hash(preintegrated(**middle))


def test_two_gradients_and_lights_are_counted_per_segment(context):
    one, two = (picture(context, preintegrated(material={**MATERIAL, "light_at": at})).counters
                for at in ("middle", "ends"))  # fmt: skip
    assert two["gradients"] == 2 * one["gradients"]
    assert 1.9 * one["lit_samples"] < two["lit_samples"] <= 2 * one["lit_samples"]


def test_holes_and_even_fields_are_not_lit(context):
    array = blobs(SHAPE)
    array[5:8, 6:9, 7:11], array[:4] = np.nan, 0.8
    found = picture(context, preintegrated(array=array, **AT_ENDS)).rgba
    assert np.isfinite(found).all()


@pytest.mark.parametrize("tables, where", [
    ({"isosurface": [{"value": 0.5}]}, "isosurface"),
    ({"transfer_layer": [{"magnitude": 0.1, "points": [{"value": 0.0, "opacity": 0.3, "color": [1, 1, 1]}]}]}, "layer"),
    ({"integration": {"segments": "integral-table"}}, "segments"),
])  # fmt: skip
def test_what_it_cannot_be_combined_with_is_refused(tables, where):
    with pytest.raises(SceneError, match=where):
        check_scene(preintegrated(**AT_ENDS, **tables))
