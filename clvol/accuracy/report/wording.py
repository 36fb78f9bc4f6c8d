"""Formats numbers and settings for readers."""

from __future__ import annotations

import math
from typing import Any

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
NOTHING = "\N{EN DASH}"
_NBSP = "\N{NO-BREAK SPACE}"
_TIMES = "\N{MULTIPLICATION SIGN}"


def power_of_ten(exponent: int) -> str:
    """A power of ten such as "10⁻³"; "1" and "10" for the exponents 0 and 1."""
    return {0: "1", 1: "10"}.get(exponent) or "10" + str(exponent).translate(_SUPERSCRIPT)


def number(value: float | None, digits: int = 3) -> str:
    """``value`` with ``digits`` significant digits, and with a power of ten if plain digits would be long."""
    if value is None:
        return NOTHING
    if value == 0 or 1e-4 <= abs(value) < 1e6:
        rounded = float(f"{value:.{digits}g}")
        return f"{rounded:.{digits}g}" if abs(rounded) < 10.0**digits else f"{rounded:.0f}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    power = "10" + str(int(exponent)).translate(_SUPERSCRIPT)
    mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    return power if mantissa == "1" else f"{mantissa}{_NBSP}{_TIMES}{_NBSP}{power}"


def seconds(value: float | None, digits: int = 3) -> str:
    """A time in a suitable unit: "4.1 ms", "2.3 s", "12 min"."""
    if value is None:
        return NOTHING
    if value == 0:
        return f"0{_NBSP}s"
    for limit, factor, unit in ((1e-3, 1e6, "µs"), (1.0, 1e3, "ms"), (600.0, 1.0, "s"),
                                (36000.0, 1 / 60, "min")):
        # Rounding must not yield 1000 ms.
        if float(f"{value:.{digits}g}") < limit:
            return f"{number(value * factor, digits)}{_NBSP}{unit}"
    return f"{number(value / 3600, digits)}{_NBSP}h"


def count(value: int | None) -> str:
    """A count with thin spaces between groups of three digits."""
    return NOTHING if value is None else f"{value:,}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def size_of(value: int | None) -> str:
    """Bytes in KiB, MiB or GiB."""
    if value is None:
        return NOTHING
    power = min(3, int(math.log(value, 1024))) if value >= 1 else 0
    unit = ("B", "KiB", "MiB", "GiB")[power]
    return f"{number(value / 1024**power)}{_NBSP}{unit}"


def percent(share: float | None) -> str:
    return NOTHING if share is None else f"{100 * share:.2g}{_NBSP}%"


def setting(value: Any) -> str:
    """The value of a tunable in words: 0.5, "post", yes, no."""
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def toml(value: Any) -> str:
    """The value of a tunable in TOML, as ``--set`` expects it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)
    escaped = str(value).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def shorten(text: str, length: int) -> str:
    """``text`` cut to at most ``length`` characters, of which the last is an ellipsis if it was cut."""
    return text if len(text) <= length else text[: length - 1].rstrip(" ,") + "…"


def judged_by(result: dict[str, Any]) -> str:
    """The name of the reference against which the errors of a sweep are measured."""
    return result["reference"].get("how") or "exact integral"


def exponent_of(value: float) -> int:
    """The decimal exponent of ``value``."""
    return int(f"{value:e}".split("e")[1])


def several(n: int, noun: str) -> str:
    """``n`` with the noun in the singular or plural: "1 frame", "3 frames"."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def upper(text: str) -> str:
    """``text`` with its first letter capitalised."""
    return text[:1].upper() + text[1:]
