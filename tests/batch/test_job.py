"""Job files: which pictures they make, under which names, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from clvol.batch.job import load_job, pictures_of
from clvol.batch.names import filled, in_a_name, stem_of
from clvol.errors import SceneError


@pytest.fixture
def job(tmp_path):
    """``job(text)``: the pictures of a job file; beside it are a.toml, b.toml and three volumes."""
    for name in ("a.toml", "b.toml", "x.nrrd", "y.nrrd", "z.nii.gz"):
        (tmp_path / name).write_text("")

    def load(text: str):
        path = tmp_path / "job.toml"
        path.write_text(text, encoding="utf-8")
        return pictures_of(load_job(path), path)

    return load


VARY = """
[[vary]]
key = "camera.view"
values = ["front", "left"]
[[vary]]
key = "integration.step"
values = [0.5, 1.0]
"""


def names(pictures) -> list[str]:
    return [Path(path).name for picture in pictures for path in picture.files]


def test_every_combination_is_a_picture(job, tmp_path):
    found = job('scenes = ["a.toml", "b.toml"]\nvolumes = ["x.nrrd", "y.nrrd"]\noutput = "o/{number:03d}.png"\n' + VARY)
    assert len(found) == 16 and names(found)[:2] == ["000.png", "001.png"]
    assert len({(p.source, p.volume, p.settings) for p in found}) == 16
    first = found[0]
    assert first.source == str(tmp_path / "a.toml") and first.volume == str(tmp_path / "x.nrrd")
    assert first.settings == (
        ("volume.file", str(tmp_path / "x.nrrd")), ("camera.view", "front"), ("integration.step", 0.5)
    )  # fmt: skip
    assert first.files == (str(tmp_path / "o" / "000.png"),)
    assert [(p.source, p.volume) for p in found] == sorted((p.source, p.volume) for p in found)  # a volume at a time


def test_names_of_files_say_what_varies(job):
    pattern = "{volume}_{camera.view}_{integration.step}.png"
    found = job(f'volumes = ["*.n*"]\noutput = ["{pattern}", "{{number}}.exr"]\n' + VARY)
    assert names(found)[:4] == ["x_front_0.5.png", "0.exr", "x_front_1.png", "1.exr"]
    assert names(found)[-2:] == ["z_left_1.png", "11.exr"]


def test_settings_of_all_pictures(job):
    text = 'scenes = ["a.toml"]\noutput = "{image.width}.png"\nset = { "image.height" = 5, "image.width" = 1 }\n'
    found = job(text + '[[vary]]\nkey = "image.width"\nvalues = [7, 8]\n')
    assert found[1].settings == (("image.height", 5), ("image.width", 1), ("image.width", 8))


@pytest.mark.parametrize(
    "value, text",
    [
        (True, "true"), (3, "3"), (0.1 + 0.2, "0.3"), (1e-30, "1e-30"), ("front-left", "front-left"),
        ([1, 2.5], "1_2.5"),
        ({"type": "directional", "a": 1}, "type=directional_a=1"), ("../../etc/passwd", ".._.._etc_passwd"), ("", "_"),
        ("a b\n\0", "a_b"), ("x" * 500, "x" * 80), ("größe", "größe"), (float("inf"), "inf"),
    ],
)  # fmt: skip
def test_values_in_names(value, text):
    assert in_a_name(value) == text
    assert filled("{v}", {"v": value}) == text


def test_no_value_leads_out_of_the_folder(job, tmp_path):
    varied = '[[vary]]\nkey = "x.y"\nname = "t"\nvalues = ["../up", "/etc"]\n'
    found = job('scenes = ["a.toml"]\noutput = "o/{t}.png"\n' + varied)
    for path in (path for picture in found for path in picture.files):
        assert Path(path).resolve().parent == tmp_path / "o"


@pytest.mark.parametrize("path, stem", [("a/brain.nii.gz", "brain"), ("x.ome.zarr", "x"), ("v1.2.nrrd", "v1.2")])
def test_stems(path, stem):
    assert stem_of(path) == stem


GOOD = 'scenes = ["a.toml"]\noutput = "{scene}.png"\n'


@pytest.mark.parametrize(
    "text, told",
    [
        ("", "output: missing"),
        ('output = "a.png"', "scenes"),
        (GOOD + 'outputs = "x"', "did you mean 'output'?"),
        (GOOD + "version = 2", "version"),
        ('scenes = "a.toml"\noutput = "x.png"', "scenes: got 'a.toml'"),
        ('scenes = ["c*.toml"]\noutput = "x.png"', "scenes.0: no file is named like 'c*.toml'"),
        ('scenes = ["a.toml", "b.toml"]\noutput = "x.png"', "would both be"),
        ('scenes = ["a.toml"]\noutput = ["x.png", "./x.png"]', "would both be"),
        ('scenes = ["a.toml"]\noutput = "{volume}.png"', "got {volume}"),
        ('scenes = ["a.toml"]\noutput = "{scene!r}.png"', "got {scene!r}"),
        ('scenes = ["a.toml"]\noutput = "{scene:5}.png"', "a width for numbers only"),
        ('scenes = ["a.toml"]\noutput = "{number:999999999}.png"', "a width for numbers only"),
        ('scenes = ["a.toml"]\noutput = "{.png"', "a lone brace"),
        (GOOD + '[[vary]]\nkey = "a.b"', "vary.0.values: missing"),
        (GOOD + '[[vary]]\nkey = "a.b"\nvalues = []', "vary.0.values"),
        (GOOD + '[[vary]]\nkey = "a.b"\nvalues = [1]\n[[vary]]\nkey = "a.b"\nvalues = [1]', "another key or name"),
        (GOOD + '[[vary]]\nkey = "a.b"\nvalues = [1]\nname = "scene"', "another key or name"),
        (GOOD + '[[vary]]\nkey = "a.b"\nvalues = [1, 2]', "tells them apart, with some of {scene}, {number}, {a.b}"),
        (GOOD + "max_error = 0", "max_error"),
        ("[", "a job file (.toml)"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(job, text, told):
    with pytest.raises(SceneError) as caught:
        job(text)
    assert told in str(caught.value) and "\n" not in str(caught.value)
    assert "job.toml" in str(caught.value)


def test_too_many_pictures_are_refused_at_once(job):
    many = "".join(f'[[vary]]\nkey = "k.k{i}"\nvalues = {list(range(100))}\n' for i in range(4))
    with pytest.raises(SceneError, match="100000000 pictures"):
        job('scenes = ["a.toml"]\noutput = "{number}.png"\n' + many)


def test_no_such_job(tmp_path):
    with pytest.raises(SceneError, match="no such file"):
        load_job(tmp_path / "none.toml")
