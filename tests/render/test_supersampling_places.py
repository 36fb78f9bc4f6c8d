"""Where rays go in a pixel, how a pixel weighs them, and which pixels get more: arithmetic, without a device."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import Camera, Volume
from clvol.device.view import ray_frame
from clvol.render.supersampling.edges import Edges
from clvol.render.supersampling.pattern import SAMPLES, pattern
from clvol.render.supersampling.pixel_filter import FILTERS, FilteredPicture
from clvol.render.supersampling.thin import hidden
from clvol.transfer.color import linear_to_srgb, srgb_to_linear

BLACK = np.zeros(3)


def coverage(angle: float, offset: np.ndarray) -> np.ndarray:
    """Exact: the shares of a pixel in which x cos + y sin < offset."""
    across = np.sort(np.abs([np.cos(angle), np.sin(angle)]))[::-1]
    # The projection of a unit square on the direction is a trapezium.
    flat, slope = (across[0] - across[1]) / 2, max(across[1], 1e-12)
    t = np.abs(np.minimum(offset, -offset))
    tail = np.where(
        t <= flat, 0.5 - t / across[0], np.maximum(flat + slope - t, 0.0) ** 2 / (2 * across[0] * slope)
    )
    return np.where(offset < 0, tail, 1.0 - tail)


def half_plane_error(samples: int, name: str, degrees: float) -> float:
    """RMS over all offsets of a half plane's edge that pass the pixel."""
    angle = np.radians(degrees)
    reach = (abs(np.cos(angle)) + abs(np.sin(angle))) / 2
    offset = np.linspace(-reach, reach, 4001)
    along = pattern(samples, name).offsets() @ [np.cos(angle), np.sin(angle)]
    found = (along[None, :] < offset[:, None]).mean(axis=1)
    return float(np.sqrt(np.mean((found - coverage(angle, offset)) ** 2)))


def test_the_exact_coverage_is_that_of_many_rays():
    grid = (np.stack(np.meshgrid(*2 * [np.arange(400)]), axis=-1).reshape(-1, 2) + 0.5) / 400 - 0.5
    offset = np.linspace(-0.7, 0.7, 15)
    for degrees in (0, 17, 45, 61, 90, 133):
        along = grid @ [np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]
        many = (along[None] < offset[:, None]).mean(axis=1)
        assert np.allclose(coverage(np.radians(degrees), offset), many, atol=2e-3)


@pytest.mark.parametrize("samples", [4, 8, 16])
def test_rotated_patterns_are_better_where_edges_are_nearly_upright_or_level(samples):
    for degrees in (0, 3, 87, 90, 93, 177):
        rotated, regular = (half_plane_error(samples, name, degrees) for name in ("rotated", "regular"))
        assert rotated < 0.75 * regular


def test_half_planes_of_every_angle_have_about_their_coverage():
    for name in ("rotated", "regular"):
        errors = {n: np.mean([half_plane_error(n, name, d) for d in np.arange(0, 180, 3)]) for n in SAMPLES}
        assert all(errors[n] > 1.3 * errors[2 * n] for n in (1, 2, 4, 8))
    worst = {n: max(half_plane_error(16, n, d) for d in np.arange(0, 180, 3)) for n in ("rotated", "regular")}
    assert worst["rotated"] < 0.65 * worst["regular"]


@pytest.mark.parametrize("name", ["rotated", "regular"])
@pytest.mark.parametrize("samples", SAMPLES)
def test_patterns_have_so_many_rays_about_the_middle(samples, name):
    made = pattern(samples, name)
    offsets = made.offsets()
    assert len(set(made.places)) == samples
    assert np.abs(offsets).max() < 0.5
    assert {tuple(o) for o in np.round(offsets, 9)} == {tuple(o) for o in np.round(-offsets, 9)}
    if name == "rotated":
        assert all(len({place[axis] for place in made.places}) == samples for axis in range(2))


@pytest.mark.parametrize("name", FILTERS)
def test_a_filter_leaves_what_is_constant_and_keeps_the_mean_of_what_is_linear(name):
    made = pattern(4, "rotated")
    color = np.array([0.1, 0.3, 0.7, 0.9], np.float32)
    constant, ramp = FilteredPicture(name, 5, 7), FilteredPicture(name, 9, 9)
    columns = np.arange(9, dtype=np.float32)
    for offset in made.offsets():
        constant.add(np.broadcast_to(color, (5, 7, 4)), offset)
        there = (columns + offset[0]) / 20
        ramp.add(np.broadcast_to(there[None, :, None], (9, 9, 4)).astype(np.float32), offset)
    assert np.array_equal(constant.take(), np.broadcast_to(color, (5, 7, 4)))
    inner = ramp.take()[3:-3, 3:-3]
    assert np.allclose(inner, (columns / 20)[None, 3:-3, None], atol=2e-3 if name == "gaussian" else 1e-6)


def test_the_box_is_the_mean_and_the_others_reach_into_neighbours():
    spot = np.zeros((5, 5, 4), np.float32)
    spot[2, 2] = 1.0
    for name in FILTERS:
        made = FilteredPicture(name, 5, 5)
        for offset in pattern(4, "regular").offsets():
            made.add(spot, offset)
        found = made.take()[..., 0]
        assert np.allclose(found, found.T) and np.allclose(found, found[::-1, ::-1])
        assert (found[2, 1] > 0.0) == (name != "box")
        assert found[2, 2] == found.max() and (found >= 0.0).all()


def edges(threshold=0.02, background=BLACK, footprint=(1.0, 0.0)) -> Edges:
    return Edges(threshold, background, None, footprint)


def picture(values) -> np.ndarray:
    """float32 [1, n, 4], opaque greys."""
    row = np.repeat(np.asarray(values, np.float32)[None, :, None], 4, axis=2)
    row[..., 3] = 1.0
    return row


