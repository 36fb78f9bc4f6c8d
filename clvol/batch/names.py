"""Names of the files of a job: patterns with the names of scenes, volumes and what varies."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clvol.errors import SceneError

_FIELD = re.compile(r"\{([^{}:]*)(?::([^{}]*))?\}")
_WIDTH = re.compile(r"0?[0-9]{1,2}d?")
_UNSAFE = re.compile(r"[^\w.+=-]+")
_NUMBER = re.compile(r"%(?:0([1-9]))?d")
_LONGEST = 80  # characters of a value in a name

# Endings that are left out of a stem, one after the other; anything else after a dot belongs to the name.
_ENDINGS = {
    ".toml", ".nrrd", ".nhdr", ".mha", ".mhd", ".nii", ".gz", ".hdr", ".img", ".tif", ".tiff", ".npy", ".raw", ".zarr",
    ".ome", ".exr", ".png", ".jpg", ".jpeg", ".dcm", ".ima", ".zip", ".h5", ".hdf5", ".nc", ".mrc", ".map", ".vti",
}  # fmt: skip


def stem_of(path: str) -> str:
    """The name of a file or a folder without its endings: "brain" of "data/brain.nii.gz"."""
    name = os.path.basename(os.path.abspath(path))
    while (shorter := Path(name).stem) != name and Path(name).suffix.lower() in _ENDINGS:
        name = shorter
    return name


def in_a_name(value: Any) -> str:
    """``value`` of a key as a part of a file's name: letters, digits and the characters ``_ . + = -``."""
    if isinstance(value, bool):
        text = str(value).lower()
    elif isinstance(value, float):
        text = f"{value:.6g}" if math.isfinite(value) else str(value)
    elif isinstance(value, Mapping):
        text = "_".join(f"{key}={in_a_name(each)}" for key, each in value.items())
    elif isinstance(value, Sequence) and not isinstance(value, str):
        text = "_".join(map(in_a_name, value))
    else:
        text = str(value)
    return _UNSAFE.sub("_", text)[:_LONGEST].strip("_") or "_"


def check_pattern(pattern: str, known: Sequence[str], where: str) -> None:
    """SceneError for a pattern with another field than those that are ``known``, or with a lone brace."""
    for name, width in _FIELD.findall(pattern):
        if name not in known:
            fields = ", ".join("{" + each + "}" for each in known)
            raise SceneError(where, f"got {{{name}}} in {pattern!r}", f"one of {fields}")
        if width and (name != "number" or not _WIDTH.fullmatch(width)):
            raise SceneError(where, f"got {{{name}:{width}}} in {pattern!r}", "a width for numbers only: {number:04d}")
    if re.search(r"[{}]", _FIELD.sub("", pattern)):
        raise SceneError(where, f"got a lone brace in {pattern!r}", "fields such as {scene} or {number}")


def filled(pattern: str, values: Mapping[str, Any]) -> str:
    """``pattern`` with its fields replaced by ``values``."""

    def text(match: re.Match[str]) -> str:
        value = values[match[1]]
        return f"{value:{match[2]}}" if match[2] else in_a_name(value)

    return _FIELD.sub(text, pattern)


def numbered(path: str, index: int) -> str:
    """``path`` with the number of a frame in place of the %d in its name, or with at least four digits in place of
    %04d. A name without such a place, or with several, stays unchanged."""
    folder, name = os.path.split(path)
    found = _NUMBER.findall(name)
    if len(found) != 1:
        return path
    digits = int(found[0] or 1)
    return os.path.join(folder, _NUMBER.sub(f"{index:0{digits}d}", name))
