"""Voxels written as text: decimal numbers, or hexadecimal bytes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from clvol.errors import VolumeError

_BLOCK = 1 << 16
_LONGEST = 400  # characters of a number
_BLANKS = b" \t\r\n\v\f"


def read_numbers(file: Any, target: np.ndarray, where: str) -> None:
    """Fills ``target`` (1-D, native) with the numbers of ``file`` from its current position.

    Numbers are separated by blanks or commas. VolumeError unless there are exactly enough and the type holds them.
    """
    at = 0
    for words in _words(file, where):
        if at + len(words) > target.size:
            raise VolumeError(where, f"{at + len(words)} numbers or more", f"{target.size} numbers")
        target[at : at + len(words)] = _parsed(words, target.dtype, where)
        at += len(words)
    if at != target.size:
        raise VolumeError(where, f"{at} numbers", f"{target.size} numbers")


def _words(file: Any, where: str) -> Iterator[list[bytes]]:
    rest = b""
    while block := file.read(_BLOCK):
        text = (rest + block).replace(b",", b" ")
        words = text.split()
        rest = words.pop() if words and text[-1:] not in _BLANKS else b""
        if len(rest) > _LONGEST or any(len(word) > _LONGEST for word in words):
            raise VolumeError(where, f"more than {_LONGEST} characters without a blank", "numbers")
        if words:
            yield words
    if rest:
        yield [rest]


def _parsed(words: list[bytes], dtype: np.dtype, where: str) -> np.ndarray:
    texts = np.array(words)
    try:
        if dtype.kind in "iu" and dtype.itemsize == 8:
            try:
                return texts.astype(dtype)  # float64 would round them
            except (ValueError, OverflowError):
                pass
        numbers = texts.astype(np.float64)
    except ValueError as error:
        raise VolumeError(where, f"no number ({error})"[:200], "decimal numbers") from None
    with np.errstate(all="ignore"):
        found = numbers.astype(dtype)
    if dtype.kind in "iu" and not np.array_equal(found, numbers):
        raise VolumeError(where, "numbers outside the type", f"whole numbers of {dtype}")
    return found


def hex_bytes(file: Any, where: str) -> Iterator[bytes]:
    """The bytes that ``file`` holds as two hexadecimal digits each; blanks may separate any two digits."""
    rest = b""
    while block := file.read(_BLOCK):
        digits = rest + block.translate(None, _BLANKS)
        even = len(digits) // 2 * 2
        digits, rest = digits[:even], digits[even:]
        try:
            decoded = bytes.fromhex(digits.decode("ascii"))
        except ValueError:
            raise VolumeError(where, "encoding hex with other bytes", "hexadecimal digits") from None
        if decoded:
            yield decoded
    if rest:
        raise VolumeError(where, "encoding hex with half a byte at the end", "two digits a byte")
