"""Transfer functions made from the data."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import picture
from helpers.small_scenes import axis_camera
from scipy.special import erf

from clvol import Scene, Volume
from clvol.choice.generated import ROWS, generate, measured
from clvol.choice.sample import sample_of
from clvol.errors import SceneError
from clvol.features import called_for, reduced

LOW, HIGH, BLUR, RADIUS, EDGE = 50.0, 200.0, 2.0, 11.0, 0.5


def ball(n=36, noise=0.0, dtype=np.float32) -> np.ndarray:
    """A ball whose boundary a Gaussian of BLUR voxels has blurred."""
    z, y, x = np.mgrid[:n, :n, :n] - (n - 1) / 2
    field = LOW + (HIGH - LOW) * 0.5 * (1 + erf((RADIUS - np.sqrt(x**2 + y**2 + z**2)) / (BLUR * np.sqrt(2))))
    field += np.random.default_rng(1).normal(0.0, noise, field.shape) if noise else 0.0
    return np.round(field).astype(dtype) if np.dtype(dtype).kind in "iu" else field.astype(dtype)


def volume(**keys) -> Volume:
    return Volume(ball(**keys), spacing=(EDGE,) * 3)


def shown(curve, share=0.0):
    values, opacities = np.array(curve).T
    return values[opacities > share * opacities.max()]


def test_the_width_of_a_boundary_is_measured():
    found = measured(sample_of(volume()))
    expected = EDGE * np.sqrt(BLUR**2 + 1.0)  # that of the data and of the derivatives' own Gaussian
    assert found.blur == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("thickness", [1.0, 2.0])
def test_a_boundary_is_shown_as_far_from_its_middle_as_asked(thickness):
    curve = generate(sample_of(volume()), "boundary", 0.8, thickness).curve
    values, opacities = np.array(curve).T
    assert opacities.max() == pytest.approx(0.8, abs=0.05)
    middle = 0.5 * (LOW + HIGH)
    assert abs(values[opacities.argmax()] - middle) < 8.0
    expected = middle + 0.5 * (HIGH - LOW) * erf(thickness / (BLUR * np.sqrt(2)))
    assert shown(curve, 0.05).max() == pytest.approx(expected, abs=8.0)
    assert shown(curve, 0.05).min() == pytest.approx(2 * middle - expected, abs=8.0)


def test_noise_and_whole_numbers_leave_the_boundary_where_it_is():
    curve = generate(sample_of(volume(noise=4.0, dtype=np.uint8)), "boundary", 0.8, 1.0).curve
    assert 95.0 < np.mean(shown(curve, 0.5)) < 155.0
    assert not np.any(np.abs(shown(curve, 0.1) - LOW) < 8.0)


def test_of_two_values_what_has_no_gradient_is_no_boundary():
    made = generate(sample_of(volume()), "boundary-2d", 0.8, 1.0)
    assert not shown(made.curve).size and len(made.layers) == ROWS - 1
    magnitudes = [magnitude for magnitude, _ in made.layers]
    assert magnitudes == sorted(magnitudes) and magnitudes[0] > 0
    assert max(opacity for _, curve in made.layers for _, opacity in curve) == pytest.approx(0.8, abs=0.1)
    top = made.layers[-1][1]
    assert abs(np.mean(shown(top, 0.5)) - 125.0) < 20.0


@pytest.mark.parametrize("how", ["histogram", "histogram-2d"])
def test_what_is_rare_shows_and_what_is_frequent_does_not(how):
    made = generate(sample_of(volume(dtype=np.uint8)), how, 0.6, 1.0)
    values, opacities = np.array(made.curve).T
    assert np.interp(LOW, values, opacities) == pytest.approx(0.0, abs=1e-6)  # most voxels
    if how == "histogram":
        assert np.interp(125.0, values, opacities) > np.interp(HIGH, values, opacities) > 0.0
        counts = np.bincount(ball(dtype=np.uint8).ravel(), minlength=256)
        expected = 0.6 * (1 - np.log1p(counts[HIGH_VALUE]) / np.log1p(counts.max()))
        assert np.interp(HIGH_VALUE, values, opacities) == pytest.approx(expected, abs=0.02)


HIGH_VALUE = 199


@pytest.mark.parametrize("change", [{}, {"hole": True}, {"flat": True}])
def test_voxels_without_a_value_and_without_a_depth_are_left_out(change):
    data = ball()
    if change.get("hole"):
        data[:, :12] = np.nan
    if change.get("flat"):
        data = data[18:19]
    curve = generate(sample_of(Volume(data, spacing=(EDGE,) * 3)), "boundary", 0.8, 1.0).curve
    assert np.isfinite(curve).all() and 95.0 < np.mean(shown(curve, 0.5)) < 155.0


def test_a_constant_or_empty_volume_has_a_function_too():
    for data in (np.full((4, 4, 4), 7, np.uint8), np.full((4, 4, 4), np.nan, np.float32)):
        scene = Scene(volume=Volume(data), transfer_function={"generator": "boundary"})
        assert scene.resolve().transfer_function.values.size == 1


def test_a_scene_names_a_generator():
    resolved = Scene(volume=volume(), transfer_function={"generator": "boundary-2d", "strength": 0.3}).resolve()
    assert len(resolved.transfer_layers) == ROWS - 1
    assert resolved.transfer_function.opacity_unit == pytest.approx(EDGE)
    assert "two-dimensional transfer function" in called_for(resolved)
    colored = Scene(volume=volume(), transfer_function={"generator": "histogram", "colormap": "viridis"}).resolve()
    red, green, blue = colored.transfer_function.colors[-1]
    assert red > 0.8 and green > 0.7 and blue < 0.1  # yellow, the end of viridis


def test_values_of_a_slope_are_those_of_the_function():
    stored = Scene(volume=volume(), transfer_function={"generator": "boundary"}).resolve()
    sloped = Volume(ball(), spacing=(EDGE,) * 3, slope=2.0, offset=100.0)
    resolved = Scene(volume=sloped, transfer_function={"generator": "boundary"}).resolve()
    np.testing.assert_allclose(
        resolved.transfer_function.opacity(np.linspace(60, 190, 50)),
        stored.transfer_function.opacity(np.linspace(60, 190, 50)), atol=0.03,
    )  # fmt: skip


def test_a_generated_function_shows_the_boundary_and_not_the_inside(context):
    scene = Scene(
        volume=volume(), transfer_function={"generator": "boundary", "strength": 0.2},
        camera=axis_camera((8.75, 8.75, 8.75), 2, height=17.0), image={"width": 33, "height": 33},
    )  # fmt: skip
    alpha = picture(context, reduced(scene.resolve())).rgba[..., 3]
    assert alpha[0, 0] == 0.0
    rim, middle = alpha[16, 33 * 4 // 10 - 8 : 10].max(), alpha[16, 16]
    assert rim > middle > 0.05  # rays along the boundary see more of it


@pytest.mark.parametrize(
    "table, what",
    [
        ({"generator": "boundary", "preset": "hot"}, "either preset or generator"),
        ({"strength": 0.3}, "no strength without a generator"),
        ({"generator": "edges"}, "transfer_function.generator"),
    ],
)
def test_wrong_tables_are_refused(table, what):
    with pytest.raises(SceneError, match=what):
        Scene(volume=volume(), transfer_function=table)


def test_layers_of_ones_own_are_not_mixed_with_generated_ones():
    layer = {"magnitude": 3.0, "points": [{"value": 0.0, "opacity": 0.1, "color": [1, 1, 1]}]}
    scene = Scene(volume=volume(), transfer_function={"generator": "histogram-2d"}, transfer_layer=[layer])
    with pytest.raises(SceneError, match="in a scene with"):
        scene.resolve()
