"""Segments by the transfer function's pieces (cl/transfer_pieces.h), against their integral in double precision."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clvol.device.arguments import view_argument
from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.structs import view_dtype
from clvol.transfer import TransferFunction
from clvol.transfer.pieces import (
    DEPTH,
    SPANS,
    columns,
    depth_and_moment,
    has_opaque_point,
    piece_count,
    piece_table,
    register_pieces,
    shown_spans,
    value_gate,
)
from clvol.transfer.preintegration import preintegrate
from clvol.transfer.step_opacity import step_opacity

SOURCE = str(Path(__file__).with_name("segment_colors.cl"))
COLORS = [[0.9, 0.1, 0.0], [0.0, 0.8, 0.1], [0.1, 0.2, 1.0], [0.7, 0.7, 0.2], [1.0, 0.0, 1.0], [0, 1, 1]]
FUNCTIONS = {
    "ramps": ([0, 10, 25, 40, 63], [0, 0.01, 0.3, 0.05, 0.6]),
    "peaks": ([0, 20, 22, 24, 63], [0, 0, 0.95, 0, 0]),
    "opaque plateau": ([0, 20, 30, 40, 63], [0, 0, 1, 1, 0.2]),
    "touches opaque": ([0, 20, 30, 40, 63], [0, 0.2, 1, 0.2, 0]),
    "opaque everywhere": ([0, 63], [1, 1]),
    "opaque at the end": ([0, 63], [0, 1]),
    "step": ([0, 30, 30, 45, 63], [0.02, 0.1, 0.9, 0.9, 0]),
    "step to opaque": ([0, 31, 31, 45, 63], [0, 0, 1, 1, 0]),
    "nearly transparent": ([0, 30, 63], [1e-9, 3e-7, 1e-12]),
    "nearly opaque": ([0, 30, 63], [1 - 1e-7, 0.999999, 1 - 1e-12]),
    "narrower than a cell": ([0, 30.25, 30.375, 30.5, 63], [0, 0, 0.9, 0, 0]),
    "one point": ([20], [0.3]),
}


def function_of(name: str, unit: float = 1.0) -> TransferFunction:
    values, opacities = FUNCTIONS[name]
    return TransferFunction(values, opacities, COLORS[: len(values)], unit)


def random_function(seed: int, points: int, opaque: float = 0.1) -> TransferFunction:
    """Any number of control points, some twice, some opaque, with stretches in which nothing shows."""
    rng = np.random.default_rng(seed)
    values = np.sort(np.concatenate([*[np.arange(1, 256) / 4] * 2])[rng.permutation(510)[:points]])
    opacities = rng.random(points) ** 3 * rng.integers(0, 2, points)
    opacities[rng.random(points) < opaque] = 1.0
    return TransferFunction(values, opacities, rng.random((points, 3)))


def segments_of(context, function, front, back, units, *, lanes=None, in_memory=False, constant=0, step_units=1.0):
    """float64 [n, 5] from the device; ``constant`` is `of_one` of segment_colors.cl."""
    lanes = lanes or (16 if context.is_cpu else 1)
    front, back, units = np.broadcast_arrays(*(np.asarray(a, np.float32) for a in (front, back, units)))
    shape, n = front.shape, -(-front.size // 16) * 16
    count = piece_count(function)
    width = columns(count)
    view = np.zeros(1, view_dtype(8))
    view["step_units"] = step_units
    terms, view["opacity_limit"] = step_opacity(float(np.float32(step_units)))
    view["opacity_terms"], view["opacity_more"] = terms[:4], terms[4:]
    view["piece_columns"], view["piece_count"] = width, count
    pieces = 0 if in_memory else register_pieces(count)
    kernel = context.kernel(
        SOURCE, "segment_colors",
        (
            reads("table", np.float32), view_argument(8),
            *(reads(a, np.float32, "n") for a in ("front", "back", "units")),
            value("of_one", np.int32), value("n", np.int32), writes("colors", np.float32, 5, "n"),
        ),
        {"LANES": lanes, "VOXEL_BITS": 8, "VOXEL_HOLES": 1, "TRANSFER_PIECES": pieces,
         "TRANSFER_LAYERS": 0},
    )  # fmt: skip
    colors = context.empty(np.float32, (5, n))
    kernel(
        context.queue, (n // lanes,), (1,), table=context.upload(piece_table(function, 1.0).ravel()),
        view=context.upload(view), of_one=int(constant), n=n, colors=colors,
        **{name: context.upload(np.resize(a.ravel(), n)) for name, a in
           (("front", front), ("back", back), ("units", units))},
    )  # fmt: skip
    return context.read(colors).astype(np.float64)[:, : front.size].T.reshape(*shape, 5)


def grid_of_values() -> tuple[np.ndarray, np.ndarray]:
    values = np.concatenate([np.linspace(-2, 65, 30), np.linspace(29, 33, 11), [30.375, 29.99, 20.01, 30.26]])
    values = np.sort(values).astype(np.float32)
    return values[:, None], values[None, :]


@pytest.mark.parametrize("in_memory", [False, True], ids=["registers", "memory"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_opacity_of_a_segment_is_its_integral(context, name, in_memory):
    function = function_of(name)
    front, back = grid_of_values()
    for length in (1e-6, 0.3, 50.0):
        got = segments_of(context, function, front, back, length, in_memory=in_memory)
        expected = preintegrate(function, front, back, length)
        np.testing.assert_allclose(got[..., 3], expected[..., 3], rtol=0, atol=3e-6)
        np.testing.assert_allclose(-np.expm1(-got[..., 4]), expected[..., 3], rtol=0, atol=3e-6)
        # Thin segments keep their relative accuracy: thousands of them must add up.
        thin = (expected[..., 3] < 1e-3) & (expected[..., 3] > 1e-3 * length * function.opacities.max())
        relative = np.abs(got[..., 3] / np.where(thin, expected[..., 3], 1.0) - 1.0)[thin]
        assert relative.max(initial=0) < 2e-4


# Largest and root mean square errors of segments of these lengths, in opacity units. Opacities go up to 1 over
# one unit, so that the thickest of these segments are thicker than any step should be.
COLOR_LIMITS = {1e-3: (2e-6, 1e-6), 0.05: (3e-4, 1e-4), 1.0: (0.02, 4e-3)}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_colour_of_a_thin_segment_is_its_integral_and_of_a_thick_one_near_it(context, name):
    function = function_of(name)
    front, back = grid_of_values()
    for length, (largest, mean) in COLOR_LIMITS.items():
        got = segments_of(context, function, front, back, length)
        error = got[..., :3] - preintegrate(function, front, back, length)[..., :3]
        assert np.abs(error).max() < largest and np.sqrt(np.mean(error**2)) < mean, length


@pytest.mark.parametrize("seed, points", [(0, 3), (1, 8), (2, 15), (3, 16), (4, 60), (5, 250)])
def test_any_function_is_integrated_however_many_points_it_has(context, seed, points):
    function = random_function(seed, points)
    rng, n = np.random.default_rng(seed), 1024
    front = rng.uniform(-2, 66, n).astype(np.float32)
    back = np.where(rng.random(n) < 0.5, rng.uniform(-2, 66, n), front + rng.normal(0, 0.5, n))
    front[:64] = np.resize(function.values, 64)  # exactly on control points
    back = back.astype(np.float32)
    length = (10.0 ** rng.uniform(-3, 0.5, n)).astype(np.float32)
    got = segments_of(context, function, front, back, length)
    expected = preintegrate(function, front, back, length)
    assert np.abs(got[:, 3] - expected[:, 3]).max() < 2e-5
    # Of many pieces at once the mean colour counts: what is in front of what is left out there.
    assert np.sqrt(np.mean((got[:, :3] - expected[:, :3]) ** 2)) < (0.004 if points <= 15 else 0.03)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_segment_of_one_value_is_exact(context, name):
    function = function_of(name)
    values = np.concatenate([np.linspace(-2, 65, 135), FUNCTIONS[name][0]]).astype(np.float32)
    for length in (1e-3, 0.7, 20.0):
        expected = preintegrate(function, values, values, length)
        for constant in (False, True):
            got = segments_of(context, function, values, values, length, constant=constant)
            np.testing.assert_allclose(got[..., :4], expected, rtol=0, atol=3e-6)


def test_lanes_do_not_depend_on_their_neighbours(context):
    if not context.is_cpu:
        pytest.skip("one ray a work-item on this device")
    function = random_function(7, 12)
    rng = np.random.default_rng(7)
    front, back = rng.uniform(-2, 66, (2, 2048)).astype(np.float32)
    together = segments_of(context, function, front, back, 0.5)
    for k in range(0, 2048, 397):
        alone = segments_of(context, function, np.full(16, front[k]), np.full(16, back[k]), 0.5)
        assert np.array_equal(alone[0], together[k])


def test_one_ray_and_sixteen_agree(context):
    function = random_function(8, 14)
    rng = np.random.default_rng(8)
    front, back = rng.uniform(-2, 66, (2, 2048)).astype(np.float32)
    one = segments_of(context, function, front, back, 0.5, lanes=1)
    sixteen = segments_of(context, function, front, back, 0.5, lanes=16)
    np.testing.assert_allclose(one[:, :4], sixteen[:, :4], rtol=0, atol=1e-4)


def test_what_is_not_finite_is_transparent(context):
    function = function_of("opaque everywhere")
    bad = np.array([np.nan, np.inf, -np.inf], np.float32)
    for front, back in ((bad, 3.0), (3.0, bad), (bad, bad)):
        assert not segments_of(context, function, front, back, 1.0).any()
        if front is bad:
            assert not segments_of(context, function, front, back, 1.0, constant=True).any()


def test_a_segment_cut_in_two_is_the_whole(context):
    """Refinement changes nothing along a chord, whatever the function: that is what no table can do."""
    rng = np.random.default_rng(9)
    for seed in range(4):
        function = random_function(seed, 10, opaque=0.3)
        front, back = rng.uniform(-2, 66, (2, 1024)).astype(np.float32)
        middle = (0.5 * (front + back)).astype(np.float32)
        whole = segments_of(context, function, front, back, 1.0)[:, 4]
        halves = sum(segments_of(context, function, a, b, 0.5)[:, 4] for a, b in ((front, middle), (middle, back)))
        clear = whole < 10
        np.testing.assert_allclose(halves[clear], whole[clear], rtol=2e-4, atol=1e-5)


# Double precision loses what is clear of opacities near 1 when it interpolates them; rows do not.
@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "nearly opaque"])
def test_rows_hold_what_they_say(name):
    function, table = function_of(name), piece_table(function_of(name), 1.0)
    assert table.dtype == np.float32 and table.shape[1] == columns(piece_count(function))
    assert not np.isnan(table).any()
    begin = table[0, : piece_count(function)]
    assert np.all(np.diff(begin[1:]) >= 0) and np.all(np.isinf(table[0, piece_count(function) :]))
    for k in range(piece_count(function)):
        low, high = table[0, k], table[1, k]
        x = (np.arange(20000) + 0.5) / 20000
        opacity = function.opacity(low + x * (high - low)) if high > low else np.full(1, table[3, k])
        with np.errstate(divide="ignore"):
            mean = np.minimum(-np.log1p(-opacity), 1e15).mean()
        assert table[DEPTH, k] == pytest.approx(min(mean, 1e15), rel=2e-3, abs=1e-12)


def test_depth_and_moment_are_the_integrals():
    x = (np.arange(100_000) + 0.5) / 100_000
    for a, b in ((0.0, 0.9), (0.9, 0.0), (0.3, 0.31), (0.0, 1.0), (1.0, 0.4), (1e-8, 3e-8), (0.5, 0.5)):
        tau = -np.log1p(-(a + x * (b - a)))
        depth, moment = depth_and_moment(np.array([a]), np.array([b]))
        assert depth[0] == pytest.approx(tau.mean(), rel=1e-4)
        assert -moment[0] == pytest.approx(np.mean((x - 0.5) * tau), rel=1e-3, abs=1e-12)
    assert depth_and_moment(np.array([1.0]), np.array([1.0]))[0][0] == 1e15


def test_opaque_points_are_slopes_that_reach_one():
    expected = {"opaque plateau", "touches opaque", "opaque at the end"}
    assert {name for name in FUNCTIONS if has_opaque_point(function_of(name))} == expected | {"step to opaque"}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_nothing_shows_beyond_the_gate(name):
    function = function_of(name)
    low, high = value_gate(function)
    values = np.linspace(-5, 70, 7501, dtype=np.float32)
    values = np.concatenate([values, np.float32(FUNCTIONS[name][0])])
    hidden = (values <= low) | (values >= high)
    assert not function.opacity(values[hidden]).any()
    assert function.opacity(values[~hidden]).any()


def within_no_span(function, low, high):
    """bool [n]: chords from ``low`` to ``high`` [n] that show nothing by the spans, in float32 as kernels look."""
    above, below = shown_spans(function)
    assert above.dtype == below.dtype == np.float32 and above.shape == below.shape == (SPANS,)
    return np.all((high[:, None] <= above) | (low[:, None] >= below), axis=1)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_nothing_shows_beside_the_spans_of_values(name):
    function = function_of(name)
    low, high = value_gate(function)
    values = np.linspace(-5, 70, 7501, dtype=np.float32)
    values = np.concatenate([values, np.float32(FUNCTIONS[name][0])])
    hidden = within_no_span(function, values, values)
    assert not function.opacity(values[hidden]).any() and function.opacity(values[~hidden]).any()
    assert np.all(hidden[(values <= low) | (values >= high)])


def test_chords_beside_the_spans_of_random_functions_show_nothing_and_most_others_do():
    rng = np.random.default_rng(3)
    grid = np.arange(-8, 2049, dtype=np.float32) / 32  # all control points are among these
    missed = told = 0
    for seed in range(60):
        function = random_function(seed, int(rng.integers(1, 30)))
        visible = np.concatenate([[0], np.cumsum(function.opacity(grid) > 0)])
        first = rng.integers(0, grid.size, 400)
        last = np.minimum(first + rng.integers(0, 60, 400), grid.size - 1)
        hidden = within_no_span(function, grid[first], grid[last])
        shows = visible[last + 1] > visible[first]
        assert not np.any(hidden & shows)
        if piece_count(function) < 8:
            told += np.count_nonzero(~shows)
            missed += np.count_nonzero(~shows & ~hidden)
    assert told > 1000 and missed < 0.03 * told


def test_of_more_spans_than_there_is_room_for_those_beside_the_narrowest_gaps_are_one():
    values = np.array([0, 1, 2, 10, 11, 12, 14, 15, 16, 40, 41, 42, 50, 51, 52, 60, 61, 62], float)
    function = TransferFunction(values, np.tile([0, 0.5, 0], 6), np.zeros((18, 3)))
    above, below = shown_spans(function)
    assert above.tolist() == [0, 10, 40, 50] or above.tolist() == [0, 10, 40, 60]
    assert below.tolist() == [2, 16, 42, 62] or below.tolist() == [2, 16, 52, 62]
    none = shown_spans(TransferFunction([0, 1], [0, 0], np.zeros((2, 3))))
    assert np.all(none[0] == np.inf) and np.all(none[1] == -np.inf)


@pytest.mark.parametrize("in_memory", [False, True], ids=["registers", "memory"])
@pytest.mark.parametrize("name", ["ramps", "opaque plateau", "step", "nearly opaque", "one point"])
def test_whole_steps_of_one_value_absorb_what_is_stated(context, name, in_memory):
    function = function_of(name)
    values = np.concatenate([np.linspace(-2, 65, 301), [30.0, 29.9, 30.1]]).astype(np.float32)
    counts = np.arange(1, 9)[:, None]
    at, color = function.opacity(values), function.color(values)
    for units in (1e-3, 0.17, 0.9958, 1.0, 2.5, 40.0):
        with np.errstate(divide="ignore"):
            expected = -np.expm1(np.float32(units) * counts * np.log1p(-at))
        how = {"in_memory": in_memory, "step_units": units}
        got = segments_of(context, function, values[None], values[None], counts, constant=2, **how)
        one = segments_of(context, function, values, values, 1.0, constant=3, **how)
        for opacity, exact, rgb in ((got[..., 3], expected, got[..., :3]), (one[..., 3], expected[0], one[..., :3])):
            np.testing.assert_allclose(opacity, exact, rtol=0, atol=3e-6)
            thin = (exact > 0) & (exact < 1e-3)
            assert np.all(np.abs(opacity - exact)[thin] <= 2e-5 * exact[thin] + 1e-6 * units * function.opacities.max())
            np.testing.assert_allclose(rgb, color * exact[..., None], rtol=0, atol=5e-6)


@pytest.mark.parametrize("points", [20, 40, 90, 200, 300])
def test_registers_and_memory_hold_the_same_pieces(context, points):
    function = random_function(7, points)
    rng = np.random.default_rng(points)
    front = np.append(rng.uniform(-2, 66, 1000), np.resize(function.values, 1000)).astype(np.float32)
    back = (front + rng.normal(0, 3, front.size)).astype(np.float32)
    for constant in (0, 1, 2):
        found, gathered = (
            segments_of(context, function, front, back, 1.0, constant=constant, in_memory=in_memory)
            for in_memory in (False, True)
        )
        assert np.array_equal(found, gathered)
