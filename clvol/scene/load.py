"""Reading scene files, and overriding single values in them."""

from __future__ import annotations

import copy
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from clvol.errors import SceneError
from clvol.readers import ENDINGS, is_url, is_volume_path
from clvol.scene.carried import at_its_moment, carried_scene, is_picture_path
from clvol.scene.scene import Scene
from clvol.scene.table import shown
from clvol.store.zarr_store import is_store

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

LARGEST_FILE = 64 * 2**20
_KEPT_TEXT = 2**18  # characters of a file that is parsed once
_POSITION = re.compile(r"^(?P<what>.*?)\s*\(at (?P<place>[^()]*)\)$", re.DOTALL)
_DICOM_FILES = (".dcm", ".ima")  # the reader says what to do with a single file
_KEY = re.compile(r"[A-Za-z0-9_-]+")


def load_scene(
    path: str | Path,
    overrides: Iterable[str] = (),
    settings: Iterable[tuple[str, Any]] = (),
    make: Callable[[dict[str, Any], str, Path], Scene] = Scene.from_data,
) -> Scene:
    """Loads the scene file ``path`` (.toml), or makes a scene with all defaults of a volume: ``path`` is a file,
    a folder or a URL.

    A clvol store is rendered by the method "multiresolution", since it may be larger than memory, unless
    ``overrides`` choose another one.

    ``overrides`` are texts such as ``image.width=1024`` or ``light.0.intensity=2``, with values in TOML syntax. They
    are applied in order. An index one past the end of a list appends to it. ``settings``, applied after them, are pairs
    of such a key and its value. Raises SceneError whose ``where`` is "FILE: KEY". The volume itself is read by
    ``Scene.resolve``.

    ``path`` may also be a picture (.exr, .png, .jpg) that clvol has rendered: the scene is the one that its header
    carries, and ``Scene.moment`` says which camera and time the picture shows. ``make`` takes the place of
    ``Scene.from_data``.
    """
    overrides, settings = tuple(overrides), tuple(settings)
    if is_url(path):  # which Path would respell
        origin = str(path)
        data, folder = {"volume": {"file": origin}}, Path()
        _change(data, overrides, settings, origin)
        return make(data, origin, folder)
    path = Path(path)
    if is_picture_path(path):
        return _load_carried(path, overrides, settings)
    if path.suffix.lower() == ".toml":
        data, folder = _read(path), path.parent
    else:
        _check_ending(path)
        data, folder = {"volume": {"file": str(path)}}, Path()
        if os.path.isdir(path) and is_store(path):
            data["integration"] = {"method": "multiresolution"}
    _change(data, overrides, settings, str(path))
    return make(data, str(path), folder)


def parsed_file(path: Path) -> dict[str, Any]:
    """The tables of a file in TOML. SceneError for one that cannot be read."""
    return _read(path)


def _change(data: dict[str, Any], overrides: Iterable[str], settings: Iterable[tuple[str, Any]], origin: str) -> None:
    for text in overrides:
        override(data, text, origin)
    for key, value in settings:
        keys = key.split(".")
        if not all(_KEY.fullmatch(part) for part in keys):
            raise SceneError(origin, f"got the key {shown(key)}", "the name of a key, such as image.width")
        assign(data, keys, copy.deepcopy(value), origin)


def _load_carried(path: Path, overrides: tuple[str, ...], settings: tuple[tuple[str, Any], ...]) -> Scene:
    carried = carried_scene(path, overrides)
    data = _parsed(carried.text, str(path))
    moment = at_its_moment(data, carried.moment, overrides)
    _change(data, overrides, settings, str(path))
    volume = data.get("volume")
    folder = carried.folder_with(volume.get("file") if isinstance(volume, dict) else None)
    scene = Scene.from_data(data, str(path), folder)
    scene._moment = moment
    return scene


def _check_ending(path: Path) -> None:
    """Raises SceneError for a file whose name is neither that of a scene nor that of a volume."""
    if path.suffix.lower() in _DICOM_FILES or is_volume_path(path):
        return
    what = f"unknown ending {path.suffix!r}" if path.suffix else "no ending"
    if not os.path.exists(path):
        what = "no such file"
    known = ", ".join(ENDINGS)
    expected = f"a scene (.toml), a picture that clvol has rendered, or a volume: {known} or a DICOM folder"
    raise SceneError(str(path), what, expected)


