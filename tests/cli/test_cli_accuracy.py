"""clvol render --max-error and --time-budget, clvol tradeoff: as a new user would call them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from clvol.image import load_image


@pytest.mark.slow
def test_an_error_is_held_told_and_kept_with_the_picture(run, folder, device):
    outcome = run("render", "scene.toml", "-o", "a.exr", "--stats", "s.json", "--max-error", "1e-3")
    assert outcome.status == 0 and outcome.out.split() == ["a.exr", "s.json"]
    assert outcome.err.startswith("RMSE ") and "step" in outcome.err and outcome.err.count("\n") == 1
    found = json.loads((folder / "s.json").read_text())["accuracy"]
    assert found["max_error"] == 1e-3 and found["rmse"] <= found["bound"] <= 1e-3
    header = load_image("a.exr")["header"]
    assert float(header["error_bound"]) == pytest.approx(found["bound"])
    assert float(header["error_rmse"]) == pytest.approx(found["rmse"])
    assert header["stats"]["accuracy"]["settings"] == found["settings"]

    assert run("render", "scene.toml", "-o", "exact.npy", "--set",
               'integration.method="reference"').status == 0  # fmt: skip
    measured = json.loads(run("compare", "a.exr", "exact.npy", "--json").out)
    assert measured["rmse"] <= 1e-3


@pytest.mark.slow
def test_a_time_is_held_and_quiet_says_nothing(run, folder, device):
    outcome = run("render", "scene.toml", "-o", "a.npy", "--stats", "s.json", "--time-budget", "0.5",
                  "--quiet")  # fmt: skip
    assert (outcome.status, outcome.err) == (0, "")
    stats = json.loads((folder / "s.json").read_text())
    assert stats["seconds"]["render"] <= 0.5 and stats["accuracy"]["time_budget"] == 0.5
    assert np.load("a.npy").shape == (6, 8, 4)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--max-error", "0"], "--max-error: got 0.0, expected a number from 1e-10 to 1"),
        (["--max-error", "nan"], "--max-error: got nan, expected a number from 1e-10 to 1"),
        (["--max-error", "2"], "--max-error: got 2.0, expected a number from 1e-10 to 1"),
        (["--max-error", "x"], "clvol render: --max-error: 'x' is not a valid float"),
        (["--time-budget", "-1"], "--time-budget: got -1.0, expected seconds, more than 0"),
        (["--time-budget", "inf"], "--time-budget: got inf, expected seconds, more than 0"),
        (["--max-error", "1e-2", "--time-budget", "1"],
         "--time-budget: given together with --max-error, expected one of the two"),
        (["--pixel-area"], "--pixel-area: given without a target, expected --max-error or --time-budget with it"),
    ],
)  # fmt: skip
def test_impossible_targets_are_one_line(refused, folder, nothing_left, arguments, said):
    assert refused(2, "render", "scene.toml", "-o", "a.npy", *arguments).startswith(said)


@pytest.mark.slow
def test_a_time_too_short_says_what_is_possible(refused, folder, nothing_left, device):
    said = refused(2, "render", "scene.toml", "-o", "a.npy", "--time-budget", "1e-9")
    assert said.startswith("--time-budget: got 1e-09 s, expected at least ")


def test_tradeoff_writes_a_page_and_says_what_to_use(run, folder, device):
    outcome = run("tradeoff", "scene.toml", "-o", "out", "--settings", "6", "--frames", "1",
                  "--set", "integration.table_size=32")  # fmt: skip
    assert outcome.status == 0
    lines = outcome.out.splitlines()
    assert lines[-1] == "out/index.html"
    assert all(line.startswith("for error below ") and line.endswith(" s") for line in lines[:-1])
    assert {p.name for p in (folder / "out").iterdir()} >= {
        "index.html", "tradeoff.json", "tradeoff.png", "images"
    }  # fmt: skip
    result = json.loads((folder / "out" / "tradeoff.json").read_text())
    assert len(result["points"]) == 6
    assert [s["text"] for s in result["sentences"]] == lines[:-1]
    # Again into the same folder: what is there is replaced.
    assert run("tradeoff", "scene.toml", "-o", "out", "--settings", "2", "--frames", "1").status == 0
    assert len(json.loads((folder / "out" / "tradeoff.json").read_text())["points"]) == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["scene.toml"], "clvol tradeoff: no -o DIR, expected -o DIR"),
        (["scene.toml", "-o", "cube.npy"], "cube.npy: is a file, expected a folder"),
        (["scene.toml", "-o", "no/where"], 'no/where: the folder "'),
        (["scene.toml", "-o", "out", "--frames", "0"], "clvol tradeoff: --frames: 0 is not in the range"),
        (["scene.toml", "-o", "out", "--settings", "0"], "clvol tradeoff: --settings: 0 is not in the range"),
        (["missing.toml", "-o", "out"], "missing.toml"),
        (["scene.toml", "-o", "out", "--set", 'integration.tolerance=2'], "scene.toml: integr"),
    ],
)
def test_wrong_input_to_tradeoff_is_one_line(refused, folder, nothing_left, arguments, said):
    assert refused(2, "tradeoff", *arguments).startswith(said)
