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
    step_row,
    steps_of_two,
    table_without_self_attenuation,
)

from clvol.render.raycast import Raycaster
from clvol.transfer.preintegration import preintegrate
from clvol.transfer.tables import SLICES, preintegrated_table
from clvol.volume.procedural import Constant


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


def test_a_table_for_segments_one_part_in_a_thousand_too_long_departs(context):
    def table(caster):
        function, nodes = caster.resolved.transfer_function, caster.nodes.values
        return preintegrated_table(context, function, nodes, 1.001 * caster.length)

    assert broken(context, table=table)


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


def test_without_self_attenuation_opacity_is_the_same_and_light_is_more(context):
    scene = Case(gridded(RAMP, 3), SMOOTH).scene(4, 0.5, classification="preintegrated")
    caster = Raycaster(context, scene)
    other = context.read(table_without_self_attenuation(caster))
    n = caster.nodes.values.size
    table = context.read(caster.table)
    assert other.shape == table.shape == (SLICES, n + 2, n + 2, 4)
    np.testing.assert_allclose(other[..., 3], table[..., 3], atol=2e-6)
    light, attenuated = (t[0, :n, :n, :3] for t in (other, table))
    assert np.all(light > attenuated)
    # Of a constant value D = tau h instead of 1 - exp(-D); there and back together: 1 + D / 2 + ...
    depth = table[1, :n, :n, 3:]
    k = np.arange(n)
    expected = depth[k, k] / -np.expm1(-depth[k, k])
    ratio = light / attenuated
    np.testing.assert_allclose(ratio[k, k], np.repeat(expected, 3, axis=1), rtol=1e-5)
    both_ways = 0.5 * (attenuated + attenuated.swapaxes(0, 1))
    np.testing.assert_allclose(light / both_ways / (1 + depth / 2), 1.0, rtol=0.02)


def test_between_pixel_centres_a_plane_is_a_plane():
    row, column = np.mgrid[:5, :7].astype(float)
    picture = np.stack([row, column, 2 * row - column, np.ones_like(row)], axis=2)
    points = np.array([[0.0, 0.0], [1.25, 3.5], [3.99, 5.99]])
    expected = [[r, c, 2 * r - c, 1.0] for r, c in points]
    np.testing.assert_allclose(bilinear(picture, points), expected, atol=1e-12)