def test_pixels_are_compared_as_they_are_displayed():
    # The same step of light is displayed as a large one in the dark and as a small one in what is bright.
    light = np.array([0.0, 0.0, 0.005, 0.005, 0.9, 0.9, 0.905, 0.905])
    found = edges(0.03).find(picture(light), None)[0]
    shown = linear_to_srgb(light)
    step = np.abs(np.diff(shown)) >= 0.03
    assert found.tolist() == (np.append(step, False) | np.append(False, step)).tolist()
    assert found.tolist() == [False, True, True, True, True, False, False, False]


def test_light_behind_what_is_clear_counts_and_so_does_opacity():
    half = picture([0.5, 0.5, 0.5])
    half[0, 1, 3] = 0.0  # the same light, without opacity
    assert edges().find(half, None).all()
    clear = np.zeros((1, 2, 4), np.float32)
    clear[0, 1] = 0.5, 0.5, 0.5, 1.0
    over = Edges(0.9, np.full(3, 0.5), None, (1.0, 0.0))
    assert over.find(clear, None).all()  # opacity alone: the colour is the background's
    assert not Edges(1.0, np.full(3, 0.5), None, (1.0, 0.0)).find(0.5 * clear, None).any()


def test_a_step_in_depth_is_an_edge_and_a_steep_surface_is_not():
    same = picture(np.full(5, 0.5))
    assert edges().find(same, np.array([[10.0, 10, 30, 30, 30]], np.float32)).tolist() == [
        [False, True, True, False, False]
    ]
    assert not edges().find(same, np.array([[10.0, 20, 30, np.inf, np.inf]], np.float32)).any()


def test_a_ramp_is_no_bend_and_a_stronger_one_has_the_higher_grade():
    ramp = edges(0.001).grade(graded_by(np.linspace(0.2, 0.7, 9)), None)
    assert ramp.tolist() == [[2, *7 * [0], 2]]  # beyond the picture nothing is known: what is there goes on
    found = edges(0.04).grade(graded_by([0.2, 0.2, 0.25, 0.25, 0.25, 0.6, 0.6, 0.6]), None)
    assert found.tolist() == [[0, 1, 1, 0, 2, 2, 0, 0]]
    depth = np.array([[10.0, 10, 10, 30, 30]], np.float32)
    assert edges().grade(picture(np.full(5, 0.5)), depth).tolist() == [[0, 0, 2, 2, 0]]


def graded_by(displayed) -> np.ndarray:
    """float32 [1, n, 4]: opaque greys that are displayed as these."""
    return picture(srgb_to_linear(np.asarray(displayed)))


def test_pixels_beside_which_nothing_is_drawn_are_compared_like_others():
    rng = np.random.default_rng(8)
    for shape in ((1, 1), (9, 7), (12, 1), (1, 15)):
        for share in (0.0, 0.05, 1.0):
            rgba = np.where(rng.random(shape)[..., None] < share, rng.random((*shape, 4)), 0).astype(np.float32)
            depth = np.where(rgba[..., 3] > 0.3, 50 * rng.random(shape), np.inf).astype(np.float32)
            framed = np.ones((shape[0] + 2, shape[1] + 2, 4), np.float32)  # drawn to the edge: all is compared
            framed[1:-1, 1:-1] = rgba
            around = np.pad(depth, 1, constant_values=np.inf)
            expected = np.zeros(framed.shape[:2], bool)
            shown, compare = edges().shown(framed), edges()
            for y in range(1, shape[0] + 1):
                for x in range(1, shape[1] + 1):
                    for v, w in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
                        if 0 < v <= shape[0] and 0 < w <= shape[1]:
                            one, other = (y, slice(x, x + 1)), (v, slice(w, w + 1))
                            differ = compare.differ(shown[(slice(None), *one)], shown[(slice(None), *other)])
                            expected[y, x] |= bool(differ[0] | compare.apart(around[one], around[other])[0])
            np.testing.assert_array_equal(edges().find(rgba, depth), expected[1:-1, 1:-1])


def test_threshold_0_means_all_pixels_and_1_hardly_any():
    assert edges(0.0).find(picture([0.2, 0.2]), None).all()
    assert not edges(1.0).find(picture([0.2, 0.9]), None).any()


def test_pixels_that_see_nothing_but_are_covered_by_small_cells_may_hide_something():
    volume = Volume(np.zeros((32, 32, 32), np.uint8))
    cells = np.zeros((8, 8, 8), bool)
    cells[:, 4, 4] = True
    camera = Camera(projection="orthographic", position=(-50, 15.5, 15.5), target=(15.5, 15.5, 15.5), up=(0, 1, 0),
                    height=64.0)  # fmt: skip
    for size, all_of_them in ((8, True), (64, False)):
        frame = ray_frame(camera, volume.grid, size, size)
        nothing = np.zeros((size, size), np.float32)
        found = hidden(cells, 2, volume.grid, frame, nothing)
        covered = np.zeros((size, size), bool)
        pixel = 64 / size
        # y from 16 to 20 lies half a pixel's number above the middle; all of z.
        rows = np.floor((47.5 - np.array([20, 16])) / pixel - 0.01), np.floor((47.5 - 16) / pixel)
        covered[int(rows[0].min()) : int(rows[1]) + 1, int(16 / pixel) : int(47 / pixel) + 1] = True
        assert found.any() and not (found & ~np.pad(covered, 1)[2:, 2:] & ~covered).sum() > 2 * size
        assert (found.sum() >= 0.8 * covered.sum()) == all_of_them
        assert not hidden(cells, 2, volume.grid, frame, nothing + 0.1).any()
        assert not hidden(np.zeros_like(cells), 2, volume.grid, frame, nothing).any()
