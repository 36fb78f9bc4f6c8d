"""The example notebook: its cells run in order, and what they show is shown.

The cells' code is run as a notebook would run it, without a kernel: nbclient and a kernel bring a hundred packages.
"""

from __future__ import annotations

import ast
import io
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clvol.image import load_image

NOTEBOOK = Path(__file__).resolve().parents[1] / "data" / "examples" / "notebook.ipynb"


def cells(kind: str) -> list[str]:
    told = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert told["nbformat"] == 4
    return ["".join(cell["source"]) for cell in told["cells"] if cell["cell_type"] == kind]


def shown(source: str, names: dict) -> object:
    """Runs a cell, and returns the value of its last line, which a notebook displays."""
    parsed = ast.parse(source)
    last = parsed.body.pop() if isinstance(parsed.body[-1], ast.Expr) else None
    exec(compile(parsed, str(NOTEBOOK), "exec"), names)
    if last is None:
        return None
    return eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names)


def test_it_has_no_output_and_no_counts():
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        assert cell.get("outputs", []) == [] and cell.get("execution_count") is None


@pytest.mark.usefixtures("device")
def test_its_cells_run_and_show_what_they_say(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    values = [shown(source.replace("SIZE = 320", "SIZE = 72"), names) for source in cells("code")]
    assert repr(values[0]) == "<Volume 80 x 72 x 64 float32>"
    frames = [values[1], values[3], values[4], values[6]]
    for frame in frames:
        picture = Image.open(io.BytesIO(frame._repr_png_()))
        assert picture.size == (72, 72) and np.ptp(np.asarray(picture)) > 50
        assert repr(frame).startswith("<Frame 72 x 72 pixels, raycast")
    assert values[2].startswith("chosen: ")
    assert names["side_by_side"].shape == (72, 216, 3)
    assert frames[1] is frames[0] and frames[1].display.exposure == 0.8
    assert np.array_equal(load_image("shell.exr")["rgba"], frames[2].rgba)


def test_progress_is_shown_by_a_bar_or_by_a_function_or_not_at_all(monkeypatch, capsys):
    from clvol.errors import UsageError
    from clvol.render import progress_bar

    monkeypatch.setattr(progress_bar, "_DELAY", 0.0)
    with progress_bar.shown(True, "rendering") as move:
        for done in range(5):
            move(done, 4)
    told = capsys.readouterr().err
    assert "rendering: " in told and "left" in told
    calls: list = []
    with progress_bar.shown(lambda *share: calls.append(share), "rendering") as move:
        move(1, 2)
    assert calls == [(1, 2)]
    for none in (None, False):
        with progress_bar.shown(none, "rendering") as move:
            assert move is None
    monkeypatch.setattr(progress_bar.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UsageError, match=r"progress: needs the package tqdm, expected pip install 'clvol\[notebook\]'"):
        with progress_bar.shown(True, "rendering"):
            pass
