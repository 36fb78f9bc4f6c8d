"""The pictures of a job in one process, whose scenes share what they have in common."""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clvol.batch import run as run_module
from clvol.batch.job import load_job, pictures_of
from clvol.batch.results import results_in
from clvol.batch.run import JobRun, Options
from clvol.image import load_image
from clvol.render import Renderer
from clvol.scene import load_scene

CAMERAS = [[4.0, 4.0, -30.0], [4.0, 4.0, 60.0], [4.0, 4.0, 61.0], [30.0, 9.0, 2.0]]
AWAY = (1, 2)  # of these, which look away


@pytest.fixture
def job(tmp_path, monkeypatch):
    """The pictures of a job of four cameras and two opacity units, in the working folder."""
    monkeypatch.chdir(tmp_path)
    np.save("cube.npy", np.arange(512, dtype=np.uint16).reshape(8, 8, 8))
    Path("scene.toml").write_text(
        'version = 1\n[volume]\nfile = "cube.npy"\n[camera]\ntarget = [4.0, 4.0, 90.0]\n[image]\nwidth = 24\n'
        "height = 20\n"
        "[transfer_function]\npoints = [{ value = 0.0, opacity = 0.1, color = [1.0, 0.0, 0.0] },\n"
        "{ value = 511.0, opacity = 0.5, color = [0.0, 1.0, 0.0] }]\n"
    )
    Path("job.toml").write_text(
        f'scenes = ["scene.toml"]\noutput = ["{{number}}.npy", "{{number}}.png"]\n'
        f'[[vary]]\nkey = "transfer_function.opacity_unit"\nvalues = [1.0, 3.0]\n'
        f'[[vary]]\nkey = "camera.position"\nvalues = {CAMERAS}\n'
    )
    return pictures_of(load_job("job.toml"), "job.toml")


def test_pictures_are_those_of_their_scenes_alone(job):
    told = []

    def emit(result):
        assert all(map(os.path.exists, result["files"]))  # a line is written once its picture is there
        assert results_in("r.jsonl")[-1]["files"] == result["files"]
        told.append(result)

    outcome = JobRun(job, Options(results="r.jsonl"), emit).run()
    assert outcome.counts == {"rendered": 8, "kept": 0, "failed": 0}
    assert [result["picture"] for result in told] == list(range(8))
    for picture, result in zip(job, told):
        with Renderer(load_scene(picture.source, settings=picture.settings)) as renderer:
            if picture.number in (0, 7):
                frame = renderer.render()
                np.testing.assert_array_equal(np.load(picture.files[0]), frame.rgba)
                made_from = load_image(picture.files[1])["made_from"]
                del made_from["pixels"]
                assert made_from == frame.made_from()
        warned = [warning for warning in result.get("warnings", []) if warning.startswith("camera: looks away")]
        assert len(warned) == (picture.number % 4 in AWAY)  # for each picture, also if the scene before had the same
    assert JobRun(job, Options(results="r.jsonl"), emit).run().counts["kept"] == 8


def test_a_picture_that_cannot_be_written_is_one_failure(job, monkeypatch):
    threads, write = [], run_module.save_picture

    def save(frame, temporary, path):
        threads.append(threading.current_thread())
        if path.startswith("3."):
            raise MemoryError
        write(frame, temporary, path)

    monkeypatch.setattr(run_module, "save_picture", save)
    os.mkdir("6.npy")
    outcome = JobRun(job, Options(results="r.jsonl"), lambda result: None).run()
    assert outcome.counts == {"rendered": 6, "kept": 0, "failed": 2} and outcome.status == 2
    failed = {each["picture"]: each["message"] for each in results_in("r.jsonl") if each["status"] == "failed"}
    assert "no memory" in failed[3] and "this is a folder" in failed[6]
    assert not os.path.exists("3.npy") and not [name for name in os.listdir() if name.startswith(".")]
    assert threading.main_thread() not in threads


def test_a_scene_that_is_wrong_costs_the_others_nothing(job, monkeypatch):
    made = []
    monkeypatch.setattr(run_module, "Renderer", lambda *words, **how: made.append(Renderer(*words, **how)) or made[-1])
    wrong = replace(job[2], settings=(("integration.step", -1.0),))
    outcome = JobRun([*job[:2], wrong, *job[3:]], Options(results="r.jsonl"), lambda result: None).run()
    assert outcome.counts == {"rendered": 7, "kept": 0, "failed": 1} and len(made) == 1
