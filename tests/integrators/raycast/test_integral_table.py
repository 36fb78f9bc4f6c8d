"""Pre-integration by tables of integral functions, beside the closed form."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, blobs, oblique, picture, scaled, scene
from reference import render_twin

from clvol import TransferFunction, Volume
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import called_for, reduced
from clvol.transfer.integral_table import HEAD, integral_table

SHAPE = (13, 15, 17)
FIELD = blobs(SHAPE, 3, 1.0)
PEAKS = TransferFunction(
    [0.0, 0.2, 0.25, 0.3, 0.6, 0.62, 0.64], [0.0, 0.0, 0.3, 0.0, 0.0, 0.5, 0.0],
    [[0, 0, 0], [0.9, 0.4, 0.1], [0.9, 0.4, 0.1], [0.9, 0.4, 0.1], [0.1, 0.5, 0.9], [0.1, 0.5, 0.9], [0.1, 0.5, 0.9]],
)  # fmt: skip


def looked_up(array=FIELD, function=PEAKS, entries=256, **tables):
    integration = {"classification": "preintegrated", "segments": "integral-table", "table_size": entries}
    integration |= tables.pop("integration", {})
    return scene(array, function, camera=oblique(SHAPE), integration=integration, **tables)


def test_entries_are_the_integrals_at_even_nodes():
    table = integral_table(HAZE, 0.0, 1.0, 33, 0.0)
    assert table.dtype == np.float32 and table.size == HEAD + 4 * 33
    entries = table[HEAD:].reshape(33, 4)
    assert not entries[0].any() and (np.diff(entries, axis=0) >= 0).all()
    fine = (np.arange(20000) + 0.5) / 20000
    tau = -np.log1p(-HAZE.opacity(fine))
    np.testing.assert_allclose(entries[-1, 0], tau.mean(), rtol=1e-5)
    np.testing.assert_allclose(entries[-1, 1:], (tau[:, None] * HAZE.color(fine)).mean(axis=0), rtol=1e-5)


@pytest.mark.every_case
@pytest.mark.parametrize("entries", [16, 256])
def test_a_picture_is_that_of_the_tables(context, entries):
    resolved = reduced(looked_up(entries=entries))
    assert "integral tables" in called_for(resolved)
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=1e-4)


def test_other_devices_look_up_the_same(other_device, contexts):
    resolved = reduced(looked_up())
    np.testing.assert_allclose(picture(contexts(other_device), resolved).rgba, render_twin(resolved), atol=1e-4)


@pytest.mark.slow
def test_with_steps_and_entries_it_comes_to_the_closed_form(context):
    exact = picture(context, reduced(looked_up(integration={"segments": "pieces", "step": 0.05}))).rgba
    errors = []
    for step, entries in ((1.0, 128), (0.5, 512), (0.25, 1024)):
        rgba = picture(context, reduced(looked_up(entries=entries, integration={"step": step}))).rgba
        errors.append(float(np.sqrt(np.mean((rgba - exact) ** 2))))
    assert errors[0] > 1.5 * errors[1] > 2.0 * errors[2]
    closed = picture(context, reduced(looked_up(integration={"segments": "pieces"}))).rgba
    assert np.sqrt(np.mean((closed - exact) ** 2)) < 0.5 * errors[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    "tables", [{"light": [{"type": "headlight"}]}, {"isosurface": [{"value": 0.4, "opacity": 0.5}]}]
)
def test_effects_take_looked_up_segments(context, tables):
    resolved = reduced(looked_up(**tables))
    # Parts of segments have their share of the light by their opacity, as all effects take it, not by their length.
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=2e-2)


def test_voxels_that_are_no_numbers_and_values_far_from_zero(context):
    holes = FIELD.copy()
    holes[3:6, 4:9, 2:7] = np.nan
    for array, function in ((holes, PEAKS), (FIELD + np.float32(64.0), None)):
        if function is None:
            function = TransferFunction(PEAKS.values + 64.0, PEAKS.opacities, PEAKS.colors)
        resolved = reduced(looked_up(array, function))
        np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=3e-3)


def test_a_constant_volume(context):
    even = Volume(np.full(SHAPE, 0.25, np.float32))
    rgba = picture(context, reduced(looked_up(even, PEAKS))).rgba
    closed = picture(context, reduced(looked_up(even, PEAKS, integration={"segments": "pieces"}))).rgba
    np.testing.assert_allclose(rgba[..., 3], closed[..., 3], atol=0.02)


def test_where_nothing_shows_nothing_is_looked_up():
    clear = scaled(TransferFunction([2.0, 3.0], [0.0, 1.0], [[1, 1, 1]] * 2), 1.0)
    idle, plain = looked_up(function=clear), looked_up(function=clear, integration={"segments": "pieces"})
    assert kernel_hash(idle) == kernel_hash(plain) and "integral tables" not in called_for(idle)


@pytest.mark.parametrize(
    "integration, what",
    [
        ({"classification": "post"}, "with the classification 'post'"),
        ({"compositing": "maximum"}, "with the compositing 'maximum'"),
        ({"quadrature": "cells"}, "with the quadrature 'cells'"),
        ({"method": "pyramid"}, "with the method 'pyramid'"),
        ({"filter": "nearest"}, "with the filter 'nearest'"),
    ],
)
def test_where_segments_are_not_pre_integrated_tables_are_refused(integration, what):
    with pytest.raises(SceneError, match=f"integration.segments: got 'integral-table' {what}"):
        explain(looked_up(integration=integration))
