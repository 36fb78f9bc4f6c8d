"""The exact integral against closed forms, 20-digit quadrature and its plain twin."""

from __future__ import annotations

import math
import re
from functools import lru_cache

import numpy as np
import pytest
from reference.ray import integrate_ray

import clvol
from clvol.errors import SceneError, UsageError
from clvol.integrators.reference.picture import FILTERS, integrate_world_rays, render_reference
from clvol.opencl.kernels_path import kernel_folder
from clvol.transfer import TransferFunction
from clvol.transfer.preintegration import preintegrate
from clvol.volume import Volume

RED, GREEN, GREY, BLUE = [0.9, 0.1, 0.0], [0.0, 0.8, 0.1], [0.3, 0.4, 0.5], [0.1, 0.2, 1.0]
SMOOTH = TransferFunction([0.0, 0.4, 1.0], [0.0, 0.6, 0.9], [GREY, RED, GREEN], 0.8)
NASTY = TransferFunction(
    [0.0, 0.2, 0.4, 0.4, 0.7, 1.0],
    [0.0, 0.3, 0.9, 0.0, 0.5, 0.99],
    [RED, GREEN, BLUE, GREY, RED, GREEN],
    0.7,
)


CUBIC = {"filter": "cubic"}


def constant(opacity: float, color=GREY, unit: float = 1.0) -> TransferFunction:
    return TransferFunction([0.0], [opacity], [color], unit)


def trace(device, volume, tf, origin, towards, nearest=False, **settings):
    """(rgba [n, 4], depth [n], counters) of rays from ``origin`` through the point ``towards``."""
    if nearest:
        settings["filter"] = "nearest"
    origin, towards = np.broadcast_arrays(np.atleast_2d(origin), np.atleast_2d(towards))
    direction = (towards - origin).astype(float)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return integrate_world_rays(volume, tf, origin, direction, device, **settings)


def check(got, expected, tolerance=1e-9):
    np.testing.assert_allclose(got, expected, rtol=0, atol=tolerance)


# --- closed forms ---------------------------------------------------------------------------------


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("opacity", [1e-12, 0.3, 1.0 - 1e-7])
def test_homogeneous_slab(device, opacity, filter):
    volume = Volume(np.full((4, 5, 6), 7.0), spacing=(0.5, 2.0, 3.0), origin=(10.0, -4.0, 1.0))
    tf = constant(opacity, RED, unit=0.7)
    rgba, depth, counters = trace(
        device, volume, tf, [9.0, 0.3, 2.0], [14.0, 2.5, 7.0], filter=filter
    )
    direction = np.array([5.0, 2.2, 5.0]) / math.sqrt(25 + 2.2**2 + 25)
    length = 2.5 / direction[0]  # in at x = 10, out at x = 12.5
    optical_depth = -math.log1p(-opacity) * length / 0.7
    alpha = -math.expm1(-optical_depth)
    np.testing.assert_allclose(rgba[0], [*(alpha * np.array(RED)), alpha], rtol=1e-12)
    if alpha > 0.5:
        check(depth[0], 1.0 / direction[0] + length * math.log(2) / optical_depth, 1e-12)
    else:
        assert depth[0] == math.inf
    assert counters["failed_pieces"] == 0


def test_linear_ramp_of_extinction(device):
    """tau = -log(1 - x/10): D = int tau = y log y - y at y = 1 - x/10, times -10."""
    volume = Volume(np.broadcast_to(np.arange(10.0), (3, 3, 10)))
    tf = TransferFunction([0.0, 10.0], [0.0, 1.0], [RED, RED])
    rgba, depth, _ = trace(device, volume, tf, [-3.0, 1.2, 0.7], [5.0, 1.2, 0.7])
    y = 0.1
    optical_depth = 10.0 * (1.0 + y * math.log(y) - y)
    alpha = -math.expm1(-optical_depth)
    check(rgba[0], [*(alpha * np.array(RED)), alpha], 1e-10)
    y = 1.0 - (depth[0] - 3.0) / 10.0
    check(10.0 * (1.0 + y * math.log(y) - y), math.log(2.0), 1e-10)


RAMPS = {
    "smooth": SMOOTH,
    "steps and a hole": NASTY,
    "opacity rises to 1": TransferFunction([0.0, 0.8], [0.0, 1.0], [RED, GREEN], 0.2),
    "opacity touches 1": TransferFunction([0.2, 0.5, 0.9], [0, 1, 0.1], [RED, GREEN, BLUE], 3.0),
    "opacity 1 in the middle": TransferFunction(
        [0.2, 0.5, 0.6, 0.9], [0.1, 1.0, 1.0, 0.1], [RED, GREEN, BLUE, GREY], 3.0
    ),
    "step to opacity 1": TransferFunction([0.5, 0.5], [0.2, 1.0], [RED, GREEN]),
    "within 1e-7 of 1": TransferFunction([0.0, 1.0], [1 - 1e-7, 1 - 1e-9], [RED, GREEN], 20.0),
    "within 1e-7 of 0": TransferFunction([0.0, 1.0], [1e-7, 1e-12], [RED, GREEN], 1e-5),
    "narrow peak": TransferFunction([0.4999, 0.5, 0.5001], [0, 0.99, 0], [RED, GREEN, BLUE], 1e-4),
    "points 1e-30 apart": TransferFunction([0, 1e-30, 1], [0, 0.5, 0.9], [RED, GREEN, BLUE], 2.0),
    "tau d of 1e12": TransferFunction([0.0, 1.0], [0.0, 0.9], [RED, GREEN], 1e-11),
    "tau d of 1e-12": TransferFunction([0.0, 1.0], [0.0, 0.9], [RED, GREEN], 1e13),
}


