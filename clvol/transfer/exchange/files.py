"""Files of transfer functions: the format by the name's ending, and by the content where several share one.

Modules of formats are imported where they are used, since few commands need one.
"""

from __future__ import annotations

import json
import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import SceneError, UsageError
from clvol.transfer.exchange.imported import Imported
from clvol.transfer.exchange.sampled import Function
from clvol.transfer.exchange.text_files import parse_json, read_text

# Ending (lower case) to what it is; the longest wins.
ENDINGS = {
    ".vp.json": "volume property of 3D Slicer",
    ".json": "colour preset of ParaView",
    ".vp": "volume property of 3D Slicer",
    ".ctbl": "colour table of 3D Slicer",
    ".txt": "label table of ITK-SNAP or 3D Slicer",
    ".label": "label table of ITK-SNAP",
    ".ct": "colour table of VisIt",
}
LABELS = (".ctbl", ".txt", ".label")
WRITTEN = (".json", ".vp", ".vp.json", ".ctbl")
KNOWN = ".json (ParaView), .vp, .vp.json, .ctbl (3D Slicer), .txt, .label (ITK-SNAP, 3D Slicer) or .ct (VisIt)"


def load_imported(path: str | os.PathLike, entry: str | None = None) -> Imported:
    """What a file of another tool says. ``entry`` is the name of one of several presets of a ParaView file.

    SceneError, which names the file and the place in it, for everything that is not understood.
    """
    where, file = os.fspath(path), Path(path)
    ending = ending_of(where)
    if ending is None:
        raise SceneError(where, f"unknown ending {file.suffix!r}", KNOWN)
    text = read_text(file, f"a {ENDINGS[ending]}")
    if ending in (".json", ".vp.json"):
        data = parse_json(text, where, f"a {ENDINGS[ending]}")
        if isinstance(data, dict) and "volumeProperties" in data:
            found = _format("slicer").read_vp_json(data, where)
        else:
            return _format("paraview").read_presets(data, where, entry)
    elif ending == ".vp":
        found = _format("slicer").read_vp(text, where)
    elif ending == ".ct":
        found = _format("visit").read_color_table(text, where)
    else:
        found = _format("labels").read_labels(text, where)
    if entry is not None:
        raise SceneError(where, f"entry = {entry!r}, where there is one function", "no entry for this file")
    return found


def load_labels(path: str | os.PathLike) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Labels [n], sRGB-encoded colours [n, 3] and opacities [n] of a label table; SceneError for any other file."""
    where = os.fspath(path)
    if ending_of(where) not in LABELS:
        raise SceneError(where, f"unknown ending {Path(path).suffix!r}", "a label table: " + ", ".join(LABELS))
    return _format("labels").parse_labels(read_text(Path(path), "a label table of 3D Slicer or ITK-SNAP"), where)


def _format(name: str) -> Any:
    """A module of this package."""
    return import_module(f"{__package__}.{name}")


def ending_of(path: str) -> str | None:
    """The longest ending in ``ENDINGS`` that the path has, or None."""
    name = os.path.basename(path).lower()
    return max((ending for ending in ENDINGS if name.endswith(ending)), key=len, default=None)


def text_of(function: Function, path: str, name: str | None = None) -> str:
    """The content of a file of the format that ``path`` ends in. UsageError for an ending that is not written."""
    ending = ending_of(path)
    if ending not in WRITTEN:
        raise UsageError(path, "cannot be written", "a name that ends in .json (ParaView), .vp, .vp.json or .ctbl")
    name = name or os.path.basename(path)[: -len(ending)] or "clvol"
    if ending == ".ctbl":
        return _format("labels").slicer_table(function, name, path)
    if ending == ".vp":
        return _format("slicer").vp_of(function)
    is_preset = ending == ".json"
    data = _format("paraview").preset_of(function, name) if is_preset else _format("slicer").vp_json_of(function)
    return json.dumps(data, indent=1) + "\n"


def save_function(function: Function, path: str | os.PathLike, name: str | None = None) -> None:
    """Writes ``function`` for ParaView (.json) or 3D Slicer (.vp, .vp.json; .ctbl if it is a table of labels).

    ``name`` is the preset's, by default that of the file. Colours between points are right to within ``COLOR_ERROR``.
    SceneError, UsageError.
    """
    file = os.fspath(path)
    Path(file).write_text(text_of(function, file, name), encoding="utf-8")