def _read(path: Path) -> dict[str, Any]:
    try:
        if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe would block
            what = "a folder" if os.path.isdir(path) else "not a regular file"
            raise SceneError(str(path), what, "a scene file (.toml)")
        with path.open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise SceneError(str(path), "no such file", "a scene (.toml) or a volume file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(str(path), f"cannot be read ({reason})", "a readable scene file") from None
    if len(raw) > LARGEST_FILE:
        raise SceneError(str(path), f"more than {LARGEST_FILE} bytes", "a scene file") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw[: error.start].count(b"\n") + 1
        what = f"byte {raw[error.start]:#04x}"
        raise SceneError(f"{path}: line {line}", what, "a scene file, text in UTF-8") from None
    return _parsed(text, str(path))


def _parsed(text: str, path: str) -> dict[str, Any]:
    """The tables of a scene file's ``text``; errors name ``path``."""
    try:
        return _copied(_tables(text)) if len(text) < _KEPT_TEXT else tomllib.loads(text)
    except RecursionError:
        raise SceneError(path, "nested too deeply", "a scene in TOML") from None
    except ValueError as error:  # TOMLDecodeError is one
        what, place = _parted(str(error))
        if place.startswith("end"):
            place = f"line {text.count(chr(10)) + 1}"
        where = f"{path}: {place}" if place else path
        raise SceneError(where, what, "a scene in TOML") from None


@lru_cache(maxsize=8)
def _tables(text: str) -> dict[str, Any]:
    """``text`` as TOML; not to be changed, since it is kept for the next scene of the same file."""
    return tomllib.loads(text)


def _copied(value: Any) -> Any:
    """A copy of ``value`` that shares no table and no list with it."""
    if isinstance(value, dict):
        return {key: _copied(item) for key, item in value.items()}
    return [_copied(item) for item in value] if isinstance(value, list) else value


def _parted(message: str) -> tuple[str, str]:
    """(what, place) of a TOML error message, such as ("Invalid value", "line 3, column 5")."""
    match = _POSITION.match(message)
    return (match["what"], match["place"]) if match else (message, "")


def override(data: dict[str, Any], text: str, origin: str) -> None:
    """Sets one value of the parsed scene ``data``; ``text`` is TABLE.KEY=VALUE."""
    key, equals, value_text = text.partition("=")
    keys = [part.strip() for part in key.split(".")]
    if not equals or not all(_KEY.fullmatch(part) for part in keys):
        raise SceneError(f"--set {shown(text)}", "not an assignment", "TABLE.KEY=VALUE")
    assign(data, keys, _parse_value(text, ".".join(keys), value_text), origin)


def assign(data: dict[str, Any], keys: Sequence[str], value: Any, origin: str) -> None:
    """Sets the value at ``keys``, one after the other, in the parsed scene ``data``."""
    place: Any = data
    for i, part in enumerate(keys):
        where = f"{origin}: {'.'.join(keys[:i])}"
        is_last = i == len(keys) - 1
        empty: list[Any] | dict[str, Any] = [] if not is_last and keys[i + 1].isdecimal() else {}
        if isinstance(place, list):
            if not part.isdecimal() or len(part) > 9 or int(part) > len(place):
                wanted = f"an index from 0 to {len(place)}"
                raise SceneError(where, f"got {shown(part)}", wanted)
            index = int(part)
            if index == len(place):
                place.append(empty)
            if is_last:
                place[index] = value
            place = place[index]
        elif isinstance(place, dict):
            if is_last:
                place[part] = value
            place = place.setdefault(part, empty)
        else:
            raise SceneError(where, f"got {shown(place)}", f"a table with the key {part}")


def _parse_value(text: str, key: str, value_text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {value_text.strip()}")
        if list(parsed) != ["value"]:
            raise ValueError("more than one value")
    except (ValueError, RecursionError) as error:
        what, _ = _parted(str(error))
        expected = "a value in TOML syntax"
        if re.fullmatch(r"[\w./-]+", value_text.strip()):
            expected += f", text in quotes as in '{key}=\"{value_text.strip()}\"'"
        raise SceneError(f"--set {shown(text)}", what, expected) from None
    return parsed["value"]
