"""Volume properties of 3D Slicer: .vp (nine lines of text) and .vp.json (since version 5.9).

Of a volume property, colours and scalar opacity are read; opacities refer to scalarOpacityUnitDistance, which is 1 in
.vp files. Slicer's points are those of VTK, sRGB-encoded and linear in RGB between.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clvol.errors import SceneError
from clvol.transfer.exchange.imported import Imported
from clvol.transfer.exchange.paraview import rgb_points
from clvol.transfer.exchange.sampled import OPACITY_ERROR, Function, straightened, without_needless
from clvol.transfer.exchange.text_files import in_unit, numbers, parse_numbers
from clvol.transfer.exchange.vtk_nodes import Nodes, color_knots, opacity_knots

EXPECTED = "a volume property of 3D Slicer"
_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/main/Modules/Loadable/VolumeRendering/Resources/Schema/"
    "volume-property-schema-v1.0.0.json#"
)
_LINES = 9  # interpolation, shade, diffuse, ambient, specular, power, scalar opacity, gradient opacity, colour
_LEAST_STEP = 1e-6  # between points at one value, which Slicer does not keep apart, in parts of the range
_GRADIENT = "its gradient opacity is not used; a scene states one in [gradient_opacity]"


def read_vp(text: str, where: str) -> Imported:
    """The transfer function of a .vp file. SceneError for a file that is none."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    if len(lines) < _LINES:
        raise SceneError(where, f"{len(lines)} lines", f"{EXPECTED}, {_LINES} lines")
    opacity = _counted(lines[6], 2, f"{where}: scalar opacity")
    colors = _counted(lines[8], 4, f"{where}: colours")
    gradient = _counted(lines[7], 2, f"{where}: gradient opacity") if lines[7].strip() else np.ones((1, 2))
    return _imported(where, colors, opacity, gradient, 1.0)


def _counted(line: str, width: int, where: str) -> np.ndarray:
    words = line.split()
    count, *rest = parse_numbers(words, where) if words else [0.0]
    if count != len(rest):
        raise SceneError(where, f"{len(rest)} numbers after the count {count:g}", f"{EXPECTED}: as many as counted")
    return numbers(rest, width, where)


def read_vp_json(data: Any, where: str) -> Imported:
    """The transfer function of the first component of the first volume property of a .vp.json file."""
    try:
        component = data["volumeProperties"][0]["components"][0]
        color, opacity = component["rgbFunction"], component["scalarOpacity"]
        gradient = component.get("gradientOpacity")
        unit = component.get("scalarOpacityUnitDistance", 1.0)
        ignores = component.get("disableGradientOpacity", False)
    except (KeyError, IndexError, TypeError, AttributeError):
        raise SceneError(where, "no volumeProperties with a colour and an opacity function", EXPECTED) from None
    space = str(color.get("colorSpace", "rgb")) if isinstance(color, dict) else "rgb"
    if space.lower() != "rgb":
        raise SceneError(f"{where}: colorSpace", f"got {space!r}"[:80], "rgb")
    length = float(numbers([unit], 1, f"{where}: scalarOpacityUnitDistance")[0, 0])
    if length <= 0.0:
        raise SceneError(f"{where}: scalarOpacityUnitDistance", f"got {length:g}", "a length greater than 0")
    colors = _listed(color, "color", 3, f"{where}: rgbFunction")
    opacities = _listed(opacity, "y", 1, f"{where}: scalarOpacity")
    plain = np.ones((1, 2)) if gradient is None or ignores else _listed(gradient, "y", 1, f"{where}: gradientOpacity")
    return _imported(where, colors, opacities, plain, length)


def _listed(function: Any, key: str, width: int, where: str) -> np.ndarray:
    """Rows of x, the numbers of ``key``, midpoint and sharpness."""
    points = function.get("points") if isinstance(function, dict) else None
    if not isinstance(points, list) or not all(isinstance(point, dict) for point in points):
        raise SceneError(where, "no list of points", EXPECTED)
    flat: list[Any] = []
    for point in points:
        value = point.get(key, [0.0] * width if width > 1 else 0.0)
        row = [point.get("x", 0.0), *(value if isinstance(value, list) else [value])]
        row += [point.get("midpoint", 0.5), point.get("sharpness", 0.0)]
        if len(row) != width + 3:
            raise SceneError(where, f"got {key} = {value!r}"[:80], f"{width} numbers")
        flat += row
    return numbers(flat, width + 3, where)


