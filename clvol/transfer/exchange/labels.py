"""Colour tables of labels: 3D Slicer's (.ctbl, .txt) and ITK-SNAP's label descriptions (.txt, .label).

A label holds from half below to half above its number; what no label covers is transparent.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from clvol.errors import SceneError
from clvol.transfer.color import linear_to_srgb, srgb_to_linear
from clvol.transfer.exchange.imported import Imported
from clvol.transfer.exchange.sampled import Function
from clvol.transfer.exchange.text_files import parse_numbers

EXPECTED = "a colour table of 3D Slicer or ITK-SNAP, a label in each line"
LARGEST_LABELS = 16000  # each takes up to four points
_LARGEST_LABEL = 2**53
_SNAP = re.compile(r'\s*(?P<numbers>[-+.\deE\s]+?)\s+"(?P<name>[^"]*)"\s*$')


def read_labels(text: str, where: str) -> Imported:
    """The labels of a table as a transfer function."""
    return label_knots(where, *parse_labels(text, where))


def parse_labels(text: str, where: str) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Labels [n], their sRGB-encoded colours [n, 3] and opacities [n] of a table.

    Alpha is opacity; labels that ITK-SNAP does not show are transparent. SceneError for what is no table.
    """
    labels: list[int] = []
    colors: list[list[float]] = []
    opacities: list[float] = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        place = f"{where}: line {number}"
        label, color, opacity = _snap(line, place) or _slicer(line, place)
        if len(labels) >= LARGEST_LABELS:
            raise SceneError(place, f"more than {LARGEST_LABELS} labels", f"at most {LARGEST_LABELS}")
        labels.append(label)
        colors.append(color)
        opacities.append(opacity)
    if not labels:
        raise SceneError(where, "no label", EXPECTED)
    if len(set(labels)) < len(labels):
        twice = next(label for k, label in enumerate(labels) if label in labels[:k])
        raise SceneError(where, f"label {twice} twice", "each label once")
    return labels, np.array(colors), np.array(opacities)


def _snap(line: str, place: str) -> tuple[int, list[float], float] | None:
    """IDX R G B A VIS MSH "NAME", with A from 0 to 1; None for a line of another form."""
    match = _SNAP.match(line)
    words = match["numbers"].split() if match else []
    if len(words) != 7:
        return None
    label, *color, alpha, visible, _ = parse_numbers(words, place)
    return _label(label, place), _bytes(color, place), _share(alpha, place) if visible else 0.0


def _slicer(line: str, place: str) -> tuple[int, list[float], float]:
    """LABEL NAME R G B A, with A from 0 to 255; blanks in names are underscores."""
    words = line.split()
    if len(words) < 6:
        raise SceneError(place, f"got {line.strip()!r}"[:100], "LABEL NAME R G B A, or IDX R G B A VIS MSH \"NAME\"")
    label, *color, alpha = parse_numbers([words[0], *words[-4:]], place)
    return _label(label, place), _bytes(color, place), _bytes([alpha], place)[0]


def _label(number: float, place: str) -> int:
    if number != int(number) or abs(number) > _LARGEST_LABEL:
        raise SceneError(place, f"got the label {number:g}", "a whole number")
    return int(number)


def _bytes(values: Sequence[float], place: str) -> list[float]:
    if not all(0 <= value <= 255 for value in values):
        raise SceneError(place, f"got {list(values)}", "numbers from 0 to 255")
    return [value / 255 for value in values]


def _share(value: float, place: str) -> float:
    if not 0 <= value <= 1:
        raise SceneError(place, f"got the opacity {value:g}", "a number from 0 to 1")
    return value


def label_knots(where: str, labels: Sequence[int], encoded: np.ndarray, opacities: np.ndarray) -> Imported:
    """Steps for ``labels`` with colours [n, 3] (sRGB-encoded) and opacities [n]. SceneError for a label given twice."""
    order = np.argsort(labels, kind="stable")
    values: list[float] = []
    rows: list[np.ndarray] = []
    linear = srgb_to_linear(encoded)
    for k, i in enumerate(order):
        low, high = labels[i] - 0.5, labels[i] + 0.5
        row = np.array([*linear[i], opacities[i]])
        clear = np.array([*linear[i], 0.0])
        if k and labels[order[k - 1]] == labels[i]:
            raise SceneError(where, f"label {labels[i]} twice", "each label once")
        if not k or values[-1] < low:
            values += [low] if not k else [values[-1], low]
            rows += [clear] if not k else [np.array([*rows[-1][:3], 0.0])] * 2
        values += [low, high]
        rows += [row, row]
        if k == len(order) - 1:
            values.append(high)
            rows.append(clear)
    table, at = np.array(rows), np.array(values)
    return Imported(where, (at, table[:, :3]), (at, table[:, 3:]))


def slicer_table(function: Function, name: str, where: str) -> str:
    """The text of a .ctbl file with the labels of ``function``; SceneError unless it is a table of labels."""
    first, last = float(function.values[0]), float(function.values[-1])
    labels = np.arange(np.ceil(first), np.floor(last) + 1) if last - first <= LARGEST_LABELS else np.zeros(0)
    inside = labels[:, None] + np.array([-0.49, 0.0, 0.49])
    opacities, colors = function.opacity(inside), function.color(inside)
    is_seen = opacities[:, 1] > 0
    is_constant = (np.ptp(opacities, axis=1) < 1e-9).all() and (np.ptp(colors, axis=1)[is_seen] < 1e-9).all()
    if not labels.size or not is_constant or function.opacity([first - 1.0, last + 1.0]).any():
        expected = "steps half-way between whole numbers, as of a label table; or .json, .vp or .vp.json"
        raise SceneError(where, "a transfer function that is no table of labels", expected)
    lines = [f"# {name}: {len(labels)} labels, written by clvol", "# LABEL NAME R G B A"]
    for label, opacity, color in zip(labels, opacities[:, 1], colors[:, 1]):
        red, green, blue = np.rint(linear_to_srgb(color) * 255).astype(int)
        lines.append(f"{int(label)} label_{int(label)} {red} {green} {blue} {round(float(opacity) * 255)}")
    return "\n".join(lines) + "\n"
