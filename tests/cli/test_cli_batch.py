"""clvol batch: pictures that are rendered, kept, shared with other processes, or fail."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from clvol.batch.claims import Claims
from clvol.batch.results import results_in

JOB = """
scenes = ["scene.toml"]
output = "out/{view}_{step}.npy"
[[vary]]
key = "camera.view"
name = "view"
values = ["front", "left"]
[[vary]]
key = "integration.step"
name = "step"
values = [0.5, 1.0]
"""


@pytest.fixture
def batch(run, folder):
    """``batch(text, *options)``: outcome and results of ``clvol batch`` for a job of that text."""

    def call(text: str = JOB, *options: str):
        (folder / "job.toml").write_text(text, encoding="utf-8")
        outcome = run("batch", "job.toml", *options)
        return outcome, [json.loads(line) for line in outcome.out.splitlines()]

    return call


def test_pictures_are_those_of_render(batch, run, folder):
    outcome, results = batch()
    assert outcome.status == 0, outcome
    assert [each["status"] for each in results] == ["rendered"] * 4
    assert "4 rendered, 0 kept, 0 failed; see job.jsonl" in outcome.err
    assert [each["picture"] for each in results] == [0, 1, 2, 3] and all(each["samples"] > 0 for each in results)
    assert list(results_in("job.jsonl")) == results
    for each in results:
        settings = [part for key, value in each["set"].items() for part in ("--set", f"{key}={json.dumps(value)}")]
        assert run("render", "scene.toml", "-o", "one.npy", *settings).status == 0
        np.testing.assert_array_equal(np.load(each["files"][0]), np.load("one.npy"))
    assert not [path for path in os.listdir("out") if path.startswith(".")]


def test_a_finished_job_does_nothing(batch):
    batch()
    before = {path: os.stat(f"out/{path}").st_mtime_ns for path in os.listdir("out")}
    outcome, results = batch()
    assert outcome.status == 0 and not results and "0 rendered, 4 kept, 0 failed" in outcome.err
    assert before == {path: os.stat(f"out/{path}").st_mtime_ns for path in os.listdir("out")}


def test_what_is_missing_damaged_or_of_another_scene_is_rendered(batch, folder):
    batch()
    os.remove("out/front_0.5.npy")
    content = (folder / "out/left_1.npy").read_bytes()
    (folder / "out/left_1.npy").write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    _, results = batch()
    assert [each["picture"] for each in results] == [0, 3]
    _, results = batch(JOB + '[[vary]]\nkey = "image.width"\nvalues = [9]\n')
    assert len(results) == 4
    assert np.load("out/front_1.npy").shape[1] == 9


def test_one_failure_does_not_stop_the_others(batch):
    outcome, results = batch(JOB.replace('["front", "left"]', '["front", "nowhere", "left"]'))
    assert outcome.status == 2
    assert [each["status"] for each in results] == ["rendered"] * 2 + ["failed"] * 2 + ["rendered"] * 2
    assert "camera.view: got 'nowhere'" in results[2]["message"]
    assert outcome.err.count("clvol: error: ") == 2


def test_volumes_take_the_place_of_the_scene_s(batch, folder):
    np.save("other.npy", np.full((3, 4, 5), 200, np.uint8))
    text = 'scenes = ["scene.toml"]\nvolumes = ["cube.npy", "other.npy", "none.npy"]\n'
    text += 'output = "out/{scene}_{volume}.npy"\n'
    outcome, results = batch(text)
    assert [each["status"] for each in results] == ["rendered", "rendered", "failed"] and outcome.status == 2
    first, second = (np.load(each["files"][0]) for each in results[:2])
    assert not np.array_equal(first, second)


def test_volumes_alone(batch):
    size = 'set = { "image.width" = 9, "image.height" = 7 }\n'
    outcome, _ = batch('volumes = ["cube.npy"]\noutput = "{volume}.png"\n' + size)
    assert outcome.status == 0 and os.path.exists("cube.png")


def test_an_error_is_measured_where_that_is_requested(batch):
    text = JOB.replace("values = [0.5, 1.0]", "values = [1.0]") + "\n"
    text = "max_error = 0.01\n" + text
    outcome, results = batch(text)
    assert outcome.status == 0
    assert all(each["error"]["rmse"] <= each["error"]["bound"] <= 0.01 for each in results)
    outcome, results = batch(text)
    assert not results and "2 kept" in outcome.err
    outcome, results = batch(text.replace("0.01", "0.02"))
    assert len(results) == 2


def test_an_animation_is_refused_for_its_picture(batch):
    outcome, results = batch(JOB + '[[vary]]\nkey = "animation.frames"\nvalues = [3]\n')
    assert outcome.status == 2 and all("animation.frames: got 3" in each["message"] for each in results)


def test_a_dry_run_prints_names_and_makes_nothing(run, folder):
    (folder / "job.toml").write_text(JOB)
    outcome = run("batch", "job.toml", "--dry-run")
    assert outcome.out.splitlines() == [f"out/{v}_{s}.npy" for v in ("front", "left") for s in ("0.5", "1")]
    assert not os.path.exists("out") and not os.path.exists("job.jsonl")


@pytest.mark.parametrize(
    "text, told",
    [
        (JOB.replace(".npy", ".docx"), "unknown ending '.docx'"),
        (JOB.replace("out/{view}_{step}.npy", "scene.toml"), "would both be"),
        (JOB.replace("out/{view}_{step}.npy", "cube.npy/{view}_{step}.npy"), "cannot be made"),
        ("", "job.toml: output"),
    ],
)
def test_a_wrong_job_is_refused_before_the_work(batch, nothing_left, folder, text, told):
    outcome, results = batch(text)
    (folder / "job.toml").unlink()
    assert outcome.status == 2 and told in outcome.err and not results


def test_an_input_is_not_overwritten(batch, folder):
    outcome, results = batch('volumes = ["cube.npy"]\noutput = "{volume}.npy"\n')
    assert outcome.status == 2 and results[0]["status"] == "failed"
    assert np.load("cube.npy").dtype == np.uint8


def test_pictures_that_others_claim_are_left_to_them(batch, folder):
    batch()
    os.rename("out/left_1.npy", "kept")
    with Claims() as others:
        others.claim("out/left_1.npy")
        def finish() -> None:
            os.rename("kept", "out/left_1.npy")
            others.release("out/left_1.npy")

        timer = threading.Timer(0.6, finish)
        timer.start()
        outcome, results = batch()
        timer.join()
    assert outcome.status == 0 and not results and "4 kept" in outcome.err


def test_a_report_shows_pictures_and_failures(batch, folder):
    text = JOB.replace(".npy", ".png").replace('"left"', '"no<b>where"')
    outcome, _ = batch(text, "--report", "report.html")
    assert outcome.status == 2
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2 and page.count('class="failed"') == 2
    assert "4 pictures · 2 failed" in page and "<dt>step</dt><dd>0.5</dd>" in page
    assert 'href="out/front_0.5.png"' in page and "no<b>" not in page
    outcome, results = batch(text.replace('"no<b>where"', '"front-left"'), "--report", "report.html")
    assert len(results) == 2 and outcome.status == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 4 and "none failed" in page  # those that were kept, too


@pytest.mark.parametrize("name", ["report.txt", "none/report.html"])
def test_a_report_that_cannot_be_written(batch, name):
    outcome, results = batch(JOB, "--report", name)
    assert outcome.status == 2 and not results


@pytest.mark.slow  # processes that start and are killed, for about a minute
def test_processes_that_are_killed_lose_nothing_and_double_nothing(batch, folder):
    text = JOB.replace("values = [0.5, 1.0]", f"values = {[round(0.3 + 0.05 * k, 2) for k in range(10)]}")
    batch(text)  # so that kernels are compiled; and what it made is the expectation
    expected = {path: np.load(f"out/{path}") for path in os.listdir("out")}
    for path in os.listdir("out"):
        os.remove(f"out/{path}")
    os.remove("job.jsonl")
    begin = lambda: subprocess.Popen(  # noqa: E731
        [sys.executable, "-m", "clvol", "batch", "job.toml", "--quiet"], stdout=subprocess.DEVNULL
    )
    chance = np.random.default_rng(5)
    workers = [begin(), begin()]
    for _ in range(6):
        time.sleep(float(chance.uniform(0.5, 3.0)))
        victim = int(chance.integers(2))
        workers[victim].send_signal(signal.SIGKILL)
        workers[victim].wait()
        workers[victim] = begin()
    assert [worker.wait(300) for worker in workers] == [0, 0]
    made = sorted(path for path in os.listdir("out") if not path.startswith("."))
    assert made == sorted(expected)
    for path in made:
        np.testing.assert_array_equal(np.load(f"out/{path}"), expected[path])
    rendered = [each["picture"] for each in results_in("job.jsonl") if each["status"] == "rendered"]
    assert len(rendered) == len(set(rendered))  # none twice; a process killed before its line has written none
