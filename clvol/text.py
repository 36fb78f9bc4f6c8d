"""Makes text from outside (files, names, keys, drivers) safe to print on a terminal."""

from __future__ import annotations

import re

_LONGEST = 1500  # characters in one part of a message


def printable(text: object) -> str:
    """``text`` on one line. Characters that could control a terminal or reverse the reading direction become
    escapes (``\\x1b``, ``\\u202e``), and so do bytes that are not UTF-8 (``\\xff``)."""
    text = str(text)
    return text if text.isprintable() else "".join(map(_shown, text))


def printable_lines(text: str) -> str:
    """Like ``printable``, but keeps line breaks."""
    return "\n".join(printable(line) for line in text.split("\n"))


def one_line(text: object) -> str:
    """``text`` as a part of a one-line message: printable, with each run of white space replaced by one blank, and
    shortened in the middle if it is very long."""
    text = str(text)
    if len(text) > _LONGEST:
        half = _LONGEST // 2
        text = f"{text[:half]} … {text[-half:]}"
    return printable(" ".join(text.split()))


def json_escaped(text: str) -> str:
    """JSON ``text`` in which every character that is not printable is a JSON escape. It represents the same value,
    and line breaks between values stay."""
    return text if text.isprintable() else _UNSEEN.sub(_json_escape, text)


def without_surrogates(text: str) -> str:
    """``text`` with every lone surrogate (from a name that is not UTF-8) replaced by U+FFFD, so that UTF-8 can
    encode it."""
    return re.sub("[\ud800-\udfff]", "\ufffd", text)


_UNSEEN = re.compile(r"[^ -~\n]")  # candidates: those that are not printable become escapes


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
