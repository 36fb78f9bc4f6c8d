"""Round lengths and values: of the scale bar, and of the ticks of the colour bar."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from clvol.volume.units import find_unit

if TYPE_CHECKING:
    from clvol.scene import Camera

_METRIC = (("nm", 1e-9), ("µm", 1e-6), ("mm", 1e-3), ("m", 1.0), ("km", 1e3))


def pixels_per_length(camera: Camera, height: int) -> float:
    """Pixels that a world length of 1 takes in a picture of ``height`` pixels: everywhere where the camera is
    orthographic, at the distance of its target where it is perspective. The camera is complete."""
    if camera.projection == "orthographic":
        return height / camera.height_of_view()
    position, target = camera.position or (0.0, 0.0, 0.0), camera.target or (0.0, 0.0, 0.0)
    distance = math.dist(position, target)
    return height / (2.0 * distance * math.tan(math.radians(camera.fov_degrees) / 2))


def round_below(largest: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is at most ``largest`` (above 0)."""
    power = 10.0 ** math.floor(math.log10(largest))
    for factor in (5.0, 2.0, 1.0):
        if factor * power <= largest * (1 + 1e-12):
            return factor * power
    return power


def bar_length(largest: float, unit: str | None) -> tuple[float, str]:
    """(world length, its name) of the longest bar up to the world length ``largest``, such as (20.0, "20 mm").

    Metric units are those in which the number is from 1 to below 1000, whatever the volume's are.
    """
    found = find_unit(unit)
    metres = None if found is None else found[1]
    if metres is None or found is None or found[0] not in {"pm", "nm", "µm", "mm", "cm", "dm", "m", "km"}:
        length = round_below(largest)
        name = unit if unit and found is None else (found[0] if found is not None else "units")
        return length, f"{number(length)} {name}"
    symbol, size = next(
        ((symbol, size) for symbol, size in reversed(_METRIC) if largest * metres >= size), _METRIC[0]
    )
    length = round_below(largest * metres / size)
    return length * size / metres, f"{number(length)} {symbol}"


def number(value: float) -> str:
    """``value`` in few digits, with a true minus sign."""
    text = f"{value:.6g}" if 1e-4 <= abs(value) < 1e6 or value == 0 else f"{value:.3g}"
    return text.replace("-", "\u2212")


def ticks(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` round values from ``low`` to ``high``, evenly apart; at least one where the range has any."""
    if not high > low:
        return [low]
    step = round_below((high - low) / max(1, most - 1))
    for _ in range(12):
        first = math.ceil(low / step - 1e-9)
        count = math.floor(high / step + 1e-9) - first + 1
        if count <= most:
            return [(first + k) * step for k in range(count)]
        step = round_below(step * 2.6)  # the next of 1, 2, 5
    return [low, high]
