"""What ``import clvol`` offers: every name there, documented, and readable with ``help``."""

from __future__ import annotations

import inspect
import pydoc
import subprocess
import sys

import numpy as np
import pytest

import clvol
from clvol.scene import Scene
from clvol.scene.reference import scene_reference
from clvol.scene.table import model_in


@pytest.mark.parametrize("name", clvol.__all__)
def test_every_public_name_is_there_and_documented(name):
    value = getattr(clvol, name)
    assert name in dir(clvol)
    assert len((value.__doc__ or "").strip()) > 20


def test_star_import_gives_all_names():
    names: dict = {}
    exec("from clvol import *", names)
    assert set(clvol.__all__) <= set(names)


def test_every_table_of_a_scene_is_public():
    for field in Scene.model_fields.values():
        model = model_in(field.annotation)
        assert model is None or getattr(clvol, model.__name__) is model


def test_import_loads_nothing_heavy():
    code = "import clvol, sys; sys.exit(', '.join({'numpy', 'pydantic', 'pyopencl'} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")


def test_help_on_a_scene_is_readable():
    text = pydoc.plain(pydoc.render_doc(clvol.Scene))
    signature = str(inspect.signature(clvol.Scene))
    assert "Validator" not in signature and len(signature) < 1000
    head = text.partition("Method resolution order")[0]
    assert "Validator" not in head
    for name in Scene.model_fields:
        assert f"{name} : " in head, name
    assert "Raises" in head and ">>> " in head


def test_the_example_of_the_scene_is_right(tmp_path, monkeypatch):
    doc = inspect.getdoc(clvol.Scene)
    lines = [line[4:] for line in doc.splitlines() if line.startswith((">>> ", "... "))]
    monkeypatch.chdir(tmp_path)
    array = np.arange(4**3, dtype=np.uint8).reshape(4, 4, 4)
    exec("\n".join(lines).replace("800", "32").replace("600", "24"), {"clvol": clvol, "array": array})
    assert (tmp_path / "picture.png").stat().st_size > 0


@pytest.mark.parametrize("table", ["light", "camera", "isosurface"])
def test_signatures_of_tables_state_the_keys(table):
    model = model_in(Scene.model_fields[table].annotation)
    keys = list(inspect.signature(model).parameters)
    assert keys == list(model.model_fields) and all(f"{key} = " in scene_reference(table) for key in keys)
