"""python -m bench compare: what became slower or less exact, from files that quick runs wrote."""

from __future__ import annotations

import copy
import json

import pytest

from bench.__main__ import main as bench
from bench.compare import compare, figures, report


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict[str, dict]:
    """Results of the suites that take seconds, as a quick run writes them."""
    from bench import convergence, options, scaling

    folder = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(options, "RESULTS", folder)
        quick = options.Options(quick=True)
        for name, module in {"scaling": scaling, "convergence": convergence}.items():
            from bench.report import save

            save(quick.folder, name, module.run(quick))
    results = {path.stem: json.loads(path.read_text()) for path in (folder / "quick").glob("*.json")}
    for row in (*results["scaling"]["volume"], *results["scaling"]["image"]):
        row["time"]["spread"] = 0.1  # the machine may be busy with other things
    return results


def test_a_result_beside_itself_has_no_changes(results):
    for name, result in results.items():
        assert compare(result, result) == [], name
        text, fine = report(result, result)
        assert fine and " 0 worse, 0 better" in text


def test_every_figure_has_a_name_of_its_own(results):
    for result in results.values():
        names = [name for name, _ in figures(result)]
        assert names and len(set(names)) == len(names)


def test_slower_beyond_the_spread_and_within_it(results):
    old = results["scaling"]
    times = {name: figure for name, figure in figures(old) if figure.kind == "time"}
    name = next(iter(times))
    new = copy.deepcopy(old)
    time = new["volume"][0]["time"]
    assert name == f"volume/edge {new['volume'][0]['edge']}/time"
    time["median"] *= 1 + 3 * time["spread"]
    (change,) = compare(old, new)
    assert (change.where, change.verdict) == (name, "slower") and change.is_worse
    (back,) = compare(new, old)
    assert back.verdict == "faster" and not back.is_worse
    text, fine = report(old, new)
    assert not fine and text.splitlines()[-2].startswith(f"slower      {name}: ")
    time["median"] = old["volume"][0]["time"]["median"] * (1 + 0.4 * time["spread"])
    assert compare(old, new) == []


def test_less_exact_by_a_hundredth(results):
    old = results["convergence"]
    new = copy.deepcopy(old)
    new["rows"][0]["errors"][2] *= 1.02
    (change,) = compare(old, new)
    assert change.verdict == "less exact" and change.where.endswith("errors/2")
    new["rows"][0]["errors"][2] = old["rows"][0]["errors"][2] * 1.005
    assert compare(old, new) == []


def test_more_samples_and_more_memory(results):
    new = copy.deepcopy(results["scaling"])
    new["image"][1]["samples"] = int(1.01 * new["image"][1]["samples"])
    assert [change.verdict for change in compare(results["scaling"], new)] == ["more work"]
    old = {"cases": [{"name": "clvol --help", "peak_bytes": 17371136}]}
    new = {"cases": [{"name": "clvol --help", "peak_bytes": 2 * 17371136}]}
    assert [change.verdict for change in compare(old, new)] == ["more memory"]


def test_rows_are_matched_by_name_and_not_by_place(results):
    old = results["scaling"]
    new = copy.deepcopy(old)
    new["volume"].reverse()
    assert compare(old, new) == []
    del new["volume"][0]
    assert compare(old, new) == []  # what only one of them has is not compared


def test_claims_that_no_longer_hold():
    row = {"scene": "a", "max_error": 0.01, "holds": True, "ssim": 0.99}
    changes = compare({"rows": [row]}, {"rows": [{**row, "holds": False, "ssim": 0.98}]})
    assert [change.verdict for change in changes] == ["fails", "less exact"]


def test_the_command(results, tmp_path, capsys):
    old, new = results["scaling"], copy.deepcopy(results["scaling"])
    for row in new["volume"]:
        row["time"]["median"] *= 10
    new["machine"]["processor"] = "another"
    for name, result in (("old", old), ("new", new)):
        (tmp_path / f"{name}.json").write_text(json.dumps(result))
    paths = [str(tmp_path / "old.json"), str(tmp_path / "new.json")]
    assert bench(["compare", *paths]) == 1
    out = capsys.readouterr().out
    assert out.count("slower ") == len(old["volume"]) and "the processor differs" in out
    assert bench(["compare", paths[0], paths[0]]) == 0
    assert bench(["compare", paths[0]]) == 2
    assert bench(["compare", paths[0], str(tmp_path / "none.json")]) == 2
    (tmp_path / "other.json").write_text("{}")
    assert bench(["compare", paths[0], str(tmp_path / "other.json")]) == 2
    assert report(results["convergence"], results["scaling"])[1] is False  # nothing in common
