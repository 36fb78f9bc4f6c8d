"""Text that came from elsewhere (files, names, keys, drivers), made fit for a terminal."""

from __future__ import annotations

import re

_LONGEST = 1500  # characters that one part of a message may have


def printable(text: object) -> str:
    """``text`` on one line, with whatever could steer a terminal or turn the reading direction
    round as an escape (``\\x1b``, ``\\u202e``); bytes that are no UTF-8 as ``\\xff``."""
    text = str(text)
    return text if text.isprintable() else "".join(map(_shown, text))


def printable_lines(text: str) -> str:
    """As ``printable``, but lines stay lines."""
    return "\n".join(printable(line) for line in text.split("\n"))


def one_line(text: object) -> str:
    """``text`` as a part of an error's only line: printable, white space as one blank each, and
    not endless."""
    text = str(text)
    if len(text) > _LONGEST:
        half = _LONGEST // 2
        text = f"{text[:half]} … {text[-half:]}"
    return printable(" ".join(text.split()))


def json_escaped(text: str) -> str:
    """JSON ``text`` with every character that is not printable as JSON's own escape; it stands for
    the same value as before. Line ends between values stay."""
    return text if text.isprintable() else _UNSEEN.sub(_json_escape, text)


def without_surrogates(text: str) -> str:
    """``text`` as UTF-8 can hold it: what is none (of a name that is not UTF-8) as U+FFFD."""
    return re.sub("[\ud800-\udfff]", "\ufffd", text)


_UNSEEN = re.compile(r"[^ -~\n]")  # and of those the ones that are not printable


def _shown(character: str) -> str:
    code = ord(character)
    if character.isprintable():
        return character
    if 0xDC80 <= code <= 0xDCFF:  # a byte of a name that is not UTF-8
        return f"\\x{code - 0xDC00:02x}"
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _json_escape(match: re.Match) -> str:
    character = match.group()
    if character.isprintable():
        return character
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[i] << 8 | units[i + 1]:04x}" for i in range(0, len(units), 2))
