"""The bench's own arithmetic and scenes: what a figure is made of, not the figures."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.curves import geometric_mean, lower_envelope, reach
from bench.peers import headline, overall
from bench.reference_cache import Exact, chosen_pixels
from bench.scenes import OPACITY_UNIT, SCENES, camera
from clvol.accuracy.timing import FEWEST_FRAMES, summary, take_turns
from clvol.features.scene_warnings import camera_warning, scene_warnings

SIDE = 9


@pytest.fixture(scope="module")
def volume():
    from clvol import Volume

    ramp = np.arange(SIDE**3, dtype=np.float64).reshape(SIDE, SIDE, SIDE)
    return Volume((ramp * 255 / ramp.max()).astype(np.uint8), spacing=(1.0, 2.0, 1.5))


def _power_law(times, factor=1e-3, exponent=-1.5):
    return [(t, factor * t**exponent) for t in times]


# Scenes


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_scene_resolves_to_its_points_as_linear_colours(scene, volume):
    resolved = scene.scene(volume, 32, step=0.5).resolve()
    function = resolved.transfer_function
    assert function.opacity_unit == OPACITY_UNIT
    assert function.values.tolist() == [p[0] for p in scene.points]
    assert function.opacities.tolist() == [p[1] for p in scene.points]
    assert function.colors.tolist() == [list(p[2]) for p in scene.points]
    assert (resolved.image.width, resolved.image.height) == (32, 32)
    assert resolved.integration.step == 0.5
    assert not resolved.lights and not resolved.background.any()


def test_scenes_are_what_their_names_say():
    by_name = {scene.name: scene for scene in SCENES}
    assert list(by_name) == ["engine-smooth", "engine-peaks", "aneurism", "vismale", "heptane"]
    assert all(opacity > 0 for _, opacity, _ in by_name["heptane"].points)
    peaks = [o for _, o, _ in by_name["engine-peaks"].points]
    assert sum(o > 0 for o in peaks) == 3
    assert max(o for _, o, _ in by_name["vismale"].points) > 0.9


def test_camera_sees_the_whole_volume(volume):
    corners = volume.grid.world_corners()
    view = camera(volume)
    forward, right, up = view.basis()
    ahead, across, above = np.stack([forward, right, up]) @ (corners - np.array(view.position)).T
    half = math.tan(math.radians(view.fov_degrees) / 2)
    assert (ahead > 0).all()
    assert (np.abs(across) < half * ahead).all() and (np.abs(above) < half * ahead).all()


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_real_scene_has_its_volume_without_origin_or_direction(scene, shared_volume):
    path = shared_volume(scene.file)
    grid = scene.load(path.parent).grid
    assert tuple(grid.origin) == (0.0, 0.0, 0.0)
    assert np.array_equal(grid.direction, np.eye(3))


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_nothing_is_to_warn_of_in_a_scene(scene, shared_volume):
    shared_volume(scene.file)
    resolved = scene.scene(scene.load(), 64).resolve()
    assert scene_warnings(resolved) == []
    assert camera_warning(resolved.camera, resolved.volume.grid, 64, 64) is None


# Curves


def test_a_power_law_is_interpolated_exactly():
    curve = _power_law([0.01, 0.1, 1.0])
    for t in (0.02, 0.1, 0.7):
        found = reach(curve, 1e-3 * t**-1.5)
        assert found.kind == "interpolated"
        assert found.seconds == pytest.approx(t, rel=1e-12)


def test_an_error_below_the_curve_is_not_reached_and_the_least_is_told():
    found = reach(_power_law([0.01, 0.1, 1.0]), 1e-4)
    assert found.seconds is None and found.kind == "not reached"
    assert found.least_error == pytest.approx(1e-3)


def test_an_error_above_the_curve_is_not_extrapolated():
    found = reach(_power_law([0.01, 0.1, 1.0]), 100.0)
    assert (found.seconds, found.kind) == (0.01, "at most")


def test_points_that_are_slower_and_worse_do_not_count():
    curve = _power_law([0.01, 0.1, 1.0])
    worse = [(0.2, 1.0), (0.1, 0.5), (5.0, 0.9)]
    assert lower_envelope(worse + curve) == curve
    assert reach(worse + curve, 2e-3) == reach(curve, 2e-3)


def test_a_curve_that_stops_converging_reaches_only_its_least_error():
    plateau = [(1.0, 0.1), (2.0, 0.01), (4.0, 0.012), (8.0, 0.02)]
    assert reach(plateau, 0.01).seconds == pytest.approx(2.0)
    assert reach(plateau, 0.0099).seconds is None


def test_an_exact_point_reaches_every_error_at_its_own_time():
    assert reach([(1.0, 0.1), (2.0, 0.0)], 1e-9).seconds == 2.0


def test_geometric_mean():
    assert geometric_mean([2.0, 8.0]) == pytest.approx(4.0)
    assert math.isnan(geometric_mean([]))


# Headline


def _points(steps, factor, error):
    return [
        {"step": s, "seconds": factor / s, "least": factor / s, "rmse": error * s} for s in steps
    ]


def test_headline_of_two_known_curves():
    """Both have error ~ step and time ~ 1 / step: half the time and a quarter of the error at each
    step are twice and eight times as fast."""
    steps = [4.0, 2.0, 1.0, 0.5, 0.25]
    found = headline(_points(steps, 0.2, 0.04), _points(steps, 0.1, 0.01))
    assert found["ratio"] == pytest.approx(2.0)
    assert found["ratio_at_vtk_error"] == pytest.approx(8.0)
    assert found["ratio_at_clvol_error"] == pytest.approx(8.0)
    assert found["clvol_to_vtk_error"]["seconds"] == pytest.approx(0.025)


def test_overall_claims_nothing_where_one_scene_does_not_reach_the_error():
    good = headline(_points([2.0, 1.0, 0.5], 0.2, 0.04), _points([4.0, 1.0], 0.1, 0.01))
    bad = headline(_points([2.0, 1.0, 0.5], 0.2, 0.001), _points([4.0, 1.0], 0.1, 0.01))
    assert bad["ratio_at_vtk_error"] is None
    both = overall([good, bad])
    assert both["least_ratio_at_vtk_error"] is None and both["mean_ratio_at_vtk_error"] is None
    assert both["always_lower_error"] is False
    assert overall([good])["always_lower_error"] is True
    assert both["mean_ratio"] == pytest.approx(2.0)


# Times


def test_candidates_take_turns():
    order = []

    def call(name, seconds):
        def timed():
            order.append(name)
            return seconds

        return timed

    taken = take_turns({"a": call("a", 0.1), "b": call("b", 0.2)}, rounds=7)
    assert order == ["a", "a", "b", "b"] * 7  # the first of two finds its data in the caches again
    assert taken["a"]["median"] == 0.1 and taken["b"]["frames"] == 7


def test_a_slow_candidate_makes_no_frame_that_does_not_count():
    calls = []
    take_turns({"slow": lambda: calls.append(0) or 0.7}, rounds=3)
    assert len(calls) == 1 + 3  # only before the first is it not known to be slow


def test_slow_candidates_stop_early_but_not_the_headline():
    slow = {"slow": lambda: 5.0, "headline": lambda: 5.0}
    taken = take_turns(slow, rounds=9, never_slow=("headline",))
    assert taken["slow"]["frames"] == FEWEST_FRAMES
    assert taken["headline"]["frames"] == 9


def test_summary_of_times():
    found = summary([0.3, 0.1, 0.2])
    assert (found["median"], found["min"], found["max"]) == (0.2, 0.1, 0.3)


# Errors


def test_chosen_pixels_are_distinct_inside_and_the_same_each_time():
    some = chosen_pixels(64, 1000)
    assert some.shape == (1000, 2) and len(np.unique(some, axis=0)) == 1000
    assert some.min() >= 0 and some.max() < 64
    assert np.array_equal(some, chosen_pixels(64, 1000))
    assert len(chosen_pixels(64, 10**6)) == 64 * 64


def test_rmse_is_over_the_chosen_pixels_and_all_channels():
    pixels = np.array([[0, 0], [1, 2]])
    picture = np.zeros((3, 3, 4), np.float32)
    picture[1, 2, 0] = 0.5
    picture[2, 2] = 9.0  # not chosen
    exact = Exact(pixels, np.zeros((2, 4)))
    assert exact.rmse(picture) == pytest.approx(math.sqrt(0.25 / 8))
    assert exact.max_abs(picture) == 0.5


# The peer


def test_vtk_draws_the_same_view(device):
    pytest.importorskip("vtkmodules", reason="vtk is not installed, so there is no peer to compare")
    from bench.vtk_peer import VtkPeer
    from clvol.integrators.reference.picture import render_reference
    from clvol.volume.procedural import Gaussian, sample

    field = Gaussian(center=(14.0, 20.0, 17.0), sigma=8.0, amplitude=250.0)
    volume = sample(field, (24, 20, 28), (1.0, 2.0, 1.5), dtype="uint8")
    scene = next(s for s in SCENES if s.name == "aneurism")
    resolved = scene.scene(volume, 48).resolve()
    peer = VtkPeer(resolved, threads=1)
    try:
        wall, mapper = peer.render(0.25)
        rays, window = peer.ray_picture(), peer.window_picture()
    finally:
        peer.close()
    assert wall > 0 and mapper > 0
    exact, _, _ = render_reference(resolved, device, tolerance=1e-6)

    def rmse(picture):
        return math.sqrt(np.mean((picture - exact) ** 2))

    assert exact[..., 3].max() > 0.01
    assert rmse(rays) < 0.25 * min(rmse(rays[::-1]), rmse(rays[:, ::-1]))
    assert rmse(rays) < 0.25 * min(rmse(np.roll(rays, n, axis)) for n in (-1, 1) for axis in (0, 1))
    assert math.sqrt(np.mean((window - rays) ** 2)) < rmse(np.roll(rays, 1, 0))
