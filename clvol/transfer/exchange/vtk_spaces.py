"""Colours between two colours in VTK's colour spaces, sRGB-encoded in and out.

CIELAB is that of vtkMath: white (0.9505, 1, 1.089), four digits in the matrices, colours outside sRGB divided by their
largest component. "Diverging" is Moreland, "Diverging color maps for scientific visualization" (2009): CIELAB in polar
coordinates (M, s, h), with white between two saturated colours of different hues. Where hues are more than half a turn
apart, which versions of VTK treat differently (9.7 does not reach the second colour), they go the shorter way around.
"""

from __future__ import annotations

import math

import numpy as np

from clvol.transfer.color import linear_to_srgb, srgb_to_linear

_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
_WHITE = np.array([0.9505, 1.0, 1.089])
_CUT, _SLOPE, _SHIFT = 0.008856, 7.787, 16.0 / 116.0
_SATURATED = 0.05


def between(first: np.ndarray, last: np.ndarray, weight: np.ndarray, space: str, wrap: bool) -> np.ndarray:
    """Colours [m, 3] at the shares ``weight`` [m] of ``last``. ``wrap``: hues go the shorter way around."""
    t = weight[:, None]
    if space == "HSV":
        a, b = rgb_to_hsv(first), rgb_to_hsv(last)
        if wrap and abs(a[0] - b[0]) > 0.5:
            (a if a[0] > b[0] else b)[0] -= 1.0
        mixed = a * (1.0 - t) + b * t
        mixed[:, 0] = np.where(mixed[:, 0] < 0.0, mixed[:, 0] + 1.0, mixed[:, 0])
        found = hsv_to_rgb(mixed)
    elif space == "Lab":
        found = lab_to_rgb(rgb_to_lab(first) * (1.0 - t) + rgb_to_lab(last) * t)
    elif space == "Diverging":
        found = _diverging(first, last, weight)
    else:
        found = first * (1.0 - t) + last * t
    return np.clip(found, 0.0, 1.0)


def rgb_to_lab(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of sRGB-encoded colours [..., 3]."""
    v = srgb_to_linear(rgb) @ _TO_XYZ.T / _WHITE
    x, y, z = np.moveaxis(np.where(v > _CUT, np.cbrt(v), _SLOPE * v + _SHIFT), -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def lab_to_rgb(lab: np.ndarray) -> np.ndarray:
    """sRGB-encoded colours [..., 3] of CIELAB; outside sRGB divided by the largest component, then clipped."""
    y = (lab[..., 0] + 16.0) / 116.0
    v = np.stack([lab[..., 1] / 500.0 + y, y, y - lab[..., 2] / 200.0], axis=-1)
    xyz = np.where(v**3 > _CUT, v**3, (v - _SHIFT) / _SLOPE) * _WHITE
    rgb = linear_to_srgb(xyz @ _FROM_XYZ.T)
    return np.clip(rgb / np.maximum(rgb.max(axis=-1, keepdims=True), 1.0), 0.0, 1.0)


def rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    """Hue, saturation and value in [0, 1] of one colour [3]; the hue of a grey is 0."""
    low, high = float(rgb.min()), float(rgb.max())
    if high == low:
        return np.array([0.0, 0.0, high])
    r, g, b = (float(c) for c in rgb)
    spread = high - low
    hue = (g - b) / spread if r == high else 2 + (b - r) / spread if g == high else 4 + (r - g) / spread
    return np.array([(hue / 6.0) % 1.0, spread / high, high])


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    """Colours [..., 3] of hue, saturation and value in [0, 1]."""
    h, s, v = np.moveaxis(hsv, -1, 0)
    k = (np.array([5.0, 3.0, 1.0]) + 6.0 * h[..., None]) % 6.0
    return v[..., None] - (v * s)[..., None] * np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0)


def _diverging(first: np.ndarray, last: np.ndarray, weight: np.ndarray) -> np.ndarray:
    a, b = _msh(first), _msh(last)
    if a[1] > _SATURATED and b[1] > _SATURATED and _angle(a[2], b[2]) > 0.33 * math.pi:
        white = np.array([max(a[0], b[0], 88.0), 0.0, 0.0])
        lower = weight < 0.5
        out = np.empty((len(weight), 3))
        out[lower] = _msh_between(a, white, 2.0 * weight[lower])
        out[~lower] = _msh_between(white, b, 2.0 * weight[~lower] - 1.0)
        return out
    return _msh_between(a, b, weight)


def _msh_between(a: np.ndarray, b: np.ndarray, weight: np.ndarray) -> np.ndarray:
    a, b = a.copy(), b.copy()
    if a[1] < _SATURATED < b[1]:
        a[2] = _adjusted_hue(b, a[0])
    elif b[1] < _SATURATED < a[1]:
        b[2] = _adjusted_hue(a, b[0])
    b[2] -= 2.0 * math.pi * round((b[2] - a[2]) / (2.0 * math.pi))
    t = weight[:, None]
    m, s, h = np.moveaxis(a * (1.0 - t) + b * t, -1, 0)
    return lab_to_rgb(np.stack([m * np.cos(s), m * np.sin(s) * np.cos(h), m * np.sin(s) * np.sin(h)], axis=-1))


def _msh(rgb: np.ndarray) -> np.ndarray:
    lightness, a, b = rgb_to_lab(rgb)
    m = math.sqrt(lightness**2 + a**2 + b**2)
    s = math.acos(min(1.0, lightness / m)) if m > 0.001 else 0.0
    return np.array([m, s, math.atan2(b, a) if s > 0.001 else 0.0])


def _angle(a: float, b: float) -> float:
    turn = abs(a - b) % (2.0 * math.pi)
    return min(turn, 2.0 * math.pi - turn)


def _adjusted_hue(saturated: np.ndarray, m: float) -> float:
    """The hue of an unsaturated colour of magnitude ``m`` beside a saturated one."""
    if saturated[0] >= m - 0.1:
        return float(saturated[2])
    spin = saturated[1] * math.sqrt(m**2 - saturated[0] ** 2) / (saturated[0] * math.sin(saturated[1]))
    return float(saturated[2] + (spin if saturated[2] > -0.3 * math.pi else -spin))
