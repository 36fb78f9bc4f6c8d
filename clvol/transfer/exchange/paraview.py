"""Colour presets of ParaView: JSON with RGBPoints and Points, as its colour map editor imports and exports."""

from __future__ import annotations

from typing import Any

import numpy as np

from clvol.errors import SceneError
from clvol.transfer.color import linear_to_srgb
from clvol.transfer.exchange.imported import Imported
from clvol.transfer.exchange.labels import label_knots
from clvol.transfer.exchange.sampled import COLOR_ERROR, Function, straightened, without_needless
from clvol.transfer.exchange.text_files import in_unit, numbers
from clvol.transfer.exchange.vtk_nodes import Nodes, color_knots, opacity_knots

EXPECTED = "a colour preset of ParaView (JSON)"
_SPACES = {"rgb": "RGB", "hsv": "HSV", "lab": "Lab", "cielab": "Lab", "diverging": "Diverging", "step": "Step"}
_REFUSED = {  # properties that change what values mean
    "UseLogScale": "a linear scale",
    "UseBelowRangeColor": "no colour of its own below the range",
    "UseAboveRangeColor": "no colour of its own above the range",
}
_UNIT = "ScalarOpacityUnitDistance"


def read_presets(data: Any, where: str, entry: str | None) -> Imported:
    """The preset called ``entry`` among those of a file, parsed as ``data``; the only one if ``entry`` is None.

    NanColor is not used, since NaN is transparent. SceneError for a logarithmic scale, for colours of their own outside
    the range, and for the colour space CIEDE2000.
    """
    preset, where = _chosen(data, where, entry)
    for key, expected in _REFUSED.items():
        if preset.get(key):
            raise SceneError(f"{where}: {key}", f"got {preset[key]!r}"[:80], expected)
    if preset.get("RGBPoints") is None and preset.get("IndexedColors") is not None:
        return _indexed(preset, where)
    rows = numbers(preset.get("RGBPoints"), 4, f"{where}: RGBPoints")
    in_unit(rows[:, 1:], f"{where}: RGBPoints", "component")
    stated = preset.get("ColorSpace", "RGB")
    space = _SPACES.get(str(stated).lower())
    if space is None:
        raise SceneError(f"{where}: ColorSpace", f"got {stated!r}"[:80], "RGB, HSV, Lab, Diverging or Step")
    nodes = Nodes.ordered(rows, 3)
    if space == "Step":  # each colour holds up to the next value
        nodes = Nodes(nodes.values, nodes.table, np.zeros(len(nodes.values)), np.ones(len(nodes.values)))
    colors = color_knots(nodes, space, bool(preset.get("HSVWrap", True)))
    opacities = None
    if preset.get("Points") is not None:
        curve = numbers(preset["Points"], 4, f"{where}: Points")
        in_unit(curve[:, 1:], f"{where}: Points", "opacity, midpoint or sharpness")
        opacities = opacity_knots(Nodes.ordered(curve, 1))
    return Imported(where, colors, opacities, _unit(preset, where))


def _unit(preset: dict[str, Any], where: str) -> float | None:
    unit = preset.get(_UNIT)
    if unit is None:
        return None
    length = float(numbers([unit], 1, f"{where}: {_UNIT}")[0, 0])
    if length <= 0.0:
        raise SceneError(f"{where}: {_UNIT}", f"got {length:g}", "a length greater than 0")
    return length


def _chosen(data: Any, where: str, entry: str | None) -> tuple[dict[str, Any], str]:
    presets = data if isinstance(data, list) else [data]
    found = [preset for preset in presets if isinstance(preset, dict) and {"RGBPoints", "IndexedColors"} & set(preset)]
    if not found:
        raise SceneError(where, "neither RGBPoints nor IndexedColors", EXPECTED)
    names = [str(preset.get("Name", k)) for k, preset in enumerate(found)]
    if entry is None and len(found) == 1:
        return found[0], where
    same = [preset for preset, name in zip(found, names) if name == entry]
    if len(same) == 1:
        return same[0], f"{where}: {entry}"
    listed = ", ".join(map(repr, names[:12])) + (", …" if len(names) > 12 else "")
    what = f"{len(found)} presets" if entry is None else f"entry = {entry!r} among {len(found)} presets"
    raise SceneError(where, f"{what}: {listed}", "transfer_function.entry = the name of one of them")


def _indexed(preset: dict[str, Any], where: str) -> Imported:
    """Colours of annotated values: whole numbers, each from half below to half above."""
    colors = numbers(preset["IndexedColors"], 3, f"{where}: IndexedColors")
    in_unit(colors, f"{where}: IndexedColors", "component")
    annotations = preset.get("Annotations") or []
    texts = annotations[::2] if isinstance(annotations, list) else []
    try:
        labels = [int(text) for text in texts] or list(range(len(colors)))
    except (TypeError, ValueError):
        raise SceneError(f"{where}: Annotations", "values that are texts", "whole numbers as values") from None
    opacities = np.ones(len(labels))
    if preset.get("IndexedOpacities"):
        stated = numbers(preset["IndexedOpacities"], 1, f"{where}: IndexedOpacities")[:, 0]
        opacities = in_unit(np.resize(stated, len(labels)), f"{where}: IndexedOpacities", "opacity")
    # ParaView takes the colours in turn.
    return label_knots(where, labels, colors[np.arange(len(labels)) % len(colors)], opacities)


def preset_of(function: Function, name: str) -> list[dict[str, Any]]:
    """The content of a file with one preset, in the colour space RGB."""
    values, encoded = rgb_points(function)
    curve = without_needless((function.values, function.opacities[:, None]))
    points = [[float(value), float(opacity), 0.5, 0.0] for value, (opacity,) in zip(*curve)]
    return [
        {
            "Name": name,
            "Creator": "clvol",
            "ColorSpace": "RGB",
            "NanColor": [0.0, 0.0, 0.0],
            "NanOpacity": 0.0,
            _UNIT: function.opacity_unit,
            "RGBPoints": [number for value, color in zip(values, encoded) for number in (float(value), *color)],
            "Points": [number for point in points for number in point],
        }
    ]


def rgb_points(function: Function) -> tuple[np.ndarray, list[list[float]]]:
    """Values and sRGB-encoded colours between which tools that interpolate encoded colours see the function's, to
    within ``COLOR_ERROR``.
    """
    at, colors = without_needless((function.values, function.colors))
    values: list[float] = []
    encoded: list[np.ndarray] = []
    for i in range(len(at) - 1):
        ends = colors[i : i + 2]
        parameters = np.array([0.0, 1.0])
        if at[i] < at[i + 1] and not np.array_equal(*ends):

            def chord(u: np.ndarray, ends: np.ndarray = ends) -> np.ndarray:
                return linear_to_srgb(ends[0] + (ends[1] - ends[0]) * u[:, None])

            parameters = straightened(chord, parameters, COLOR_ERROR, colors=False)
        for u in parameters[:-1]:
            values.append(float(at[i] + (at[i + 1] - at[i]) * u))
            encoded.append(linear_to_srgb(ends[0] + (ends[1] - ends[0]) * u))
    values.append(float(at[-1]))
    encoded.append(linear_to_srgb(colors[-1]))
    return np.array(values), np.clip(encoded, 0.0, 1.0).tolist()
