"""What the bench of the method "multiresolution" is made of: its scenes, its arithmetic, its generator."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from bench import multiresolution as bench
from bench.multiresolution_large import Turbulence, _scene
from bench.multiresolution_paper import octree_levels
from bench.multiresolution_parts import (
    HIGHEST,
    Bench,
    KnownBlocks,
    alike,
    budget,
    highest_within,
    stepping_row,
)
from bench.multiresolution_pictures import COLORS, level_tables, level_volume
from bench.multiresolution_scenes import BLOCK_SCENES, FEMALE, placed_as_in_bench
from bench.multiresolution_tables import Verdict, over_bound, show, verdicts
from bench.options import Options
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED

SHAPE = (20, 24, 40)  # not a multiple of a block's edge


@pytest.fixture(scope="module")
def volume():
    from clvol import Volume

    random = np.random.default_rng(3)
    data = random.integers(0, 3000, SHAPE).astype(np.uint16)
    data[:, :, :16] = 0
    return Volume(data, spacing=(1.0, 0.5, 2.0), name="random")


# Scenes


@pytest.mark.parametrize("scene", BLOCK_SCENES, ids=lambda scene: scene.name)
def test_scenes_of_blocks_and_of_all_voxels_differ_in_the_method_alone(scene, volume):
    blocks, plain = scene.asked(volume, 32, 12345).resolve(), scene.plain(volume, 32).resolve()
    assert blocks.integration.method == "multiresolution"
    assert blocks.multiresolution.memory_bytes == 12345
    assert plain.integration == blocks.integration.model_copy(update={"method": "raycast"})
    assert plain.camera == blocks.camera
    assert plain.transfer_function.values.tolist() == blocks.transfer_function.values.tolist()


def test_settings_reach_the_table_multiresolution(volume):
    asked = FEMALE.asked(volume, 32, 1 << 20, view_weighting=False, tiles=16).resolve()
    assert not asked.multiresolution.view_weighting and asked.multiresolution.tiles == 16


def test_scenes_of_the_rest_of_the_bench_are_seen_as_there(volume):
    from bench.scenes import camera

    there, here = camera(volume), placed_as_in_bench("aneurism").camera(volume)
    for name in ("position", "target", "up"):
        assert getattr(here, name) == pytest.approx(getattr(there, name))


def test_only_scenes_with_a_volume_are_measured(monkeypatch, tmp_path):
    monkeypatch.setattr("bench.scenes.VOLUMES", tmp_path)
    monkeypatch.setattr(
        "bench.scenes.BenchScene.path", lambda scene, folder=tmp_path: folder / scene.file
    )
    (tmp_path / "chest.nrrd").touch()
    missing: list[str] = []
    found = bench.there(BLOCK_SCENES, Options(), missing)
    assert [scene.name for scene in found] == ["female", "chest"] and missing == ["crab"]
    assert [scene.name for scene in bench.there(BLOCK_SCENES, Options(scenes=("chest",)), [])] == [
        "chest"
    ]


def test_a_written_scene_is_the_scene(volume, tmp_path):
    from clvol import load_scene

    np.save(tmp_path / "volume.npy", volume.data)
    path = tmp_path / "scene.toml"
    path.write_text(
        bench.scene_text(FEMALE, tmp_path / "volume.npy", "multiresolution", 48), encoding="utf-8"
    )
    read, made = load_scene(path).resolve(), FEMALE.asked(volume, 48, bench.MEMORY).resolve()
    assert read.multiresolution == made.multiresolution
    assert read.integration == made.integration
    function, expected = read.transfer_function, made.transfer_function
    assert function.values.tolist() == expected.values.tolist()
    assert function.colors.tolist() == expected.colors.tolist()
    assert function.opacities.tolist() == expected.opacities.tolist()


def test_statistics_are_found_once(volume):
    known = KnownBlocks(volume)
    first = list(known.statistics())
    assert all(a is b for a, b in zip(first, known.statistics(), strict=True))


# Arithmetic


@pytest.mark.parametrize("goal", (0.0, 0.2, 0.37, 2.0))
def test_highest_within_is_the_highest_that_keeps_the_goal(goal):
    found = highest_within(lambda high: high**2, goal)
    steps = np.arange(0.15, HIGHEST + 0.01, 0.05)
    kept = steps[steps**2 <= goal]
    assert found == pytest.approx(kept.max() if len(kept) else steps.min())


def _frame(samples: int, level: float):
    return SimpleNamespace(
        samples=samples, counters={}, rgba=np.full((16, 16, 4), level, np.float32)
    )


def test_steps_are_told_over_even_ones():
    frames = {"full": _frame(900, 0.5), "limited": _frame(300, 0.5), "naive": _frame(100, 0.1)}
    times = {"full": {"median": 3.0}, "limited": {"median": 1.0}, "naive": {"median": 0.5}}
    rows = {name: stepping_row(name, frames, times) for name in frames}
    assert [rows[name]["faster"] for name in frames] == [1.0, 3.0, 6.0]
    assert [rows[name]["samples_ratio"] for name in frames] == [1.0, 3.0, 9.0]
    assert rows["limited"]["ssim"] == pytest.approx(1.0) and rows["limited"]["delta_e"] == 0.0
    assert rows["naive"]["ssim"] < 0.9 and rows["naive"]["delta_e"] > 5.0


def test_a_picture_is_like_itself_as_it_is_like_a_copy():
    picture = np.random.default_rng(5).random((20, 20, 4)).astype(np.float32)
    assert alike(picture, picture) == pytest.approx(alike(picture, picture.copy()))


def test_error_over_the_bound():
    assert over_bound({"error": 1.1, "bound": 1.0}) == pytest.approx(0.1)
    assert over_bound({"error": 0.0, "bound": 0.0}) == 0.0


def test_verdicts_know_both_sides():
    assert Verdict("speed", 2.8, 2.8).is_met and not Verdict("speed", 2.7, 2.8).is_met
    assert Verdict("time", 1.5, 1.5, True).is_met and not Verdict("time", 1.6, 1.5, True).is_met
    assert "NOT met" in str(Verdict("time", 1.6, 1.5, True))


# Pictures of levels


def test_levels_are_coloured_where_their_blocks_are(volume):
    grid = BlockGrid(SHAPE, 16)
    levels = np.arange(grid.count).astype(np.uint8) % grid.levels
    levels[3] = DROPPED
    shown = level_volume(levels, grid, volume)
    matrix = np.linalg.inv(shown.grid.index_to_world())
    for block, (z, y, x) in enumerate(grid.places(np.arange(grid.count))):
        expected = 0 if levels[block] == DROPPED else levels[block] + 1
        first = np.array([x, y, z]) * 16.0
        for corner in (first - 0.49, np.minimum(first + 15.49, np.array(SHAPE[::-1]) - 1)):
            world = volume.grid.index_to_world() @ [*corner, 1.0]
            place = matrix @ world
            assert (place >= 0).all() and (place[:3] <= np.array(shown.grid.size) - 1).all()
            i, j, k = np.rint(place[:3]).astype(int)
            assert shown.data[k, j, i] == expected


def test_every_level_has_a_colour_of_its_own(volume):
    grid = BlockGrid(SHAPE, 32)
    tables = level_tables(np.zeros(grid.count, np.uint8), grid, volume)
    labels = tables["field"][0]["labels"]
    assert [entry["label"] for entry in labels] == list(range(1, grid.levels + 1))
    assert len({tuple(entry["color"]) for entry in labels}) == grid.levels <= len(COLORS)
    assert FEMALE.plain(volume, 16, tables).resolve().fields[0].role == "label"


# The generator


def test_a_box_of_turbulence_is_a_part_of_the_whole():
    source = Turbulence(48)
    whole = source.box(0, 48, 0, 48, 0, 48)
    part = source.box(5, 9, 17, 40, 30, 48)
    difference = whole[5:9, 17:40, 30:48].astype(int) - part
    assert np.abs(difference).max() <= 1  # rounding of a product of matrices of other shapes


def test_turbulence_is_the_sum_of_its_waves():
    source = Turbulence(64)
    found = source.box(30, 32, 20, 22, 40, 43).astype(float)
    for (k, j, i), value in np.ndenumerate(found):
        x, y, z = i + 40, j + 20, k + 30
        angles = source._waves @ [x, y, z] + source._phases
        hill = sum(((c - 31.5) / (0.47 * 64)) ** 2 for c in (x, y, z))
        exact = np.clip(168 - 130 * hill + source._amplitudes @ np.cos(angles), 0, 255)
        assert value == pytest.approx(exact, abs=0.51)


def test_turbulence_has_empty_corners_and_structure_at_all_scales():
    whole = Turbulence(96).box(0, 96, 0, 96, 0, 96).astype(float)
    corners = whole[::95, ::95, ::95]
    assert corners.max() < 112  # where the scene's function begins
    for step in (1, 4, 16):
        inner = whole[24:72:step, 24:72:step, 24:72:step]
        assert np.abs(np.diff(inner, axis=0)).mean() > 1.0


def test_the_scene_of_the_large_volume_resolves(tmp_path):
    from clvol import load_scene
    from clvol.store.build import build_store

    build_store(Turbulence(32), tmp_path / "small.zarr")
    path = tmp_path / "scene.toml"
    path.write_text(_scene(tmp_path / "small.zarr", 32, 24), encoding="utf-8")
    resolved = load_scene(path).resolve()
    assert resolved.integration.method == "multiresolution"
    assert resolved.multiresolution.memory_bytes == 256 * 2**20
    assert (resolved.image.width, resolved.image.height) == (24, 24)


# Memory


@pytest.mark.slow
def test_what_is_said_to_be_on_the_device_is_among_its_buffers(volume, device, tmp_path):
    shared = Bench(device, 24, 1, tmp_path)
    post = dataclasses.replace(FEMALE.scene, classification="post")  # its tables are small
    shared._volumes[post.file] = volume
    row = budget(shared, dataclasses.replace(FEMALE, scene=post), volume.nbytes // 2 + 2**20)
    assert 0 < row["blocks"]["bytes_of_samples"] < row["on_device"] <= row["all_buffers"]
    assert row["all_buffers"] <= row["on_device"] + 2 * row["picture"] + 2**20
    assert row["memory"] == volume.nbytes // 2 + 2**20 and row["delta_e"] >= 0.0


# What is said


def _time(median: float) -> dict:
    return {"median": median, "min": median, "max": median, "spread": 0.02, "frames": 7}


def _result() -> dict:
    blocks = {"levels": [5, 4, 3, 2, 1], "dropped": 9, "bytes_of_samples": 2**20}
    even = {"time": _time(1.0), "faster": 1.0, "samples": 9e6, "samples_ratio": 1.0, "ssim": 1.0,
            "delta_e": 0.0}  # fmt: skip
    limited = {**even, "time": _time(0.5), "faster": 2.0, "ssim": 0.99}
    ratio = {"ratio": 1.2, "low": 1.1, "high": 1.3}
    kept = {**ratio, "seconds": 0.6, "samples": 1e6, "bytes": 2**20, "ssim": 1.0, "delta_e": 0.0}
    tile = {"tiles": 16, "priority": "max", "tile_high": 0.8, "share": 0.36, "time": _time(0.2),
            "faster": 2.5, "ssim": 0.97}  # fmt: skip
    return {
        "size": 64, "seconds": 1.0, "load_before": None, "load_after": None, "quick": True,
        "missing": ["crab"], "failed": ["tiles: no"],
        "stepping": [{"scene": "female", "ratio": 8.0, "as_in_paper": True, "step": 0.5, "goal": 2.8,
                      "classification": "post",
                      "blocks": blocks, "steppings": {"full": even, "limited": limited}}],
        "interblock": [[{"scene": "female", "stepping": "full", "seconds": 1.2, "without": 1.0,
                         "samples": 1, **ratio}]],
        "tiles": [{"scene": "female", "ratio": 8.0, "all": _time(0.5), "covered": 0.5,
                   "rows": [{**tile, "faster": 9.0, "is_goal": False}, {**tile, "is_goal": True}]}],
        "budget": [{"scene": "female", "memory": 2**24, "ratio": 8.6, "ssim": 0.9, "delta_e": 0.7,
                    "blocks": blocks, "on_device": 2**24 + 2**22, "all_buffers": 2**25,
                    "picture": 2**24}],
        "resident": [{"scene": "aneurism", "seconds": 0.5, "samples": 1e6,
                      "rows": {"all": kept, "shown": kept, "selected": kept}}],
        "selection": [{"scene": "female", "memory": 2**24, "by_view": True, "blocks": 24,
                       "error": 1.1, "bound": 1.0, "errors_seconds": 0.1, "seconds": 0.1}],
        "change": [{"scene": "female", "other": "chest", "memory": 2**24, "size": 32,
                    "asked_seconds": 0.1, "seconds": 0.2, "changed": 3, "blocks": 24, "read_blocks": 2,
                    "read_bytes": 2**20, "all_bytes": 2**22, "idle": _time(0.1), "frames": None}],
        "host": [{"scene": "female", "volume_bytes": 2**27,
                  "blocks": {"peak_bytes": 3e8, "seconds": 1.0}, "whole": None}],
    }  # fmt: skip


def test_every_goal_is_judged_by_what_was_reached():
    met = [(verdict.reached, verdict.goal, verdict.is_met) for verdict in verdicts(_result())]
    assert met == [
        (2.0, 2.8, False), (0.99, 0.98, True),  # steps
        (1.2, 1.6, True),  # between blocks
        (2.5, 2.0, True), (0.97, 0.98, False),  # tiles: the goal's row, not the quickest
        (0.7, 1.0, True), (1.25, 1.1, False), (1.0, 1.1, True),  # budget, without tables and with
        (1.2, 1.5, True), (1.2, 1.0, False),  # resident
    ]  # fmt: skip


def test_the_large_volume_is_told_and_judged():
    child = {"peak_bytes": 3 * 2**30, "seconds": 80.0}
    large = {
        "edge": 2048, "voxel_bytes": 2048**3, "disk_bytes": 7e9, "memory": "256 MiB", "built": child,
        "rendered": {**child, "peak_bytes": 2**30},
        "stats": {"seconds": {"render": 1.5}, "blocks": {"levels": [1, 2], "dropped": 3}},
    }  # fmt: skip
    result = _result() | {"large": large}
    assert [verdict.is_met for verdict in verdicts(result)[-2:]] == [False, True]
    assert "107 MB/s" in show(result)


# An octree in the same bytes


def test_nodes_of_an_octree_stay_within_the_bytes_and_have_one_level():
    random = np.random.default_rng(2)
    counts, cost = (5, 6, 9), np.array([4096, 512, 64, 8, 0])
    errors = np.cumsum(random.random((5, 270)).astype(np.float32), axis=0)
    errors -= errors[0]
    dropped = random.random(270) < 0.3
    for spare in (0, 10_000, 200_000, 10**9):
        levels, spent = octree_levels(errors, dropped, cost, counts, spare)
        assert spent <= spare
        shaped = levels.reshape(counts)
        for at in np.ndindex(*counts):
            level = shaped[at]
            if level != DROPPED:  # all of its node
                own = shaped[tuple(slice(k >> level << level, ((k >> level) + 1) << level) for k in at)]
                assert (own == level).all()
        assert not (levels[~dropped] == DROPPED).any()
    assert (levels[~dropped] == 0).all()
    assert (octree_levels(errors, np.ones(270, bool), cost, counts, 10**9)[0] == DROPPED).all()
