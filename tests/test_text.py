"""Nothing that came from elsewhere steers a terminal."""

from __future__ import annotations

import json

import pytest
from helpers.terminal_text import is_harmless

from clvol.cli.console import to_json
from clvol.errors import SceneError, VolumeError
from clvol.text import one_line, printable, printable_lines, without_surrogates

HOSTILE = [
    "\x1b[31m", "\x1b]0;title\x07", "\x9b31m", "\x7f", "a\rb", "a\x08b", "\0", "\u202eexe.txt",
    "\u2066x\u2069", "\u200b", "\ufeff", "\u2028", "\x85", "\udcff", "\U000e0001", "line\nline",
]  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE)
def test_what_steers_a_terminal_is_escaped(text):
    assert is_harmless(printable(text)) and printable(text) != text
    for error in (SceneError(text, "x", "y"), SceneError("x", text, "y"), VolumeError("x", "y", text)):
        assert is_harmless(str(error))


def test_what_can_be_read_stays_as_it_is():
    for text in ("plain", "größe µm 日本語 e\u0301", "C:\\x", "a 'b' \"c\" … –"):
        assert printable(text) == text and one_line(text) == text
    assert printable("\x1b\u202e\udcfe") == "\\x1b\\u202e\\xfe"
    assert printable_lines("a\n\x1bb") == "a\n\\x1bb"
    assert one_line("two\n lines\t") == "two lines"
    assert len(one_line("x" * 10**7)) < 2000


@pytest.mark.parametrize("text", HOSTILE)
def test_json_says_the_same_with_escapes(text):
    said = to_json({text: [text]})
    assert is_harmless(said.replace("\n", ""))
    assert json.loads(said) == {text: [text]}
    said.encode("utf-8")


def test_headers_are_utf_8():
    assert without_surrogates("v\udcff.npy") == "v\ufffd.npy"
