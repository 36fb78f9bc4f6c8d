"""Transfer functions by name, for ``preset = "..."`` in a scene.

"relative" presets place their points as fractions of the volume's value range: 0 is its lowest
finite value, 1 its highest. "hounsfield" presets place them in Hounsfield units (air -1000, water
0) and suit CT volumes whose values are Hounsfield units. Colours are sRGB-encoded. The
opacities refer to ``opacity_unit``; a scene that does not state one gets a 32nd of the volume's
shortest edge, so that a preset looks the same for any unit of length.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from clvol.errors import SceneError
from clvol.transfer.color import srgb_to_linear
from clvol.transfer.function import TransferFunction


@dataclass(frozen=True)
class Preset:
    """``points``: (position, opacity in [0, 1], (r, g, b) sRGB-encoded), positions ascending."""

    summary: str
    scale: str  # "relative" or "hounsfield"
    points: tuple[tuple[float, float, tuple[float, float, float]], ...]


PRESETS: dict[str, Preset] = {
    "grayscale": Preset(
        "a grey ramp over the whole range; the default",
        "relative",
        (
            (0.0, 0.0, (0.25, 0.25, 0.25)),
            (1.0, 0.5, (1.0, 1.0, 1.0)),
        ),
    ),
    "translucent": Preset(
        "a thin haze from blue to yellow that lets the far side through",
        "relative",
        (
            (0.0, 0.0, (0.10, 0.20, 0.60)),
            (0.25, 0.02, (0.20, 0.55, 0.85)),
            (0.6, 0.06, (0.85, 0.75, 0.45)),
            (1.0, 0.2, (1.0, 0.95, 0.75)),
        ),
    ),
    "surface": Preset(
        "opaque above the middle of the range",
        "relative",
        (
            (0.0, 0.0, (0.80, 0.62, 0.45)),
            (0.45, 0.0, (0.80, 0.62, 0.45)),
            (0.55, 0.9, (0.92, 0.85, 0.75)),
            (1.0, 0.98, (1.0, 1.0, 0.98)),
        ),
    ),
    "hot": Preset(
        "black, red, yellow, white with rising opacity",
        "relative",
        (
            (0.0, 0.0, (0.0, 0.0, 0.0)),
            (0.35, 0.05, (0.8, 0.1, 0.0)),
            (0.7, 0.2, (1.0, 0.8, 0.1)),
            (1.0, 0.6, (1.0, 1.0, 1.0)),
        ),
    ),
    "ct-bone": Preset(
        "bone alone, from 150 HU",
        "hounsfield",
        (
            (-1000.0, 0.0, (0.55, 0.25, 0.15)),
            (150.0, 0.0, (0.75, 0.50, 0.35)),
            (350.0, 0.4, (0.88, 0.78, 0.62)),
            (1200.0, 0.9, (1.0, 0.98, 0.92)),
            (3000.0, 0.95, (1.0, 1.0, 1.0)),
        ),
    ),
    "ct-tissue": Preset(
        "skin and muscle as a veil over bone",
        "hounsfield",
        (
            (-1000.0, 0.0, (0.70, 0.45, 0.35)),
            (-400.0, 0.0, (0.80, 0.55, 0.42)),
            (-150.0, 0.04, (0.85, 0.60, 0.45)),
            (60.0, 0.08, (0.72, 0.25, 0.18)),
            (180.0, 0.1, (0.80, 0.50, 0.35)),
            (350.0, 0.6, (0.90, 0.82, 0.68)),
            (3000.0, 0.95, (1.0, 1.0, 1.0)),
        ),
    ),
}


def preset(
    name: str, value_range: tuple[float, float], opacity_unit: float = 1.0
) -> TransferFunction:
    """The preset called ``name`` for a volume whose finite values span ``value_range``.

    A relative preset over a range that is empty (lowest = highest) becomes one half opaque grey.
    Raises SceneError for a name that is not in ``PRESETS``, or a range that is not finite.
    """
    if name not in PRESETS:
        raise SceneError("transfer_function: preset", f"got {name!r}", expected_preset(name))
    chosen = PRESETS[name]
    opacities = np.array([opacity for _, opacity, _ in chosen.points])
    colors = srgb_to_linear([color for *_, color in chosen.points])
    positions = np.array([position for position, *_ in chosen.points])
    if chosen.scale == "relative":
        low, high = (float(end) for end in value_range)
        if not (math.isfinite(low) and math.isfinite(high) and low <= high):
            got = f"got value range {low!r} to {high!r}"
            raise SceneError("transfer_function: preset", got, "a finite, ascending value range")
        if low == high:
            grey = np.full((1, 3), srgb_to_linear(0.85))
            return TransferFunction(np.array([low]), np.array([0.5]), grey, opacity_unit)
        # Rounding may put points of a tiny range on one value: keep the outer two of each run.
        mixed = np.clip(low * (1.0 - positions) + high * positions, low, high)
        positions = np.maximum.accumulate(mixed)
        positions[0], positions[-1] = low, high
        inner = (positions[1:-1] == positions[:-2]) & (positions[1:-1] == positions[2:])
        keep = np.concatenate([[True], ~inner, [True]])
        positions, opacities, colors = positions[keep], opacities[keep], colors[keep]
    return TransferFunction(positions, opacities, colors, opacity_unit)


def expected_preset(name: str) -> str:
    """What to say was expected in place of the unknown preset ``name``."""
    near = get_close_matches(str(name), PRESETS, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return "one of " + ", ".join(repr(known) for known in PRESETS) + hint