def _imported(
    where: str, colors: np.ndarray, opacities: np.ndarray, gradient: np.ndarray, unit: float
) -> Imported:
    in_unit(colors[:, 1:], f"{where}: colours", "component, midpoint or sharpness")
    in_unit(opacities[:, 1:], f"{where}: scalar opacity", "opacity, midpoint or sharpness")
    colors, opacities = _steps_joined(colors), _steps_joined(opacities)
    notes = () if (gradient[:, 1] == 1.0).all() else (_GRADIENT,)
    return Imported(
        where, color_knots(Nodes.ordered(colors, 3)), opacity_knots(Nodes.ordered(opacities, 1)), unit, notes=notes
    )


def vp_of(function: Function) -> str:
    """The text of a .vp file, whose opacities refer to a length of 1."""
    colors, opacities = _points(function, 1.0)
    lines = ["1", "0", "0.7", "0.1", "0.2", "20"]
    for rows in (opacities, np.array([[0.0, 1.0]]), colors):
        words = [repr(float(number)) for number in rows.ravel()]
        lines.append(" ".join([str(len(words)), *words]))
    return "\n".join(lines) + "\n"


def vp_json_of(function: Function) -> dict[str, Any]:
    """The content of a .vp.json file."""
    colors, opacities = _points(function, function.opacity_unit)
    plain = {"midpoint": 0.5, "sharpness": 0.0}
    first, last = float(function.values[0]), float(function.values[-1])
    component = {
        "componentWeight": 1.0,
        "shade": False,
        "lighting": {"diffuse": 0.7, "ambient": 0.1, "specular": 0.2, "specularPower": 20.0},
        "disableGradientOpacity": True,
        "scalarOpacityUnitDistance": function.opacity_unit,
        "rgbFunction": {
            "type": "colorFunction",
            "points": [{"x": x, "color": color, **plain} for x, *color in colors.tolist()],
        },
        "scalarOpacity": {
            "type": "piecewiseLinearFunction",
            "points": [{"x": x, "y": y, **plain} for x, y in opacities.tolist()],
        },
        "gradientOpacity": {"type": "piecewiseLinearFunction", "points": [{"x": 0.0, "y": 1.0, **plain}]},
    }
    properties = {"effectiveRange": [first, last], "interpolationType": "linear", "components": [component]}
    return {"@schema": _SCHEMA, "volumeProperties": [properties]}


def _points(function: Function, unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows of value and sRGB-encoded colour, and of value and opacity over the length ``unit``; values ascend strictly.

    Opacities of another unit are no longer linear between points: to within ``OPACITY_ERROR``.
    """
    values, encoded = rgb_points(function)
    colors = np.column_stack([values, encoded])
    at, table = without_needless((function.values, function.opacities[:, None]))
    rows = []
    for i in range(len(at) - 1):
        ends = table[i : i + 2]

        def curve(u: np.ndarray, ends: np.ndarray = ends) -> np.ndarray:
            opacity = ends[0] + (ends[1] - ends[0]) * u[:, None]
            if unit == function.opacity_unit:
                return opacity
            with np.errstate(divide="ignore"):
                return -np.expm1(np.log1p(-opacity) * (unit / function.opacity_unit))

        flat = at[i] == at[i + 1] or unit == function.opacity_unit
        parameters = np.array([0.0, 1.0])
        if not flat:
            parameters = straightened(curve, parameters, OPACITY_ERROR, colors=False)
        kept = parameters if i == len(at) - 2 else parameters[:-1]
        rows.append(np.column_stack([at[i] + (at[i + 1] - at[i]) * kept, curve(kept)]))
    if not rows:
        end = table[:1] if unit == function.opacity_unit else 1.0 - (1.0 - table[:1]) ** (unit / function.opacity_unit)
        rows.append(np.column_stack([at[:1], end]))
    return _apart(colors), _apart(np.concatenate(rows))


def _steps_joined(rows: np.ndarray) -> np.ndarray:
    """``rows`` with points that are a millionth of the range apart at one value: a step (``_apart``)."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    near = np.diff(rows[:, 0]) <= 1.5 * _LEAST_STEP * (rows[-1, 0] - rows[0, 0])
    rows[:-1, 0] = np.where(near, rows[1:, 0], rows[:-1, 0])
    return rows


def _apart(rows: np.ndarray) -> np.ndarray:
    """``rows`` with the first of two points at one value moved down by a millionth of the range."""
    rows = rows.copy()
    least = _LEAST_STEP * (rows[-1, 0] - rows[0, 0])
    for i in range(len(rows) - 1):
        if rows[i, 0] == rows[i + 1, 0]:
            floor = rows[i - 1, 0] if i else -np.inf
            rows[i, 0] = max(rows[i, 0] - least, 0.5 * (floor + rows[i, 0])) if i else rows[i, 0] - max(least, 1e-6)
    return rows
