"""The report of a sweep: ``tradeoff.json``, ``tradeoff.png``, pictures, and ``index.html``."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clvol.accuracy.difference import difference_picture
from clvol.accuracy.report.chart import tradeoff_chart
from clvol.accuracy.report.images import page_images, picture_file, shown_file
from clvol.accuracy.report.page import page
from clvol.accuracy.report.sweep import Sweep
from clvol.errors import UsageError
from clvol.image import atomic_paths
from clvol.json_values import plain

BLACK = (0.0, 0.0, 0.0)


def write_report(
    result: dict[str, Any], pictures: Mapping[str, np.ndarray], folder: Path
) -> list[Path]:
    """Writes the report of a sweep into ``folder``, which is created if necessary, and returns the files.

    ``result`` becomes ``tradeoff.json`` (numbers that are not finite become null). ``pictures`` maps "reference" and
    the ids of points to float32 [height, width, 4], linear, premultiplied, which are shown over
    ``result["scene"]["background"]`` ([3], linear; black if there is none). ``index.html`` needs no other file. All
    files appear, each of them whole, or none does. Raises UsageError if the folder cannot be created or written to,
    and RenderError when writing fails.
    """
    result = plain(result)
    contents = _contents(result, pictures)
    folder = Path(folder)
    created = _create_folders([folder, folder / "images"])
    paths = [folder / name for name in contents]
    try:
        with atomic_paths(paths) as temporaries:
            for temporary, data in zip(temporaries, contents.values()):
                temporary.write_bytes(data)
    except BaseException:
        for new in reversed(created):
            try:
                new.rmdir()  # fails unless the folder is empty
            except OSError:
                pass
        raise
    return paths


def _contents(result: dict[str, Any], pictures: Mapping[str, np.ndarray]) -> dict[str, bytes]:
    """The names of the files, relative to the folder, and their bytes."""
    sweep = Sweep(result)
    background = result["scene"].get("background") or BLACK
    shown = [point["id"] for point in sweep.shown()]
    images = page_images(pictures, background, shown)
    contents = {
        "index.html": page(sweep, images).encode("utf-8"),
        "tradeoff.json": (json.dumps(result, indent=1, ensure_ascii=False, allow_nan=False)
                          + "\n").encode("utf-8"),
        "tradeoff.png": tradeoff_chart(sweep),
    }
    for key in ["reference", *shown]:
        if key not in pictures:
            continue
        name = _file_name(key, contents)
        contents[f"images/{name}.png"] = picture_file(pictures[key], background)
        if key != "reference" and "reference" in pictures:
            seen = difference_picture(pictures[key], pictures["reference"], (key, "reference"))
            contents[f"images/{name}-difference.png"] = shown_file(seen)
    return contents


def _file_name(key: str, taken: Mapping[str, Any]) -> str:
    """``key`` without characters that file names cannot contain, and different from all names in ``taken``."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "-", key).strip("-")[:80] or "point"
    name, n = stem, 1
    while f"images/{name}.png" in taken or f"images/{name}-difference.png" in taken:
        n += 1
        name = f"{stem}-{n}"
    return name


def _create_folders(folders: list[Path]) -> list[Path]:
    """Creates the folders, and returns those that did not exist before, parents first."""
    created = []
    for folder in folders:
        try:
            missing = [f for f in [folder, *folder.parents] if not f.exists()]
            for new in reversed(missing):
                new.mkdir()
                created.append(new)
            if not folder.is_dir():
                raise UsageError(str(folder), "is a file", "a folder, or the name of a new one")
        except (OSError, ValueError) as error:
            for new in reversed(created):
                new.rmdir()
            why = getattr(error, "strerror", None) or str(error)
            raise UsageError(str(folder), f"the folder cannot be created: {why}",
                             "a folder that can be written to") from error
    return created
