"""The sweep: what it tries, what it claims, and that its front is one."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, rms, waves

from clvol import Camera, Scene, Volume
from clvol.accuracy.report import write_report
from clvol.accuracy.settings import scene_tunables
from clvol.accuracy.tradeoff import measure_tradeoff, sentences
from clvol.errors import SceneError, UsageError
from clvol.integrators.reference.picture import render_reference
from clvol.scene import ImageSettings, Integration
from clvol.scene.multiresolution import Multiresolution
from clvol.scene.sizes import parse_size


def scene_of(array=None, **integration) -> Scene:
    return Scene(
        volume=Volume(waves((14, 15, 16), np.uint8) if array is None else array),
        transfer_function=SMOOTH, camera=Camera(), image=ImageSettings(width=48, height=40),
        integration=Integration(**integration),
    )  # fmt: skip


@pytest.fixture(scope="module")
def swept(device):
    # As many settings as show the tunables of pictures too; on tables that are quickly made.
    return measure_tradeoff(
        scene_of(table_size=64, classification="preintegrated"), devices=[device], frames=3, settings=70
    )


@pytest.mark.slow
def test_every_tunable_of_the_scene_is_tried_and_none_is_listed_in_the_sweep(swept):
    result, _ = swept
    varied = {key for point in result["points"] for key in point["changed"]}
    tunables = {tunable["name"] for tunable in result["knobs"]}
    assert "integration.step" in varied and varied <= tunables
    # What has an effect only beside others may not have come to its turn.
    beside = {"tile_high", "step_error"}
    single = {"image.ray_tolerance", "integration.step_error"}
    assert tunables - varied <= {*single, *(f"multiresolution.{key}" for key in beside)}


def test_errors_are_those_of_the_pictures(swept, device):
    result, pictures = swept
    exact = render_reference(scene_of(table_size=64).resolve(), device)[0]
    assert rms(pictures["reference"], exact) < 1e-6
    points = {point["id"]: point for point in result["points"]}
    assert result["front"]  # how many are on it the clock decides
    for name in (*result["front"], result["baseline"]):
        assert points[name]["rmse"] == pytest.approx(rms(pictures[name], exact), rel=1e-4)
        assert points[name]["seconds"]["frames"] == 3 and points[name]["psnr"] > 0


def test_nothing_beats_the_front(swept):
    result, _ = swept
    points = {point["id"]: point for point in result["points"]}
    front = [points[name] for name in result["front"]]
    assert [p["rmse"] for p in front] == sorted((p["rmse"] for p in front), reverse=True)
    times = [p["seconds"]["median"] for p in front]
    assert times == sorted(times)
    assert all(p["on_front"] == (p["id"] in result["front"]) for p in result["points"])
    timed = [p for p in result["points"] if p["seconds"]["frames"] == 3]
    for point in front:
        for other in timed:  # by more than what is called the same
            assert not (
                other["rmse"] < 0.9 * point["rmse"]
                and other["seconds"]["median"] < 0.5 * point["seconds"]["median"]
            )


def test_points_are_all_different_and_the_scene_s_own_is_among_them(swept):
    result, _ = swept
    keys = [json.dumps(point["settings"], sort_keys=True) for point in result["points"]]
    assert len(set(keys)) == len(keys) <= 70
    ids = [point["id"] for point in result["points"]]
    assert len(set(ids)) == len(ids) and result["baseline"] in ids
    own = next(p for p in result["points"] if p["id"] == result["baseline"])
    assert own["changed"] == [] and own["label"] == "preintegrated, step 1"


def test_what_makes_the_same_picture_is_not_tried_twice(swept):
    result, _ = swept
    for point in result["points"]:
        settings = point["settings"]
        if settings["image.ray_spacing"] == 1:
            assert settings["image.ray_tolerance"] == 0.01


def test_less_is_done_where_it_is_cheaper(swept):
    result, _ = swept
    steps = [
        p for p in result["points"]
        if set(p["changed"]) <= {"integration.step"} and p["settings"]["integration.step"] <= 1
    ]  # fmt: skip
    steps.sort(key=lambda p: p["settings"]["integration.step"])
    assert len(steps) >= 4
    assert [p["samples"] for p in steps] == sorted((p["samples"] for p in steps), reverse=True)


def test_the_report_can_be_written_of_it(swept, tmp_path):
    result, pictures = swept
    paths = write_report(result, pictures, tmp_path / "out")
    assert {path.name for path in paths} >= {"index.html", "tradeoff.json", "tradeoff.png"}
    read = json.loads((tmp_path / "out" / "tradeoff.json").read_text())
    assert read["front"] == result["front"] and read["version"] == 1
    for sentence in result["sentences"]:
        assert sentence["point"] in result["front"]


def test_sentences_name_the_cheapest_point_that_holds():
    front = [
        {"id": "a", "label": "A", "rmse": 2e-2, "seconds": {"median": 0.001}},
        {"id": "b", "label": "B", "rmse": 2e-3, "seconds": {"median": 0.01}},
        {"id": "c", "label": "C", "rmse": 0.0, "seconds": {"median": 0.1}},
    ]
    told = sentences(front)
    assert [(s["point"], s["error"]) for s in told] == [("a", 3e-2), ("b", 3e-3), ("c", 1e-6)]
    assert told[1]["text"] == "for error below 0.003, use B: 0.01 s"
    assert sentences([]) == []


@pytest.mark.parametrize("wrong", [{"frames": 0}, {"settings": 0}])
def test_wrong_numbers_are_refused(wrong):
    with pytest.raises(UsageError, match="got 0"):
        measure_tradeoff(scene_of(), **wrong)


def test_what_cannot_be_rendered_is_refused():
    with pytest.raises(SceneError, match="integration.filter"):
        measure_tradeoff(scene_of(method="pyramid", filter="nearest"))


def test_one_setting_is_enough_and_a_blank_scene_no_trouble(device, tmp_path):
    from clvol import TransferFunction

    clear = TransferFunction([0.0, 255.0], [0.0, 0.0], [[1, 1, 1]] * 2)
    scene = scene_of().model_copy(update={"transfer_function": clear})
    result, pictures = measure_tradeoff(scene, devices=[device], frames=1, settings=1)
    assert len(result["points"]) == 1 and result["front"] == [result["baseline"]]
    assert result["points"][0]["rmse"] == 0.0
    write_report(result, pictures, tmp_path)


@pytest.fixture
def few_tunables(monkeypatch):
    """``few_tunables(*keys)``: the sweep has these alone."""
    from clvol.accuracy import tradeoff

    def keep(*keys):
        real = scene_tunables

        def found(resolved, area=False):
            return {key: tunable for key, tunable in real(resolved, area).items() if key in keys}

        monkeypatch.setattr(tradeoff, "scene_tunables", found)

    return keep


_MEMORY = "multiresolution.memory"


@pytest.mark.parametrize("method", ["raycast", "multiresolution"])
def test_budgets_are_tried_whichever_method_the_scene_has(device, few_tunables, method):
    """A larger budget is not further from the exact integral of the whole volume, but for noise."""
    few_tunables("integration.method", _MEMORY)
    same = {"classification": "preintegrated", "step_error": 0.0}  # blocks do not follow the data
    scene = scene_of(waves((40, 40, 40), np.uint8), table_size=64, method=method, **same)
    whole = Multiresolution(occlusion=False)  # what is hidden is there as well
    scene = scene.model_copy(update={"multiresolution": whole})
    result, _ = measure_tradeoff(scene, devices=[device], frames=1)
    points = [
        p for p in result["points"]
        if p["settings"]["integration.method"] == "multiresolution"
    ]  # fmt: skip
    points.sort(key=lambda p: parse_size(p["settings"][_MEMORY]))
    errors = [p["rmse"] for p in points]
    assert len(points) == 7 and len(result["points"]) == 7 + 2  # by rays, by a pyramid
    assert errors[0] > 3 * errors[-1]
    assert all(more <= 1.1 * less for less, more in zip(errors, errors[1:]))
    taken = [p["device_bytes"] for p in points]
    assert taken == sorted(taken)
    own = next(p for p in result["points"] if p["settings"]["integration.method"] == "raycast")
    assert errors[-1] == pytest.approx(own["rmse"], rel=0.1)


@pytest.mark.slow
def test_the_tunables_of_a_method_are_not_combined_with_all_others(
    device, few_tunables, monkeypatch
):
    """But for what the front suggests, which is left out here."""
    from clvol.accuracy.tradeoff import _Sweep
    from clvol.render.engines import close_engines

    monkeypatch.setattr(_Sweep, "front", lambda self: [])
    keys = "classification", "method"
    few_tunables(*(f"integration.{key}" for key in (*keys, "step")), "multiresolution.stepping")
    sweep = _Sweep(scene_of(table_size=64), [device], None, None)
    try:
        sweep.explore(100)
    finally:
        close_engines(sweep.engines)
    found = [trial.settings for trial in sweep.found.values()]
    pairs = {tuple(settings[f"integration.{key}"] for key in keys) for settings in found}
    assert len(pairs) == 3 + 2 + 1  # by rays, by blocks, by a pyramid
    ways = [settings["multiresolution.stepping"] for settings in found]
    assert {way: ways.count(way) for way in ways if way != "limited"} == {
        "naive": 1, "bounded": 1, "full": 1
    }  # fmt: skip
