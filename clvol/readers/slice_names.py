"""Finding the slices of one stack in a folder, and their order, by file names."""

from __future__ import annotations

import math
import re
from collections import Counter
from pathlib import Path
from typing import Any

from clvol.errors import VolumeError
from clvol.readers.options import Key, ReadOptions

_NUMBER = re.compile(r"(\d+)")
# The letters before a number that does not count slices: img_t001_c2_z07.
_LABELS: dict[str, Key] = {
    "c": "channel", "ch": "channel", "channel": "channel", "w": "channel",
    "t": "time", "time": "time", "tp": "time", "frame": "time",
}  # fmt: skip
_SLICE_LABELS = ("z", "s", "sl", "slice", "plane")


def natural(name: str) -> list[Any]:
    """A sort key that compares numbers in names by value: sl_2 before sl_10."""
    parts = _NUMBER.split(name.casefold())
    return [(1, int(part), "") if part.isdecimal() else (0, 0, part) for part in parts] + [name]


def one_stack(path: Path, files: list[Path], options: ReadOptions) -> list[Path]:
    """The files of the selected stack, in order.

    Names that differ in more than numbers belong to several stacks, and so do names with several numbers of which
    every combination exists.
    """
    patterns: dict[str, list[Path]] = {}
    for file in files:
        patterns.setdefault(_NUMBER.sub("#", file.name), []).append(file)
    if len(patterns) > 1 and any(len(group) > 1 for group in patterns.values()):
        names = list(patterns)
        shown = [f'"{name}" ({len(patterns[name])} files)' for name in names]
        files = patterns[names[options.choose("series", str(path), names, shown=shown)]]
    return _one_of_each(path, sorted(files, key=lambda file: natural(file.name)), options)


def _one_of_each(path: Path, files: list[Path], options: ReadOptions) -> list[Path]:
    """If names count slices and something else, the files with one value of everything else."""
    numbers = _numbers(files)
    varying = _varying(numbers)
    counts = [len({one[k] for one in numbers}) for k in varying]
    if len(varying) < 2 or math.prod(counts) != len(files):
        return files
    labels = [_label(files[0].name, k) for k in varying]
    slices = next((k for k, label in zip(varying, labels) if label in _SLICE_LABELS), varying[-1])
    for k, label in zip(varying, labels):
        if k == slices:
            continue
        key = _LABELS.get(label, "series")
        if key in options.consulted:
            what = f"names such as {files[0].name} that count several things"
            raise VolumeError(str(path), what, "a folder for each stack")
        values = sorted({one[k] for one in numbers})
        wanted = values[options.choose(key, str(path), [None] * len(values), numbers=values)]
        kept = [(file, one) for file, one in zip(files, numbers) if one[k] == wanted]
        files, numbers = [file for file, _ in kept], [one for _, one in kept]
    return files


def warn_of_gaps(files: list[Path], options: ReadOptions) -> None:
    """Warns of numbers missing between the first and the last file, if a single number varies."""
    numbers = _numbers(files)
    varying = _varying(numbers)
    if len(varying) != 1:
        return
    counted = [one[varying[0]] for one in numbers]
    steps = [after - before for before, after in zip(counted, counted[1:])]
    usual = min(steps)
    for k, step in enumerate(steps):
        if step != usual and Counter(steps)[usual] >= len(steps) / 2:
            options.warn(
                f"between {files[k].name} and {files[k + 1].name} slices may be missing; "
                "they are taken as neighbours"
            )
            return


def _numbers(files: list[Path]) -> list[list[int]]:
    return [[int(part) for part in _NUMBER.findall(file.name)] for file in files]


def _varying(numbers: list[list[int]]) -> list[int]:
    """The positions of the numbers that vary between names; none if names differ otherwise."""
    if len({len(one) for one in numbers}) != 1:
        return []
    return [k for k in range(len(numbers[0])) if len({one[k] for one in numbers}) > 1]


def _label(name: str, number: int) -> str:
    """The letters directly before a number of the name."""
    before = _NUMBER.split(name.casefold())[2 * number]
    found = re.search(r"([a-z]+)[ _=-]*$", before)
    return found[1] if found else ""
