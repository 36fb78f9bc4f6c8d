"""Reading files of other tools as text, JSON and numbers, with errors that name the place."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import SceneError

LARGEST_FILE = 16 * 2**20


def read_text(path: Path, expected: str) -> str:
    """The text of a file in UTF-8; SceneError for a file that is none, or larger than 16 MiB."""
    try:
        if os.path.exists(path) and not os.path.isfile(path):
            raise SceneError(str(path), "a folder, or not a regular file", expected)
        with path.open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise SceneError(str(path), "no such file", expected) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SceneError(str(path), f"cannot be read ({reason})", expected) from None
    if len(raw) > LARGEST_FILE:
        raise SceneError(str(path), f"more than {LARGEST_FILE} bytes", expected)
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        what = f"byte {raw[error.start]:#04x} at {error.start}"
        raise SceneError(str(path), what, f"{expected}, text in UTF-8") from None


def parse_json(text: str, where: str, expected: str) -> Any:
    """The value of a JSON text; SceneError that names the line."""
    try:
        return json.loads(text, parse_constant=_no_constant)
    except json.JSONDecodeError as error:
        raise SceneError(f"{where}: line {error.lineno}", error.msg, expected) from None
    except (ValueError, RecursionError) as error:
        raise SceneError(where, f"no JSON ({str(error)[:80] or 'nested too deeply'})", expected) from None


def _no_constant(name: str) -> None:
    raise ValueError(f"the number {name}")


def numbers(value: Any, width: int, where: str, least: int = 1) -> np.ndarray:
    """``value``, a list of numbers whose length is a multiple of ``width``, as rows; SceneError for anything else.

    There have to be at least ``least`` rows.
    """
    expected = f"a list of {width} numbers for each of {least} points or more"
    if not isinstance(value, list) or len(value) % width or len(value) < width * least:
        what = f"a list of {len(value)}" if isinstance(value, list) else f"got {type(value).__name__}"
        raise SceneError(where, what, expected)
    for i, number in enumerate(value):
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not _is_finite(number):
            raise SceneError(f"{where}.{i}", f"got {number!r}"[:80], "a finite number")
    return np.array(value, dtype=float).reshape(-1, width)


def in_unit(table: np.ndarray, where: str, what: str) -> np.ndarray:
    """``table``; SceneError unless all its numbers are from 0 to 1."""
    bad = table[(table < 0.0) | (table > 1.0)]
    if bad.size:
        raise SceneError(where, f"got the {what} {bad[0]:g}", "numbers from 0 to 1")
    return table


def parse_numbers(words: Sequence[str], where: str) -> list[float]:
    """The words as finite numbers; SceneError for any other."""
    found = []
    for word in words:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise SceneError(where, f"got {word!r}"[:80], "a finite number")
        found.append(number)
    return found


def _is_finite(number: int | float) -> bool:
    try:
        return math.isfinite(number)
    except OverflowError:
        return False
