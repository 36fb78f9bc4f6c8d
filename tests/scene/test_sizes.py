"""Sizes of memory as text."""

from __future__ import annotations

import pytest

from clvol.scene.sizes import format_size, parse_size


@pytest.mark.parametrize(
    ("text", "size"),
    [("1", 1), ("96 MiB", 96 * 2**20), ("2GB", 2 * 10**9), ("1.5 kib", 1536), (" 7 B ", 7),
     ("1TiB", 2**40)],
)
def test_sizes_with_and_without_units(text, size):
    assert parse_size(text) == size


@pytest.mark.parametrize(
    "text", ["", "MiB", "-1", "0", "0.1 B", "1 XB", "1e9", "nan", "1 2", "inf"]
)
def test_what_is_no_size_is_refused(text):
    with pytest.raises(ValueError):
        parse_size(text)


@pytest.mark.parametrize(
    ("size", "text"),
    [(5, "5 B"), (2048, "2.0 KiB"), (3 * 2**30, "3.0 GiB"), (2**50, "1048576.0 GiB")],
)
def test_sizes_for_people(size, text):
    assert format_size(size) == text