@pytest.mark.parametrize("ramp", RAMPS)
@pytest.mark.parametrize("forwards", [True, False])
def test_linear_field_equals_the_preintegrated_segment(device, ramp, forwards):
    """A field linear along the ray is one pre-integrated segment, however many cells it crosses."""
    x, y, z = (np.linspace(0.0, 1.0, n) for n in (9, 4, 5))
    field = 0.6 * x + 0.3 * y[:, None] + 0.1 * z[:, None, None]
    volume = Volume(field, spacing=(1.0, 2.0, 0.5))
    inside = np.array([1.0, 0.6, 0.9]), np.array([7.0, 4.0, 1.6])
    start, end = inside if forwards else inside[::-1]
    corner = np.array([8.0, 6.0, 2.0])
    direction = (end - start) / np.linalg.norm(end - start)
    ends = np.stack([-start, corner - start]) / direction
    length = ends.max(axis=0).min()
    values = [0.6 * p[0] / 8 + 0.3 * p[1] / 6 + 0.1 * p[2] / 2
              for p in (start, start + length * direction)]
    tf = RAMPS[ramp]
    rgba, _, counters = trace(device, volume, tf, start, end)
    check(rgba[0], preintegrate(tf, *values, length))
    assert counters["failed_pieces"] == 0


def test_step_in_the_transfer_function(device):
    volume = Volume(np.broadcast_to(np.arange(5.0), (2, 2, 5)))
    tf = TransferFunction([1.3, 1.3], [0.2, 0.7], [RED, GREEN])
    rgba, _, _ = trace(device, volume, tf, [-1.0, 0.5, 0.5], [9.0, 0.5, 0.5])
    near, far = 1.0 - 0.8**1.3, 1.0 - 0.3**2.7
    color = near * np.array(RED) + (1 - near) * far * np.array(GREEN)
    check(rgba[0], [*color, 1.0 - 0.8**1.3 * 0.3**2.7], 1e-12)


def test_at_exactly_a_step_the_later_point_holds(device):
    volume = Volume(np.full((2, 2, 5), 3.0))
    tf = TransferFunction([3.0, 3.0], [0.2, 0.7], [RED, GREEN])
    rgba, _, _ = trace(device, volume, tf, [-1.0, 0.5, 0.5], [9.0, 0.5, 0.5])
    check(rgba[0, 3], 1.0 - 0.3**4, 1e-13)


def test_nested_boxes(device):
    """Voxels' own cells (nearest): a box of 3 in a box of 5 in a box of 9 voxels."""
    array = np.ones((9, 9, 9), np.uint8)
    array[2:7, 2:7, 2:7] = 2
    array[3:6, 3:6, 3:6] = 3
    opacities, colors = [0.1, 0.4, 0.6], [RED, GREEN, BLUE]
    values = np.repeat([1.0, 1.5, 2.5, 3.0], [1, 2, 2, 1])
    tf = TransferFunction(values, np.repeat(opacities, 2), np.repeat(colors, 2, axis=0))
    rgba, _, _ = trace(device, Volume(array), tf, [20.0, 4.2, 3.9], [0, 4.2, 3.9], nearest=True)
    clear, color = 1.0, np.zeros(3)
    for box, length in ((0, 1.5), (1, 1.0), (2, 3.0), (1, 1.0), (0, 1.5)):
        alpha = 1.0 - (1.0 - opacities[box]) ** length
        color += clear * alpha * np.array(colors[box])
        clear *= 1.0 - alpha
    check(rgba[0], [*color, 1.0 - clear], 1e-13)


def test_opaque_sphere(device):
    """Distance from the centre voxel: linear along the axes, so the sphere's poles are exact."""
    at = np.arange(9.0) - 4.0
    field = np.sqrt(at**2 + at[:, None] ** 2 + at[:, None, None] ** 2)
    tf = TransferFunction([2.3, 2.3], [1.0, 0.0], [RED, GREEN])
    eyes = np.array([[-7.0, 4, 4], [20, 4, 4], [4, -7, 4], [4, 4, 20], [-7, 4, 7], [-7, 1.9, 4]])
    aims = np.array([[4.0, 4, 4], [4, 4, 4], [4, 4, 4], [4, 4, 4], [4, 4, 7], [4, 1.9, 4]])
    rgba, depth, _ = trace(device, Volume(field), tf, eyes, aims)
    check(rgba[:4], [[*RED, 1.0]] * 4, 0.0)
    check(depth[:4], [11 - 2.3, 16 - 2.3, 11 - 2.3, 16 - 2.3], 1e-12)
    assert np.array_equal(rgba[4], np.zeros(4)) and depth[4] == math.inf, "passes the sphere"
    assert rgba[5, 3] == 1.0 and 4 + 7 - 2.3 < depth[5] < 11, "hits it off its pole"


@pytest.mark.parametrize("shape", [(1, 4, 5), (4, 1, 5), (4, 5, 1), (1, 1, 5), (1, 1, 1)])
@pytest.mark.parametrize("filter", FILTERS)
def test_slab_one_voxel_thick(device, shape, filter):
    """An axis with one voxel reaches half a voxel to both sides and is constant along it."""
    volume = Volume(np.full(shape, 1.0), spacing=(2.0, 3.0, 4.0))
    corners = volume.grid.world_corners()
    lower, upper = corners.min(axis=0), corners.max(axis=0)
    for axis in range(3):
        eye, aim = 0.4 * lower + 0.6 * upper, 0.4 * lower + 0.6 * upper
        eye[axis], aim[axis] = upper[axis] + 5.0, lower[axis] - 1.0
        rgba, depth, _ = trace(device, volume, constant(0.4), eye, aim, filter=filter)
        thickness = upper[axis] - lower[axis]
        assert thickness == (volume.grid.size[axis] - 1 or 1) * volume.grid.spacing[axis]
        check(rgba[0, 3], 1.0 - 0.6**thickness, 1e-13)
        check(depth[0], 5.0 + math.log(2) / -math.log(0.6), 1e-12)


