"""What the bench of the method "pyramid" is made of: its scenes, its arithmetic, its tables, and a
quick run of it all on small volumes."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from bench import pyramid as bench
from bench.curves import Reach
from bench.options import Options
from bench.pyramid_claims import _bilinear, _coarse, _kinks, _subdivided
from bench.pyramid_parts import (
    PAPER_WAYS,
    Bench,
    best_way,
    caster,
    crossing,
    crossing_text,
    dearer,
    picture,
    way_name,
    way_row,
)
from bench.pyramid_pictures import TIMES, difference
from bench.pyramid_scenes import (
    ANEURISM,
    HEPTANE,
    LEVELS,
    PYRAMID_SCENES,
    by_pyramid,
    by_rays,
    ray_spacing,
    resampled,
)
from bench.pyramid_tables import show, verdicts
from bench.scenes import BenchScene

SHAPE = (20, 24, 40)


@pytest.fixture(scope="module")
def volume():
    from clvol import Volume

    random = np.random.default_rng(3)
    data = random.integers(0, 255, SHAPE).astype(np.uint8)
    data[:, :, :16] = 0
    return Volume(data, spacing=(1.0, 0.5, 2.0), name="random")


# Scenes


@pytest.mark.parametrize("scene", PYRAMID_SCENES, ids=lambda scene: scene.name)
def test_scenes_of_both_methods_differ_in_the_method_alone(scene, volume):
    plain = by_rays(scene, volume, 32, step=2.0)
    adaptive = by_pyramid(scene, volume, 32, {"step": 2.0}, oracle="minimum", epsilon=0.1)
    assert plain.integration.classification == "preintegrated" and plain.integration.step == 2.0
    assert plain.integration == adaptive.integration.model_copy(update={"method": "raycast"})
    assert plain.camera == adaptive.camera
    assert plain.transfer_function.values.tolist() == adaptive.transfer_function.values.tolist()
    asked = adaptive.pyramid
    assert (asked.levels, asked.oracle, asked.epsilon) == (LEVELS, "minimum", 0.1)


@pytest.mark.parametrize("scene", PYRAMID_SCENES, ids=lambda scene: scene.name)
def test_the_step_of_the_paper_is_the_spacing_of_rays(scene, volume):
    from clvol.integrators.pyramid.slices import slice_plan

    plain = by_rays(scene, volume, 64)
    step = ray_spacing(plain)
    origins, directions = plain.camera.world_rays(64, 64)
    middle = volume.grid.world_corners().mean(axis=0)
    eye = origins[32, 32]
    away = np.linalg.norm(middle - eye)
    rays = directions[32, 31:33]
    apart = np.linalg.norm(np.diff(rays, axis=0)) * away / volume.grid.smallest_edge
    assert step == pytest.approx(apart, rel=1e-2)
    adaptive = by_pyramid(scene, volume, 64, {"step": step})
    assert slice_plan(adaptive, adaptive.camera, 64, 64).oversampling == 0


# Resampling


def test_resampling_keeps_the_ends_and_the_world(volume):
    found = resampled(volume, 33)
    assert found.shape == (33, 33, 33) and found.dtype == volume.dtype
    ends = np.ix_(*3 * [[0, -1]])
    assert (found.data[ends] == volume.data[ends]).all()
    last, before = (np.array(v.grid.size) - 1 for v in (found, volume))
    assert last * found.grid.spacing == pytest.approx(before * np.array(volume.grid.spacing))


def test_resampling_keeps_linear_fields():
    from clvol import Volume

    z, y, x = np.meshgrid(*map(np.arange, (9, 9, 9)), indexing="ij")
    linear = (4 * z + 2 * y + 6 * x + 5).astype(np.uint8)
    found = resampled(Volume(linear), 17).data
    z, y, x = np.meshgrid(*map(np.arange, (17, 17, 17)), indexing="ij")
    assert (found == 2 * z + y + 3 * x + 5).all()
    assert (resampled(Volume(linear), 9).data == linear).all()


def test_resampling_rounds_to_the_nearest(volume):
    from scipy.ndimage import map_coordinates

    places = np.meshgrid(*(np.linspace(0, n - 1, 50) for n in SHAPE), indexing="ij")
    exact = map_coordinates(volume.data.astype(float), places, order=1)
    assert np.abs(resampled(volume, 50).data - exact).max() <= 0.5 + 1e-3


# Arithmetic


def test_the_crossing_is_interpolated_in_logarithms():
    found = crossing([(1.0, 0.5), (4.0, 0.5), (16.0, 2.0), (32.0, 3.0)])
    assert found.kind == "interpolated" and found.seconds == pytest.approx(8.0)
    assert "from 8.00 times" in crossing_text(found)


def test_the_crossing_is_the_last_one():
    found = crossing([(1.0, 1.5), (2.0, 0.5), (8.0, 2.0)])
    assert found.kind == "interpolated" and found.seconds == pytest.approx(4.0)


def test_where_nothing_crosses():
    below = crossing([(1.0, 1.1), (4.0, 2.0)])
    assert below.kind == "at most" and "below" in crossing_text(below)
    never = crossing([(1.0, 0.5), (4.0, 0.9)])
    assert never.seconds is None and "at no cost" in crossing_text(never)


def test_ways_are_told_over_minimum_and_over_plain():
    def frame(samples: int):
        return SimpleNamespace(samples=samples, counters={"oracle_samples": 2 * samples})

    frames = {"plain": frame(50), "minimum": frame(900), "error": frame(100)}
    times = {"plain": _time(0.5), "minimum": _time(3.0), "error": _time(1.0)}
    row = way_row("error", frames, times)
    assert (row["faster"], row["fewer"], row["of_plain"]) == (3.0, 9.0, 2.0)
    assert row["fewer_than_p1"] == 18.0
    assert way_row("minimum", frames, times)["fewer"] == 1.0


def test_the_best_way_is_the_one_with_fewest_samples_that_is_close_enough():
    ways = {"minimum": {"ssim": 1.0, "delta_e": 0.0, "samples": 1},
            "a": {"ssim": 0.99, "delta_e": 0.1, "samples": 9},
            "b": {"ssim": 0.986, "delta_e": 0.3, "samples": 5},
            "c": {"ssim": 0.97, "delta_e": 0.5, "samples": 3}}  # fmt: skip
    assert best_way(ways, ways) == "b"
    assert best_way(ways, ["minimum", "c"]) == "c"


def test_differences_are_shown_as_displayed():
    one, other = np.zeros((2, 3, 4), np.float32), np.zeros((2, 3, 4), np.float32)
    one[0, 0, 0], other[1, 2, 1] = 0.001, 1.0
    shown = difference(one, other)
    assert shown[0, 0].tolist() == [round(255 * TIMES * 0.01292), 0, 0]
    assert shown[1, 2].tolist() == [0, 255, 0] and shown[0, 1].max() == 0


def test_dearer_samples_change_no_picture(volume, device, tmp_path):
    shared = Bench(device, 32, 1, tmp_path)
    plain = caster(shared, by_rays(ANEURISM, volume, 32))
    other = dearer(plain, 3)
    assert other.switches["SAMPLE_REPEATS"] == 3 and "SAMPLE_REPEATS" not in plain.switches
    assert (picture(other).rgba == picture(plain).rgba).all()


# What is said


def _time(median: float) -> dict:
    return {"median": median, "min": median, "max": median, "spread": 0.02, "frames": 7}


_RATIO = {"ratio": 1.2, "low": 1.1, "high": 1.3}
_COUNTERS = {"oracle_samples": 10, "syntheses": 20, "accumulations": 30}


BEST = way_name(*PAPER_WAYS[1])


def _paper(name: str, goals: dict | None, fewer: float, faster: float) -> dict:
    way = {"time": _time(1.0), "samples": 9e6, "counters": {}, "faster": 1.0, "fewer": 1.0,
           "fewer_than_p1": 1.3, "of_plain": 1.0, "rmse": 1e-3, "ssim": 0.9, "delta_e": 2.0}  # fmt: skip
    best = {**way, "counters": _COUNTERS, "faster": faster, "fewer": fewer, "ssim": 0.99,
            "delta_e": 0.5}  # fmt: skip
    names = [way_name(*settings) for settings in PAPER_WAYS]
    ways = dict.fromkeys(("plain", "unskipped", "minimum", *names), way)
    return {"scene": name, "voxels": (512, 512, 512), "size": 64, "step": 1.8, "goals": goals,
            "best": BEST, "overhead": _RATIO, "ways": ways | {BEST: best}}  # fmt: skip


def _crossover(name: str, costs: tuple, found: Reach) -> dict:
    counted = {"plain": 2e6, "pyramid": 1e6, "unskipped": 3e6}
    rows = [
        {"level": level, "cost": cost, "plain": _time(0.1 * cost),
         "pyramid": _time(0.3 * cost**0.5), "faster": _RATIO, "samples": counted,
         "rmse": dict.fromkeys(counted, 1e-3)}
        for level, cost in zip((0, 1, 2, "cubic"), costs)
    ]  # fmt: skip
    return {"scene": name, "rows": rows, "crossing": vars(found)}


def _result() -> dict:
    return {
        "size": 64, "seconds": 1.0, "load_before": None, "load_after": None, "quick": True,
        "missing": ["chest"], "failed": ["oracles: no"],
        "machine": {"processor": "some", "cores": 2, "commit": None},
        "paper": [
            _paper("aneurism", None, 1.0, 1.0),
            _paper("aneurism 512^3", bench.ANEURISM_GOALS, 60.0, 3.0),
            _paper("female", bench.CHEST_GOALS, 4.0, 2.0),
        ],
        "crossover": [
            _crossover("aneurism", (1.0, 5.0, 20.0, 8.0), Reach(9.0, "interpolated", 0.5)),
            _crossover("female", (1.0, 5.0, 20.0, 8.0), Reach(None, "not reached", 1.1)),
            _crossover("heptane", (1.0, 5.0, 20.0, 8.0), Reach(1.0, "at most", 0.5)),
        ],
        "oracles": [{
            "scene": "heptane", "plain": {"time": _time(0.1), "samples": 10, "from_fine": 1e-3},
            "rows": [{"oracle": "minimum", "epsilon": None, "samples": 1, "counters": _COUNTERS,
                      "time": _time(0.1), "prepare": 0.25, "from_minimum": 0.0, "from_fine": 1e-3}],
        }],
        "blocks": [{
            "scene": "heptane", "ratio": 11.0, "blocks": {"reduction": 11.2},
            "rows": dict.fromkeys(
                ("full", "pyramid"),
                {"time": _time(0.1), "faster": 2.0, "samples": 5, "ssim": 0.9, "delta_e": 0.1},
            ),
        }],
        "sizes": [[{
            "scene": "heptane", "size": 2048, "oversampling": 2, "faster": _RATIO, "rmse": 1e-3,
            "plain": {"time": _time(0.1), "samples": 10},
            "pyramid": {"time": _time(0.1), "samples": 5},
        }]],
    }  # fmt: skip


def test_every_goal_is_judged_by_what_was_reached():
    met = [(verdict.reached, verdict.goal, verdict.is_met) for verdict in verdicts(_result())]
    assert met == [
        (60.0, 56.0, True), (3.0, 3.4, False), (0.99, 0.985, True), (0.5, 1.0, True),
        (1.2, 1.3, True),
        (4.0, 4.7, False), (2.0, 1.8, True), (0.99, 0.985, True), (0.5, 1.0, True),
        (1.2, 1.3, True),
    ]  # fmt: skip


def test_goals_of_errors_and_of_the_overhead_may_be_missed():
    result = _result()
    row = result["paper"][1]
    row["ways"][BEST] |= {"ssim": 0.98, "delta_e": 1.1}
    row["overhead"] = {**_RATIO, "ratio": 1.4}
    assert [verdict.is_met for verdict in verdicts(result)[:5]] == [True, *4 * [False]]


# All of it


@pytest.mark.slow
def test_a_quick_run_measures_shows_and_draws(device, shared_volume, monkeypatch, tmp_path):
    for name in ("aneurism.nrrd", "heptane.nrrd"):
        shared_volume(name)
    monkeypatch.setattr("bench.options.RESULTS", tmp_path)
    monkeypatch.setattr(bench, "QUICK_SIZE", 32)
    monkeypatch.setattr(bench, "QUICK_EDGE", 80)
    monkeypatch.setattr(bench, "QUICK_ROUNDS", 1)
    monkeypatch.setattr(bench, "CROSSOVER", (HEPTANE,))
    monkeypatch.setattr(bench, "ORACLES", (ANEURISM,))
    _every_fourth_voxel(monkeypatch)
    options = Options(quick=True, scenes=("aneurism", "heptane"))
    result = bench.run(options)
    json.dumps(result)
    assert not result["failed"] and not result["missing"]
    assert [row["scene"] for row in result["paper"]] == [
        "aneurism", "aneurism 80^3", "aneurism 80^3, steps x 0.5"
    ]  # fmt: skip
    assert all(row["ways"][row["best"]]["fewer"] > 1 for row in result["paper"])
    assert [part["scene"] for part in result["crossover"]] == ["heptane"]
    assert [row["level"] for row in result["crossover"][0]["rows"]] == [0, 4, "cubic"]
    assert [part["scene"] for part in result["oracles"]] == ["aneurism"]
    assert [row["size"] for row in result["sizes"][0]] == [48, 96]
    (part,) = result["blocks"]
    assert part["scene"] == "heptane" and list(part["rows"]) == ["full", "limited", "naive", "pyramid"]
    assert part["rows"]["pyramid"]["samples"] < part["rows"]["full"]["samples"]
    assert "no figure of it is a result" in show(result)
    drawn = bench.draw(result, options)
    assert [path.name for path in drawn] == ["pyramid-crossover.png", "pyramid.png"]
    assert all(path.parent == options.folder and path.exists() for path in drawn)


def _every_fourth_voxel(monkeypatch) -> None:
    from clvol import Volume

    whole = BenchScene.load

    def load(scene, *arguments):
        found = whole(scene, *arguments)
        spacing = tuple(4 * s for s in found.grid.spacing)
        return Volume(np.ascontiguousarray(found.data[::4, ::4, ::4]), spacing=spacing)

    monkeypatch.setattr(BenchScene, "load", load)


def test_without_volumes_nothing_is_measured(monkeypatch, tmp_path):
    monkeypatch.setattr(BenchScene, "path", lambda scene: tmp_path / scene.file)
    missing: list[str] = []
    assert bench.there(PYRAMID_SCENES, Options(), missing) == []
    assert missing == [scene.name for scene in PYRAMID_SCENES]
    assert all(not cases for cases in bench._cases(None, [], quick=True).values())


# What the paper claims


def test_synthesis_keeps_what_is_linear_and_is_bilinear_at_one_level():
    y, x = np.mgrid[0:32, 0:32].astype(float)
    random = np.random.default_rng(5).normal(size=(32, 32))
    for grow in (_subdivided, _bilinear):
        for level in (1, 2, 3):
            made = grow(_coarse(2.0 * x - 3.0 * y, level), level)
            inner = slice(2 << level, -(2 << level))
            np.testing.assert_allclose(made[inner, inner], (2.0 * x - 3.0 * y)[inner, inner], atol=1e-9)
    np.testing.assert_allclose(_subdivided(_coarse(random, 1), 1), _bilinear(_coarse(random, 1), 1), atol=1e-12)


def test_bilinear_pieces_bend_where_they_meet():
    random = np.random.default_rng(5).normal(size=(64, 64))
    made = {grow: np.repeat(grow(_coarse(random, 3), 3)[..., None], 4, 2) for grow in (_subdivided, _bilinear)}
    assert _kinks(made[_subdivided], 3) < 2.0 < _kinks(made[_bilinear], 3)
