"""Verification by convergence: each quadrature, the grid and the pixels show the order that theory
expects (bench/convergence_rows.py says why), and what the rows are compared with is right."""

from __future__ import annotations

import numpy as np
import pytest

from bench.convergence_rows import (
    RAMP,
    ROWS,
    SMOOTH,
    Case,
    analytic_picture,
    bilinear,
    chords_picture,
    exact,
    gridded,
    one_cell,
    rms,
    segment_without_self_attenuation,
    step_row,
    steps_of_two,
)
from clvol.transfer.preintegration import preintegrate
from clvol.volume.procedural import Constant


@pytest.mark.slow
@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_the_observed_order_is_that_of_theory(context, row):
    measured = row.measure(context)
    assert measured.departure(row.expected, row.band) is None, measured
    for wrong in (row.expected - 1, row.expected + 1):
        assert measured.departure(wrong, row.band)


# --- a defect shows -------------------------------------------------------------------------------


def broken(context, **how):
    row = step_row(
        "broken", "", 2.0, "", lambda: Case(one_cell(), SMOOTH), steps_of_two(1, 5),
        **{"classification": "preintegrated", **how},
    )  # fmt: skip
    return row.measure(context).departure(row.expected, row.band)


def test_segments_one_part_in_a_thousand_too_long_depart(context):
    def spoil(caster):
        caster.step_units *= 1.001

    assert broken(context, spoil=spoil)


@pytest.mark.parametrize("missing", ["the last piece", "the attenuation"])
def test_a_twin_that_forgets_something_departs(context, missing):
    def picture(scene):
        if missing == "the attenuation":
            return chords_picture(scene, attenuate=False)
        return chords_picture(scene, last_piece=False)

    assert broken(context) is None
    assert broken(context, host=chords_picture) is None
    assert broken(context, host=picture)


# --- what the rows compare with -------------------------------------------------------------------


def test_the_analytic_integral_of_a_constant_is_the_closed_form():
    scene = Case(gridded(Constant(0.4), 2), SMOOTH, (0.0, 0.0, 50.0)).scene(1, 1.0)
    opacity = -np.expm1(-2.0 * SMOOTH.extinction(0.4))
    expected = [*(opacity * SMOOTH.color(0.4)), opacity]
    np.testing.assert_allclose(analytic_picture(Constant(0.4), scene)[0, 0], expected, rtol=1e-13)


def test_the_analytic_integral_of_a_ramp_is_one_preintegrated_segment():
    scene = Case(gridded(RAMP, 2), SMOOTH, (0.0, 0.0, 50.0)).scene(1, 1.0)
    expected = preintegrate(SMOOTH, RAMP(0, 0, 1.0), RAMP(0, 0, -1.0), 2.0)
    np.testing.assert_allclose(analytic_picture(RAMP, scene)[0, 0], expected, rtol=1e-12)


@pytest.mark.parametrize("step", [0.07, 0.3, 5.0])
def test_chords_are_exact_where_the_value_is_linear(context, step):
    case = Case(gridded(RAMP, 5), SMOOTH)
    scene = case.scene(8, step)
    assert rms(chords_picture(scene), analytic_picture(RAMP, scene)) < 1e-12
    assert rms(exact(context, scene), analytic_picture(RAMP, scene)) < 1e-9


def test_without_self_attenuation_opacity_is_the_same_and_light_is_more():
    values = np.linspace(RAMP(0, 0, -1.0), RAMP(0, 0, 1.0), 9)
    front, back = (a.ravel() for a in np.meshgrid(values, values))
    length = np.full(front.size, 0.5)
    other = segment_without_self_attenuation(SMOOTH, front, back, length)
    exact_ = preintegrate(SMOOTH, front, back, length)
    np.testing.assert_allclose(other[:, 3], exact_[:, 3], rtol=1e-9)
    light, attenuated = other[:, :3], exact_[:, :3]
    assert np.all(light > attenuated)
    # Of a constant value D = tau h instead of 1 - exp(-D); there and back together: 1 + D / 2 + ...
    depth = -np.log1p(-exact_[:, 3])[:, None]
    constant = front == back
    ratio = light / attenuated
    expected = depth[constant] / -np.expm1(-depth[constant])
    np.testing.assert_allclose(ratio[constant], np.repeat(expected, 3, axis=1), rtol=1e-9)
    both_ways = 0.5 * (attenuated + preintegrate(SMOOTH, back, front, length)[:, :3])
    np.testing.assert_allclose(light / both_ways / (1 + depth / 2), 1.0, rtol=0.02)


def test_between_pixel_centres_a_plane_is_a_plane():
    row, column = np.mgrid[:5, :7].astype(float)
    picture = np.stack([row, column, 2 * row - column, np.ones_like(row)], axis=2)
    points = np.array([[0.0, 0.0], [1.25, 3.5], [3.99, 5.99]])
    expected = [[r, c, 2 * r - c, 1.0] for r, c in points]
    np.testing.assert_allclose(bilinear(picture, points), expected, atol=1e-12)
