"""clvol sheet, clvol info --histogram, the manual page, suggestions, and progress while files are read."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import time

import numpy as np
import pytest
from PIL import Image

from clvol.choice.histogram import histogram_of
from clvol.cli.group import COMMANDS
from clvol.overlay.sheet import Cell, SheetLayout, compose
from clvol.volume import Volume


def pixels(path) -> np.ndarray:
    return np.asarray(Image.open(path))


# --- clvol sheet


@pytest.fixture
def shots(monkeypatch, folder):
    """The pictures of a sheet without a device: as bright as their number; the list of scenes that were rendered."""
    from clvol.cli import sheet

    made: list = []

    def picture(scene, view, devices, memory_cap):
        made.append((scene, view))
        size = scene.image.height, scene.image.width, 3
        return np.full(size, 40 * len(made), np.uint8), "cubes"

    monkeypatch.setattr(sheet, "_picture", picture)
    return made


def test_a_sheet_has_every_preset_from_every_view(run, shots):
    views = [word for view in ("front", "left", "top") for word in ("--view", view)]
    presets = ["--preset", "ct-bone", "--preset", "grayscale"]
    outcome = run("sheet", "cube.npy", "-o", "s.png", "--size", "40", *views, *presets)
    assert (outcome.status, outcome.out) == (0, "s.png\n")
    assert [view for _, view in shots] == ["front", "left", "top"] * 2
    assert [scene.transfer_function.preset for scene, _ in shots] == ["ct-bone"] * 3 + ["grayscale"] * 3
    layout = SheetLayout(6, 40, 40, 3)
    picture = pixels("s.png")
    assert picture.shape == (layout.page[1], layout.page[0], 3)
    for number in range(6):
        x, y = layout.place(number)
        assert (picture[y : y + 40, x : x + 40] == 40 * (number + 1)).all()


@pytest.mark.parametrize(("file", "form"), [("s.png", "PNG"), ("s.jpg", "JPEG"), ("s.tif", "TIFF")])
def test_sheets_of_several_volumes_in_each_format(run, shots, file, form):
    shutil.copy("cube.npy", "other.npy")
    scenes = ["cube.npy", "scene.toml", "other.npy"]
    assert run("sheet", *scenes, "-o", file, "--size", "32", "--title", "Cubes").status == 0
    with Image.open(file) as image:
        assert image.format == form and image.mode == "RGB"


def test_a_picture_that_fails_is_replaced_by_its_error(run, shots):
    outcome = run("sheet", "none.npy", "cube.npy", "-o", "s.png", "--size", "80")
    assert outcome.status == 2 and outcome.err.startswith("clvol: error: none.npy: no such file")
    assert outcome.err.count("\n") == 1 and len(shots) == 1
    picture, (x, y) = pixels("s.png"), SheetLayout(2, 80, 80, 2).place(0)
    assert (picture[y : y + 80, x : x + 80, 0] > picture[y : y + 80, x : x + 80, 1]).mean() > 0.5


@pytest.mark.usefixtures("device")
def test_a_sheet_on_standard_output(folder):
    words = ["sheet", "scene.toml", "-o", "-", "--size", "24", "--view", "front", "--page", "white"]
    done = subprocess.run([sys.executable, "-m", "clvol", *words], capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr
    picture = np.asarray(Image.open(io.BytesIO(done.stdout)))
    x, y = SheetLayout(1, 24, 24, 1).place(0)
    assert (picture[0, 0] == 255).all() and picture[y : y + 24, x : x + 24].min() < 60


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["cube.npy", "-o", "s.exr"], 's.exr: unknown ending ".exr" of a sheet, expected .png or .jpg'),
        (["cube.npy", "-o", "s.png", "--view", "behind"], "--view: got 'behind', expected front, back"),
        (["cube.npy", "-o", "s.png", "--page", "x"], "--page: got 'x', expected three numbers"),
        (["cube.npy", "-o", "s.png", "--size", "3"], "clvol sheet: --size: 3 is not in the range"),
        (["cube.npy", "-o", "none/s.png"], "none/s.png: the folder "),
        (["-o", "s.png"], "clvol sheet: no SCENE, expected SCENE"),
        (["cube.npy"] * 500 + ["-o", "s.png", "--size", "2000"], "--size: a sheet of "),
    ],
)
def test_wrong_sheets_are_refused_before_the_work(refused, nothing_left, shots, words, line):
    assert refused(2, "sheet", *words).startswith(line)
    assert not shots


def test_captions_lie_under_their_pictures_and_within_their_columns():
    layout = SheetLayout(2, 100, 60, 2)
    black = np.zeros((60, 100, 3), np.uint8)
    both = compose([Cell(black, "a" * 80, "told"), Cell(black, "")], layout, (0.0, 0.0, 0.0))
    x, y = layout.place(0)
    bright = np.argwhere(both.max(axis=2) > 100)
    assert bright[:, 0].min() >= y + 60 and bright[:, 0].max() < y + 60 + layout.caption
    assert bright[:, 1].min() >= x - 2 and bright[:, 1].max() <= x + 102


# --- clvol info --histogram


def test_the_histogram_counts_every_voxel(run, folder):
    told = json.loads(run("info", "cube.npy", "--histogram", "--json", "--bins", "8").out)["histogram"]
    assert told["counts"] == [8] * 8 and told["voxels"] == told["all_voxels"] == 64
    assert told["edges"] == [8 * k - 0.5 for k in range(9)]


def test_the_histogram_as_text_and_as_a_picture(run, folder):
    outcome = run("info", "cube.npy", "--histogram", "--bins", "4", "-o", "h.png")
    lines = outcome.out.splitlines()
    assert lines[-1] == "h.png" and lines[-6].startswith("histogram")
    assert lines[-5].split()[:3] == ["-0.5", "to", "15.5"]
    assert all(line.endswith("25 %") for line in lines[-5:-1])
    assert pixels("h.png").shape[2] >= 3
    done = subprocess.run(
        [sys.executable, "-m", "clvol", "info", "cube.npy", "--histogram", "-o", "-"], capture_output=True, timeout=300
    )
    assert done.returncode == 0 and Image.open(io.BytesIO(done.stdout)).format == "PNG" and done.stderr == b""


@pytest.mark.parametrize(
    "data",
    [np.zeros((2, 2, 2)), np.full((2, 2, 2), np.nan), np.array([[[1, np.inf, np.nan, 3]]]), np.ones((1, 1, 1))],
)
def test_values_that_are_few_or_none(data):
    found = histogram_of(Volume(data), 5)
    assert found.counts.sum() == np.isfinite(data).sum() and (np.diff(found.edges) > 0).all()


def test_the_histogram_is_of_values_and_integers_share_bins_evenly():
    data = np.arange(100, dtype=np.int16).reshape(1, 10, 10)
    found = histogram_of(Volume(data, slope=-2.0, offset=10.0), 24)
    assert found.counts.sum() == 100 and set(found.counts[:-1].tolist()) == {5} and found.counts[-1] == 5
    assert found.edges[0] == -189.0 and found.edges[-1] == 11.0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["-o", "h.png"], "clvol info: -o: given without --histogram"),
        (["--bins", "3"], "clvol info: --bins: given without --histogram"),
        (["--histogram", "--bins", "0"], "clvol info: --bins: 0 is not in the range"),
        (["--histogram", "-o", "h.jpg"], "h.jpg: unknown ending of a histogram, expected a file name that ends"),
        (["--histogram", "-o", "-", "--json"], "-: is given twice"),
        (["--histogram", "-o", "none/h.png"], "none/h.png: the folder "),
    ],
)
def test_wrong_histograms_are_refused(refused, nothing_left, words, line):
    assert refused(2, "info", "cube.npy", *words).startswith(line)


# --- the manual page and suggestions


def test_the_manual_page_has_every_command_and_option(run):
    outcome = run("--man")
    assert (outcome.status, outcome.err) == (0, "") and outcome.out.isascii()
    assert outcome.out.startswith(".TH CLVOL 1")
    for name in COMMANDS:
        assert f'.SS "clvol {name} ' in outcome.out
    plain = outcome.out.replace("\\-", "-")
    for option in ("--exposure", "--max-error", "--histogram", "--codec", "--preset"):
        assert option in plain
    assert all(f".B {status}" in plain for status in (0, 2, 3, 4, 130))


@pytest.mark.skipif(shutil.which("groff") is None, reason="there is no groff, which reads manual pages")
def test_groff_reads_the_manual_page(run):
    page = run("--man").out
    command = ["groff", "-Kutf8", "-man", "-Tutf8", "-ww"]
    done = subprocess.run(command, input=page, capture_output=True, encoding="utf-8", timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert "EXIT STATUS" in done.stdout.replace("\x08", "") or "EEXXIITT" in done.stdout.replace("\x08", "")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["rendr"], ["unknown command 'rendr'", "(did you mean 'render'?)"]),
        (["render", "a", "--outptu", "x"], ["unknown option --outptu", "--set, ", "(did you mean '--output'?)"]),
        (["explain", "a", "--frames", "0:1"], ["unknown option --frames", "--memory-cap"]),
        (["develop", "a", "--opaqe"], ["(did you mean '--opaque'?)"]),
        (["--" + "x" * 5000], ["unknown option"]),
    ],
)
def test_unknown_words_name_those_that_exist(refused, words, parts):
    line = refused(2, *words)
    assert all(part in line for part in parts)
    assert "did you mean '--resume'" not in line


# --- progress while files are read


def test_what_has_been_read_is_reported(tmp_path, monkeypatch):
    from clvol.cli import reading

    if reading.bytes_read() is None:
        pytest.skip("this system does not count what a process reads")
    monkeypatch.setattr(reading, "_INTERVAL", 0.01)
    (tmp_path / "large").write_bytes(bytes(1 << 20))
    told: list[tuple[int, int]] = []
    with reading.reported([tmp_path / "large"], lambda done, total: told.append((done, total))):
        (tmp_path / "large").read_bytes()
        end = time.monotonic() + 30
        while not told and time.monotonic() < end:
            time.sleep(0.01)
    assert told and all(total == 1 << 20 and 0 < done <= total for done, total in told)


def test_without_a_counter_nothing_is_reported(tmp_path, monkeypatch):
    from clvol.cli import reading

    monkeypatch.setattr(reading, "bytes_read", lambda: None)
    with reading.reported([tmp_path / "none"], lambda *share: pytest.fail("reported")):
        pass


def test_a_terminal_sees_a_bar_and_a_pipe_nothing(run, folder, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    told = Terminal()
    monkeypatch.setattr(sys, "stderr", told)
    for words in (["info", "cube.npy"], ["explain", "scene.toml"]):
        told.truncate(0)
        assert run(*words).status == 0
        assert "left" in told.getvalue()
    monkeypatch.undo()
    assert run("info", folder / "cube.npy").err == ""