def test_slab_one_voxel_thick_varies_along_the_others(device):
    array = np.array([[[0.1, 0.9, 0.4], [0.7, 0.2, 0.6]]])
    thin, thick = Volume(array), Volume(np.repeat(array, 2, axis=0), origin=(0.0, 0.0, -0.5))
    eyes = np.array([[-1.0, 0.3, -1.2], [3.0, 1.3, 2.0], [0.9, 0.5, -4.0]])
    aims = np.array([[1.0, 0.6, 0.1], [1.0, 0.4, -0.1], [1.0, 0.4, 0.0]])
    for settings in ({}, {"preclassified": True}, CUBIC, {**CUBIC, "preclassified": True}):
        one, two = (
            trace(device, volume, NASTY, eyes, aims, **settings)[0] for volume in (thin, thick)
        )
        assert one[:, 3].min() > 0.1
        check(one, two, 1e-13)


@pytest.mark.parametrize("hole", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("preclassified", [False, True])
def test_a_hole_makes_transparent_exactly_what_uses_it(device, hole, preclassified):
    array = np.full((7, 7, 7), 0.5, np.float32)
    array[3, 3, 3] = hole
    eyes = [[-1, 3.3, 2.6], [-1, 3.0, 3.0], [-1, 4.0, 3.0], [-1, 4.1, 3.0], [-1, 2.0, 3.5]]
    eyes = np.array(eyes, float)
    rgba, _, _ = trace(device, Volume(array), constant(0.2), eyes, eyes + [1, 0, 0],
                       preclassified=preclassified)
    # Cells at x = 2...3 and 3...4 next to it are gone; a ray in a plane of voxels beside it, whose
    # interpolation gives it no weight, is whole.
    check(rgba[:, 3], 1.0 - 0.8 ** np.array([4.0, 4.0, 6.0, 6.0, 6.0]), 1e-12)


@pytest.mark.parametrize("hole", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("preclassified", [False, True])
def test_a_hole_under_the_cubic_filter_reaches_two_voxels(device, hole, preclassified):
    array = np.full((9, 9, 9), 0.5, np.float32)
    array[4, 4, 4] = hole
    eyes = [[-1, 4.3, 3.6], [-1, 4, 4], [-1, 5.9, 2.1], [-1, 6, 4], [-1, 2, 2.5], [-1, 6.1, 4],
            [-1, 4, 2]]
    eyes = np.array(eyes, float)
    rgba, _, _ = trace(device, Volume(array), constant(0.2), eyes, eyes + [1, 0, 0],
                       preclassified=preclassified, **CUBIC)
    # Cells at x = 2...6 are gone; at a distance of exactly two voxels the hole has no weight.
    check(rgba[:, 3], 1.0 - 0.8 ** np.array([4.0, 4.0, 4.0, 8.0, 8.0, 8.0, 8.0]), 1e-12)


@pytest.mark.parametrize("ramp", RAMPS)
def test_a_linear_field_stays_linear_under_the_cubic_filter(device, ramp):
    """But for the outermost cells, where the voxels beyond do not go on: they are transparent."""
    x, y, z = (np.linspace(0.0, 1.0, n) for n in (11, 6, 7))
    volume = Volume(2.0 * x - 0.5 + 0.0 * y[:, None] + 0.0 * z[:, None, None])
    inner = RAMPS[ramp]
    values = np.array([-0.2, *np.clip(inner.values, -0.2, 1.2), 1.2])
    opacities = np.array([inner.opacities[0], *inner.opacities, inner.opacities[-1]])
    colors = np.array([inner.colors[0], *inner.colors, inner.colors[-1]])
    clear = TransferFunction([-0.2, *values, 1.2], [0, *opacities, 0], [GREY, *colors, GREY],
                             inner.opacity_unit)
    eyes = np.array([[-2.0, 1.3, 2.2], [13.0, 4.0, 1.0]])
    aims = np.array([[11.0, 3.1, 4.0], [-4.0, 2.5, 4.1]])
    expected, expected_depth, linear = trace(device, volume, clear, eyes, aims)
    rgba, depth, counters = trace(device, volume, clear, eyes, aims, **CUBIC)
    check(rgba, expected)
    np.testing.assert_allclose(depth, expected_depth, rtol=0, atol=1e-9)
    assert counters["failed_pieces"] <= linear["failed_pieces"] and rgba[:, 3].max() > 0


def test_one_bright_voxel_under_the_cubic_filter_is_the_spline(device):
    """Classified first, a column of bright voxels absorbs as the B-spline of the distance to it."""
    array = np.zeros((5, 9, 9))
    array[:, 4, 4] = 1.0
    tf = TransferFunction([0.0, 1.0], [0.0, 0.9], [RED, RED])
    offsets = np.array([[0.0, 0.0], [0.3, 0.0], [1.0, 1.0], [-1.2, 0.4], [1.9, -1.5], [2.0, 0.0]])
    eyes = np.column_stack([4.0 + offsets, np.full(6, -3.0)])
    rgba, _, _ = trace(device, Volume(array), tf, eyes, eyes + [0, 0, 1], preclassified=True,
                       **CUBIC)
    d = np.abs(offsets)
    spline = np.where(d < 1, 2 / 3 - d**2 + d**3 / 2, np.clip(2 - d, 0, None) ** 3 / 6)
    spline = spline.prod(axis=1)
    alpha = 1.0 - 0.1 ** (4.0 * spline)
    check(rgba, np.column_stack([np.outer(alpha, RED), alpha]), 1e-13)


def test_nearest_hole_is_one_voxel(device):
    array = np.full((7, 7, 7), 0.5)
    array[3, 3, 3] = math.nan
    eyes = np.array([[-1, 3.3, 2.6], [-1, 3.6, 3.0]])
    rgba, _, _ = trace(device, Volume(array), constant(0.2), eyes, eyes + [1, 0, 0], nearest=True)
    check(rgba[:, 3], 1.0 - 0.8 ** np.array([5.0, 6.0]), 1e-13)


def test_all_nan_is_empty(device):
    rgba, depth, _ = trace(device, Volume(np.full((3, 3, 3), math.nan)), constant(1.0),
                           [-1.0, 1.1, 1.2], [1, 1, 1])
    assert not rgba.any() and depth[0] == math.inf


@pytest.mark.parametrize(
    "eye, length",
    [((2.5, 1.0, 1.0), 5.5), ((0.0, 1.0, 1.0), 8.0), ((8.0, 1.0, 1.0), 0.0),
     ((9.0, 1.0, 1.0), 0.0), ((-1e6, 1.0, 1.0), 8.0), ((7.999999, 1.0, 1.0), 1e-6)],
)
def test_the_ray_begins_at_the_eye(device, eye, length):
    volume = Volume(np.full((3, 3, 9), 2.0))
    rgba, _, _ = trace(device, volume, constant(0.3), eye, np.add(eye, [1.0, 0.0, 0.0]))
    check(rgba[0, 3], 1.0 - 0.7**length, 1e-10)


# --- 20 digits ------------------------------------------------------------------------------------


def exact_cell(corner, low, high, tf, length):
    """One cell of the trilinear field from ``low`` to ``high``, as ``exact_pieces`` does it."""
    from mpmath import mp, mpf

    with mp.workdps(20):
        low, high = [mpf(float(v)) for v in low], [mpf(float(v)) for v in high]
        corner = [mpf(float(v)) for v in corner]

        def field(w):
            u = [a + w * (b - a) for a, b in zip(low, high)]
            return sum(
                corner[i] * mp.fprod(u[k] if i >> k & 1 else 1 - u[k] for k in range(3))
                for i in range(8)
            )

    return exact_pieces(field, 3, [0, 1], tf, length)


def exact_pieces(field, degree, knots, tf, length):
    """A ray by nested Gauss-Legendre quadrature at 20 digits. Between two ``knots`` ``field`` is a
    polynomial of ``degree``, cut at its roots; ``length``: world length of a unit."""
    from mpmath import mp, mpf

    depth, color = mpf(0), [mpf(0)] * 3
    for start, end in zip(knots, knots[1:]):
        with mp.workdps(30):
            nodes = [mpf(k) / degree for k in range(degree + 1)]
            matrix = mp.matrix([[x**p for p in range(degree + 1)] for x in nodes])
            values = mp.matrix([field(start + x * (end - start)) for x in nodes])
            power = list(mp.lu_solve(matrix, values))
        with mp.workdps(20):
            pieces = _pieces(power, tf)
            for a, b in zip(pieces, pieces[1:]):
                depth = _add_piece(power, a, b, tf, mpf(length) * (end - start), depth, color)
    return np.array([float(c) for c in color] + [float(-mp.expm1(-depth))])


def _polynomial(power, u):
    total = 0
    for p in reversed(power):
        total = total * u + p
    return total


def _pieces(power, tf):
    """0, where the polynomial crosses a control point's value, and 1."""
    from mpmath import mp, mpf

    cuts = {mpf(0), mpf(1)}
    for value in tf.values:
        roots = np.roots([float(p) for p in (*power[:0:-1], power[0] - value)])
        for root in roots[np.abs(roots.imag) < 1e-9].real:
            if 0 < root < 1:
                cuts.add(mp.findroot(lambda u: _polynomial(power, u) - value, root))
    return sorted(cuts)


def _add_piece(power, a, b, tf, length, depth, color):
    """Adds to ``color`` what a ... b emits behind ``depth``; returns the depth behind it."""
    from mpmath import mp, mpf

    values = [mpf(float(v)) for v in tf.values]
    r = sum(1 for v in values if v <= _polynomial(power, (a + b) / 2))
    near, far = max(r - 1, 0), min(r, len(values) - 1)
    gap = values[far] - values[near]

    def along(table, u):
        place = (_polynomial(power, u) - values[near]) / gap if gap else mpf(0)
        x, y = mpf(float(table[near])), mpf(float(table[far]))
        return x + place * (y - x)

    def tau(u):
        return -mp.log(1 - along(tf.opacities, u)) * length / mpf(tf.opacity_unit)

    def integral(f, end):
        return mp.quad(f, [a, end], method="gauss-legendre", maxdegree=4)

    def passed(u):
        return integral(tau, u)

    for k in range(3):
        color[k] += mp.exp(-depth) * integral(
            lambda u: along(tf.colors[:, k], u) * tau(u) * mp.exp(-passed(u)), b
        )
    return depth + passed(b)


@lru_cache(maxsize=1)
def exact_cells():
    rng = np.random.default_rng(11)
    cells = []
    for k in range(2):
        corner = rng.random((2, 2, 2))
        # A diagonal from corner to corner, then from face to face.
        low, high = ([0.0, 0.2, 0.9], [1.0, 0.7, 0.1]) if k else ([0.0, 0.0, 1.0], [1.0, 1.0, 0.0])
        low, high = np.array(low), np.array(high)
        length = float(np.linalg.norm(high - low))
        cells.append((corner, low, high, exact_cell(corner.ravel(), low, high, NASTY, length)))
    return cells


def test_cubic_in_one_cell_at_20_digits(device):
    for corner, low, high, expected in exact_cells():
        rgba, _, counters = trace(device, Volume(corner), NASTY, low, high)
        check(rgba[0], expected, 1e-11)
        assert counters["cells"] == 1


def exact_spline_ray(array, origin, direction, tf):
    """A ray from outside through the cubic B-spline of ``array``, at 20 digits."""
    from mpmath import mp, mpf

    with mp.workdps(20):
        origin, direction = ([mpf(float(v)) for v in p] for p in (origin, direction))
        size = array.shape[::-1]
        planes = [sorted((k - o) / d for k in range(n)) for o, d, n in zip(origin, direction, size)]
        enter, leave = max(p[0] for p in planes), min(p[-1] for p in planes)
        knots = [enter, *sorted(t for p in planes for t in p if enter < t < leave), leave]

        def weight(d):
            d = abs(d)
            return mpf(2) / 3 - d * d + d**3 / 2 if d < 1 else (2 - d) ** 3 / 6 if d < 2 else mpf(0)

        last = np.subtract(array.shape, 1)

        def field(t):
            p = [o + t * d for o, d in zip(origin, direction)]
            at = [[(k, weight(x - k)) for k in range(-1, n + 1)] for x, n in zip(p, size)]
            return sum(
                mpf(float(array[tuple(np.clip((z, y, x), 0, last))])) * a * b * c
                for x, a in at[0] if a for y, b in at[1] if b for z, c in at[2] if c
            )

    return exact_pieces(field, 9, knots, tf, mp.sqrt(sum(d * d for d in direction)))


@lru_cache(maxsize=1)
def exact_splines():
    array = np.random.default_rng(4).random((4, 2, 5))
    rays = [([-1.0, 0.3, 0.2], [0.9, 0.1, 0.45]), ([3.1, -2.0, 4.0], [-0.2, 0.9, -0.6]),
            ([4.3, 0.9, -1.0], [-0.5, -0.1, 0.8])]
    return array, [(o, d, exact_spline_ray(array, o, d, NASTY)) for o, d in rays]


def test_a_ray_through_the_cubic_spline_at_20_digits(device):
    array, rays = exact_splines()
    for origin, direction, expected in rays:
        towards = np.add(origin, direction)
        rgba, _, counters = trace(device, Volume(array), NASTY, origin, towards, **CUBIC)
        check(rgba[0], expected, 1e-11)
        assert counters["cells"] >= 2 and counters["failed_pieces"] == 0


# --- the plain twin -------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def random_case():
    rng = np.random.default_rng(3)
    volume = Volume(rng.random((4, 3, 5)), spacing=(0.8, 1.1, 0.6))
    centre = volume.grid.world_corners().mean(axis=0)
    eyes = centre + rng.normal(size=(4, 3)) * 6
    eyes[0] = centre + [0.1, 0.2, -0.1]
    return volume, eyes, centre + rng.normal(size=(4, 3)) * 0.4


@lru_cache(maxsize=5)
def twin_rays(filter, classification):
    volume, eyes, aims = random_case()
    spacing = np.array(volume.grid.spacing)
    rays = []
    for eye, aim in zip(eyes, aims):
        direction = (aim - eye) / np.linalg.norm(aim - eye)
        rays.append(integrate_ray(volume.data, NASTY, eye / spacing, direction / spacing,
                                  filter=filter, classification=classification))
    return np.array([rgba for rgba, _ in rays]), np.array([depth for _, depth in rays])


@pytest.mark.parametrize(
    "filter, classification",
    [("linear", "post"), ("linear", "pre"), ("nearest", "post"), ("cubic", "post"),
     ("cubic", "pre")],
)
def test_equals_the_plain_twin(device, filter, classification):
    volume, eyes, aims = random_case()
    rgba, depth, counters = trace(device, volume, NASTY, eyes, aims, filter=filter,
                                  preclassified=classification == "pre")
    expected, expected_depth = twin_rays(filter, classification)
    check(rgba, expected)
    np.testing.assert_allclose(depth, expected_depth, rtol=0, atol=1e-9)
    assert counters["failed_pieces"] == 0 and counters["error_estimate"] < 1e-9


def test_preclassified_opaque_voxel_is_seen_at_its_cells_front(device):
    array = np.zeros((2, 2, 6))
    array[:, :, 3] = 1.0
    tf = TransferFunction([0.0, 1.0], [0.0, 1.0], [RED, GREEN])
    rgba, depth, _ = trace(device, Volume(array), tf, [-2.0, 0.4, 0.3], [0, 0.4, 0.3],
                           preclassified=True)
    check(rgba[0], [*GREEN, 1.0], 1e-15)
    check(depth[0], 4.0, 1e-12)


# --- rays -----------------------------------------------------------------------------------------


def random_volume(shape=(5, 4, 6), seed=8):
    return Volume(np.random.default_rng(seed).random(shape))


def test_mirrored_volume_gives_the_same_picture(device):
    volume = random_volume()
    rng = np.random.default_rng(9)
    eyes, aims = rng.normal(size=(50, 3)) * 9, rng.random((50, 3)) * [5, 3, 4]
    size = np.array(volume.grid.size) - 1.0
    for settings in ({}, {"preclassified": True}, CUBIC, {**CUBIC, "preclassified": True}):
        rgba, depth, _ = trace(device, volume, NASTY, eyes, aims, **settings)
        for axis in range(3):
            mirror = np.zeros(3)
            mirror[axis] = size[axis]
            sign = np.where(mirror > 0, -1.0, 1.0)
            mirrored = Volume(np.flip(volume.data, 2 - axis))
            other, other_depth, _ = trace(device, mirrored, NASTY, mirror + sign * eyes,
                                          mirror + sign * aims, **settings)
            check(other, rgba)
            np.testing.assert_allclose(other_depth, depth, atol=1e-8)


@pytest.mark.parametrize("filter", FILTERS)
def test_rays_along_faces_edges_and_through_corners(device, filter):
    """In a constant field the cells do not show: only the length inside the volume counts."""
    volume = Volume(np.ones((5, 5, 5)))
    tiny = 5e-324
    rays = [  # eye, direction, length inside
        ((-1, 2, 2.5), (1, 0, 0), 4), ((-1, 2, 3), (1, 0, 0), 4), ((-1, 0, 0), (1, 0, 0), 4),
        ((-1, 4, 4), (1, 0, 0), 4), ((5, 4, 2), (-1, 0.0, -0.0), 4),
        ((2, 2, 9), (-0.0, 0.0, -1), 4),
        ((2.5, 1.5, -3), (0, 0, 1), 4), ((-1, -1, -1), (1, 1, 1), 4 * math.sqrt(3)),
        ((5, 5, 5), (-1, -1, -1), 4 * math.sqrt(3)), ((-1, 5, 2), (1, -1, 0), 4 * math.sqrt(2)),
        ((-1, 5, 2.2), (1, -1, 0), 4 * math.sqrt(2)), ((-1, 1, 2), (1, 1, 0), 2 * math.sqrt(2)),
        ((-1, 2, 2), (1, tiny, -tiny), 4), ((-1, 4, 2), (1, -tiny, 0), 4),
        ((-1, 4, 2), (1, tiny, 0), 0),
        ((-1, 2, 2), (1, 1e-300, 1e-17), 4), ((-1, 0, 2), (1, -1e-12, 0), 0),
        ((-1, -1, 2), (1, 1, 0), 4 * math.sqrt(2)), ((-2, 1, 0), (1, -1, 0), 0),
        ((-1, 3, 2), (-1, 0, 0), 0), ((4, 2, 2), (0, 1, 0), 2),
        ((2, 2, 2), (1, 1, 1), 2 * math.sqrt(3)),
        ((-1, 4 + 1e-12, 2), (1, 0, 0), 0),
    ]
    eyes = np.array([ray[0] for ray in rays], float)
    directions = np.array([ray[1] for ray in rays], float)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rgba, _, counters = integrate_world_rays(volume, constant(0.3), eyes, directions, device,
                                             filter=filter)
    check(rgba[:, 3], 1.0 - 0.7 ** np.array([ray[2] for ray in rays], float), 1e-12)
    assert counters["cells"] < 20 * len(rays)


@pytest.mark.parametrize("preclassified", [False, True])
def test_the_cubic_filter_is_continuous_across_planes_of_voxels(device, preclassified):
    """A ray inside a plane of voxels uses 48 voxels a cell, one 1e-9 beside it 64."""
    volume = random_volume((6, 6, 6))
    offsets = np.array([[0.0, 0.0, 0.0], [0.0, 1e-9, 0.0], [0.0, -1e-9, 0.0], [0.0, 0.0, 1e-9]])
    eyes = np.array([-3.0, 2.0, 3.0]) + offsets
    rgba, _, _ = trace(device, volume, SMOOTH, eyes, eyes + [1.0, 0.0, 0.0],
                       preclassified=preclassified, **CUBIC)
    assert rgba[0, 3] > 0.5
    check(rgba[1:], np.broadcast_to(rgba[0], (3, 4)), 1e-7)


def test_a_ray_in_a_plane_of_voxels_equals_the_slab_of_that_plane(device):
    volume = random_volume((5, 5, 5))
    eyes = np.array([[-1.0, 0.3, 2.0], [9.0, 3.3, 2.0]])
    aims = np.array([[4.0, 3.1, 2.0], [0.0, 0.2, 2.0]])
    plane = Volume(volume.data[2:3], origin=(0.0, 0.0, 2.0))
    inside = trace(device, volume, NASTY, eyes, aims)[0]
    check(inside, trace(device, plane, NASTY, eyes, aims)[0], 1e-13)


def test_grazing_rays_are_continuous(device):
    """A ray 1e-9 voxels beside a plane of voxels sees what the ray inside the plane sees."""
    volume = random_volume((5, 5, 5))
    offsets = np.array([[0.0, 0.0, 0.0], [0.0, 1e-9, 0.0], [0.0, -1e-9, 0.0], [0.0, 0.0, 1e-9]])
    eyes = np.array([-3.0, 2.0, 3.0]) + offsets
    rgba, _, _ = trace(device, volume, SMOOTH, eyes, eyes + [1.0, 0.0, 0.0])
    check(rgba[1:], np.broadcast_to(rgba[0], (3, 4)), 1e-7)


def test_splitting_a_ray_at_any_point_composites_to_the_whole(device):
    volume = random_volume()
    rng = np.random.default_rng(10)
    for axis in range(3):  # the volume cut at a plane of voxels
        cut = int(rng.integers(1, volume.grid.size[axis] - 1))
        parts, origins = np.split(volume.data, [cut], axis=2 - axis), np.zeros((2, 3))
        origins[1, axis] = cut
        first = np.concatenate([parts[0], parts[1].take([0], axis=2 - axis)], axis=2 - axis)
        second = parts[1]
        if second.shape[2 - axis] == 1:
            continue
        aims = rng.random((20, 3)) * (np.array(volume.grid.size) - 1)
        eyes = aims + rng.normal(size=(20, 3)) * 9
        eyes[:, axis] = -4.0  # the first part is in front
        near = trace(device, Volume(first), NASTY, eyes, aims)[0]
        far = trace(device, Volume(second, origin=origins[1]), NASTY, eyes, aims)[0]
        whole = trace(device, volume, NASTY, eyes, aims)[0]
        check(near + (1.0 - near[:, 3:]) * far, whole, 3e-9)


def test_oblique_and_flipped_axes(device):
    """The world's frame changes nothing that is stated in index space."""
    array = np.random.default_rng(12).random((4, 5, 6))
    angle = 0.4
    direction = np.array([[math.cos(angle), 0.0, math.sin(angle)], [0.0, -1.0, 0.0],
                          [-math.sin(angle), 0.0, math.cos(angle)]])
    turned = Volume(array, origin=(3.0, -2.0, 50.0), direction=direction)
    rng = np.random.default_rng(13)
    eyes, aims = rng.normal(size=(20, 3)) * 12, rng.random((20, 3)) * [5, 4, 3]
    plain = trace(device, Volume(array), NASTY, eyes, aims)[0]
    matrix = turned.grid.index_to_world()
    world = [p @ matrix[:3, :3].T + matrix[:3, 3] for p in (eyes, aims)]
    check(trace(device, turned, NASTY, *world)[0], plain, 3e-9)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scaling_the_world_scales_nothing_in_the_picture(device, scale):
    volume = random_volume()
    eyes, aims = np.array([[-3.0, 2.0, 1.0]]), np.array([[3.0, 1.4, 2.3]])
    tf = TransferFunction(NASTY.values, NASTY.opacities, NASTY.colors, NASTY.opacity_unit * scale)
    scaled = Volume(volume.data, spacing=(scale, scale, scale))
    check(trace(device, scaled, tf, eyes * scale, aims * scale)[0],
          trace(device, volume, NASTY, eyes, aims)[0])


# --- numbers --------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e30, 1e300])
@pytest.mark.parametrize(
    "settings", [{}, {"preclassified": True}, CUBIC, {**CUBIC, "preclassified": True}]
)
def test_huge_and_tiny_values(device, scale, settings):
    volume = random_volume()
    tf = TransferFunction(NASTY.values * scale, NASTY.opacities, NASTY.colors, NASTY.opacity_unit)
    eyes, aims = np.array([[-3.0, 2.0, 1.0]]), np.array([[3.0, 1.4, 2.3]])
    got = trace(device, Volume(volume.data * scale), tf, eyes, aims, **settings)[0]
    expected = trace(device, volume, NASTY, eyes, aims, **settings)[0]
    check(got, expected)


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16", "float32", "float64"])
def test_every_voxel_type_counts_as_its_value(device, dtype):
    info = np.iinfo(dtype) if dtype[0] in "ui" else np.iinfo("int16")
    rng = np.random.default_rng(14)
    array = rng.integers(info.min, info.max, (4, 4, 5), endpoint=True).astype(dtype)
    array[0, 0, 0], array[-1, -1, -1] = info.min, info.max
    values = info.min + NASTY.values * (float(info.max) - info.min)
    tf = TransferFunction(values, NASTY.opacities, NASTY.colors, NASTY.opacity_unit)
    eyes, aims = np.array([[-3.0, -3.0, -3.0], [-3, 2, 1]]), np.array([[4.0, 3, 3], [3, 1.4, 2.3]])
    got = trace(device, Volume(array), tf, eyes, aims)[0]
    check(got, trace(device, Volume(array.astype(np.float64)), tf, eyes, aims)[0], 1e-14)
    assert got[:, 3].min() > 0.3


def test_thousands_of_nearly_transparent_cells(device):
    volume = Volume(np.ones((2, 2, 20001)))
    rgba, _, _ = trace(device, volume, constant(1e-7, RED), [-5.0, 0.3, 0.6], [0, 0.3, 0.6])
    alpha = -math.expm1(20000 * math.log1p(-1e-7))
    np.testing.assert_allclose(rgba[0], [*(alpha * np.array(RED)), alpha], rtol=1e-12)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize(
    "settings", [{}, {"preclassified": True}, CUBIC, {**CUBIC, "preclassified": True}]
)
def test_error_stays_below_its_estimate_and_the_tolerance(device, tolerance, settings):
    volume = random_volume((12, 12, 12))
    rng = np.random.default_rng(15)
    eyes, aims = rng.normal(size=(100, 3)) * 30, rng.random((100, 3)) * 11
    tf = TransferFunction(NASTY.values, NASTY.opacities, NASTY.colors, 1.5)
    best = trace(device, volume, tf, eyes, aims, tolerance=1e-13, **settings)[0]
    rgba, _, counters = trace(device, volume, tf, eyes, aims, tolerance=tolerance, **settings)
    assert counters["failed_pieces"] == 0
    assert counters["error_estimate"] <= 2 * tolerance
    check(rgba, best, tolerance)


def test_a_looser_tolerance_takes_fewer_samples(device):
    volume = random_volume((12, 12, 12))
    eyes, aims = np.array([[-9.0, 2.0, 5.0]]), np.array([[8.0, 7.0, 6.0]])
    tf = TransferFunction(NASTY.values, NASTY.opacities, NASTY.colors, 9.0)
    samples = [trace(device, volume, tf, eyes, aims, tolerance=tolerance)[2]["samples"]
               for tolerance in (1e-3, 1e-7, 1e-12)]
    assert samples[0] < samples[1] < samples[2]


def test_transparent_cells_cost_no_samples(device):
    array = np.zeros((8, 8, 64))
    array[..., 50:] = 1.0
    tf = TransferFunction([0.5, 0.6], [0.0, 0.5], [RED, RED])
    _, _, counters = trace(device, Volume(array), tf, [-3.0, 3.3, 3.6], [0, 3.3, 3.6])
    assert counters["cells"] == 63 and counters["pieces"] == 15
    _, _, counters = trace(device, Volume(array * 0.4), tf, [-3.0, 3.3, 3.6], [0, 3.3, 3.6])
    assert counters["cells"] == 63 and counters["pieces"] == counters["samples"] == 0


def test_many_control_points(device):
    """A transparent hair on every value: nothing is lost between 5000 control points."""
    values = np.linspace(0.0, 1.0, 5001)
    tf = TransferFunction(values, np.linspace(0.1, 0.6, 5001), np.linspace(RED, GREEN, 5001))
    two = TransferFunction([0.0, 1.0], [0.1, 0.6], [RED, GREEN])
    volume = random_volume()
    eyes, aims = np.array([[-3.0, 2.0, 1.0]]), np.array([[3.0, 1.4, 2.3]])
    check(trace(device, volume, tf, eyes, aims)[0], trace(device, volume, two, eyes, aims)[0], 2e-9)


def test_random_scenes_stay_within_bounds(device):
    """Values on control points, opacities at and next to 0 and 1, rays along edges, any length."""
    rng = np.random.default_rng(17)
    for _ in range(80):
        shape = rng.integers(1, 7, 3)
        array = rng.integers(0, 3, shape) / 2.0 if rng.random() < 0.4 else rng.random(shape)
        count = rng.integers(1, 7)
        values = [0, 0.25, 0.5, 0.5, 0.75, 1, *rng.random(4)]
        values = np.sort(rng.choice(values, count, replace=False))
        opacities = rng.choice([0, 0, 1, 1, 1 - 1e-7, 1e-7, 0.5, 0.99, *rng.random(4)], count)
        unit = 10.0 ** rng.integers(-12, 12)
        tf = TransferFunction(values, opacities, rng.random((count, 3)), unit)
        volume = Volume(array, spacing=10.0 ** rng.uniform(-1, 1, 3))
        spacing, size = np.array(volume.grid.spacing), np.array(volume.grid.size)
        aims = rng.random((60, 3)) * (size - 1) * spacing
        aims[:30] = rng.integers(0, size, (30, 3)) * spacing
        eyes = aims + rng.normal(size=(60, 3)) * (size * spacing).max() * 3
        eyes[:20] = aims[:20] + rng.integers(1, 4, (20, 3)) * spacing
        for settings in ({}, {"preclassified": True}, {"nearest": True}, CUBIC):
            rgba, depth, counters = trace(device, volume, tf, eyes, aims, **settings)
            assert np.isfinite(rgba).all() and rgba.min() >= 0.0 and rgba[:, 3].max() <= 1.0
            assert np.all(rgba[:, :3] <= tf.colors.max(axis=0) * rgba[:, 3:] + 1e-9)
            sure = np.abs(rgba[:, 3] - 0.5) > 1e-12
            assert np.array_equal(np.isfinite(depth)[sure], (rgba[:, 3] > 0.5)[sure])
            assert counters["samples"] < 60 * 100_000


# --- the picture ----------------------------------------------------------------------------------


def scene(**integration):
    volume = Volume(np.random.default_rng(16).random((8, 8, 8)).astype(np.float32))
    return clvol.Scene(volume=volume, transfer_function=SMOOTH, image={"width": 24, "height": 17},
                       integration={"method": "reference", **integration}).resolve()


def test_picture_and_chosen_pixels_agree_bit_for_bit(device):
    resolved, calls = scene(), []
    rgba, depth, counters = render_reference(resolved, device,
                                             progress=lambda *done: calls.append(done))
    assert rgba.shape == (17, 24, 4) and depth.shape == (17, 24) and rgba.dtype == np.float64
    assert counters["rays"] == 17 * 24 and calls[-1] == (17 * 24, 17 * 24)
    assert 0 < np.count_nonzero(rgba[..., 3]) < rgba[..., 3].size
    pixels = np.array([[8, 12], [0, 0], [9, 3], [16, 23]])
    some, some_depth, _ = render_reference(resolved, device, pixels=pixels)
    assert np.array_equal(some, rgba[pixels[:, 0], pixels[:, 1]])
    assert np.array_equal(some_depth, depth[pixels[:, 0], pixels[:, 1]])


def test_post_and_preintegrated_are_one_integral_and_pre_another(device):
    post, pre, table = (
        render_reference(scene(classification=name), device)[0]
        for name in ("post", "pre", "preintegrated")
    )
    assert np.array_equal(post, table) and np.abs(post - pre).max() > 1e-3


def test_depth_of_an_orthographic_view_counts_from_its_plane(device):
    volume = Volume(np.ones((9, 9, 9)))
    resolved = clvol.Scene(
        volume=volume, transfer_function=constant(0.5), image={"width": 8, "height": 8},
        camera={"projection": "orthographic", "position": [4.0, 4.0, 20.0],
                "target": [4.0, 4.0, 4.0], "up": [0.0, 1.0, 0.0], "height": 6.0},
    ).resolve()
    rgba, depth, _ = render_reference(resolved, device)
    check(rgba[..., 3], np.full((8, 8), 1 - 0.5**8), 1e-12)
    check(depth, np.full((8, 8), 13.0), 1e-9)


@pytest.mark.parametrize(
    "changes, key",
    [({"light": [{"type": "headlight"}]}, "light"),
     ({"clip": [{"point": [1.0, 0.0, 0.0], "normal": [1.0, 0.0, 0.0]}]}, "clip"),
     ({"isosurface": [{"value": 0.5}]}, "isosurface")],
)
def test_what_is_not_integrated_is_refused(changes, key):
    resolved = clvol.Scene(volume=random_volume(), transfer_function=SMOOTH, **changes).resolve()
    with pytest.raises(SceneError, match=f"{key}: got .* with method 'reference', expected"):
        render_reference(resolved, None)


@pytest.mark.parametrize(
    "pixels", [[[0, 24]], [[17, 0]], [[-1, 0]], [1, 2], [[0.5, 1.0]], np.zeros((2, 3), int)]
)
def test_wrong_pixels_are_refused(pixels):
    with pytest.raises(UsageError, match="pixels"):
        render_reference(scene(), None, pixels=pixels)


def test_a_wrong_filter_is_refused():
    with pytest.raises(UsageError, match="filter: got 'quintic', expected 'linear' or"):
        trace(None, random_volume(), SMOOTH, [0, 0, 0], [1, 1, 1], filter="quintic")


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0, math.nan])
def test_wrong_tolerances_are_refused(tolerance):
    with pytest.raises(UsageError, match="tolerance"):
        render_reference(scene(), None, tolerance=tolerance)


# --- the rules ------------------------------------------------------------------------------------


def tables():
    text = (kernel_folder() / "reference_rules.h").read_text(encoding="utf-8")
    found = re.findall(r"double (\w+)\[\d+\] = \{(.*?)\};", text, re.DOTALL)
    return {name: np.array([float(x) for x in body.split(",")]) for name, body in found}


@pytest.mark.parametrize("kronrod, gauss", [("K7", "G3"), ("K15", "G7")])
def test_quadrature_rules_integrate_polynomials(kronrod, gauss):
    table = tables()
    nodes = table[f"reference_{kronrod}_node"]
    degrees = (3 * len(nodes) + 1) // 2, len(nodes) - 2  # exact up to
    for rule, x, degree in zip((kronrod, gauss), (nodes, nodes[1::2]), degrees):
        weights = table[f"reference_{rule}_weight"]
        columns = table[f"reference_{rule}_antiderivative"].reshape(len(x), -1)
        for power in range(degree + 1):
            check(weights @ x**power, 1 / (power + 1), 1e-15)
        for power in range(len(x)):
            check((x**power @ columns)[: len(x)], x ** (power + 1) / (power + 1), 1e-15)
        assert not columns[:, len(x):].any()
