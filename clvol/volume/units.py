"""Units of length: the names that files use for them, and a common unit for all axes of a volume."""

from __future__ import annotations

import math
from collections.abc import Sequence

_PREFIXES = {
    "yotta": ("Y", 24), "zetta": ("Z", 21), "exa": ("E", 18), "peta": ("P", 15), "tera": ("T", 12),
    "giga": ("G", 9), "mega": ("M", 6), "kilo": ("k", 3), "hecto": ("h", 2), "deca": ("da", 1),
    "": ("", 0), "deci": ("d", -1), "centi": ("c", -2), "milli": ("m", -3), "micro": ("µ", -6),
    "nano": ("n", -9), "pico": ("p", -12), "femto": ("f", -15), "atto": ("a", -18),
    "zepto": ("z", -21), "yocto": ("y", -24),
}  # fmt: skip
# Symbol, metres and further names; OME's and UDUNITS' (which OME-Zarr uses) are all among them.
_OTHERS = (
    ("Å", 1e-10, "angstrom angstroms ångström ångstrom a"),
    ("in", 0.0254, "inch inches \""),
    ("thou", 2.54e-5, "mil mils thousandth"),
    ("line", 0.0254 / 12, "li lines"),
    ("ft", 0.3048, "foot feet"),
    ("yd", 0.9144, "yard yards"),
    ("mi", 1609.344, "mile miles mi."),
    ("pt", 0.0254 / 72, "point points"),
    ("ua", 149597870700.0, "au astronomicalunit"),
    ("ly", 9460730472580800.0, "lightyear lightyears"),
    ("pc", 3.0856775814913673e16, "parsec parsecs"),
)
# These are not lengths: the distances were not measured.
_UNMEASURED = {
    "pixel", "pixels", "px", "pix", "voxel", "voxels", "referenceframe", "reference frame",
}  # fmt: skip


def _table() -> tuple[dict[str, tuple[str, float]], dict[str, tuple[str, float]]]:
    """Symbols, which are case-sensitive (Mm, mm), and names in lower case."""
    symbols, names = {}, {}
    for prefix, (letter, power) in _PREFIXES.items():
        unit = f"{letter}m", 10.0**power
        symbols[unit[0]] = unit
        for word in ("meter", "metre", "meters", "metres"):
            names[prefix + word] = unit
    micro = symbols["µm"]
    symbols |= {"um": micro, "μm": micro, "mcm": micro, "u": micro, "µ": micro, "μ": micro}
    names |= dict.fromkeys(("micron", "microns", "mu", "micrometer(s)"), micro)
    for symbol, metres, words in _OTHERS:
        unit = symbol, metres
        symbols[symbol] = unit
        names |= dict.fromkeys(words.split(), unit)
    for symbol in ("mm", "cm", "nm", "um", "µm", "μm"):  # their upper-case forms are unambiguous
        names[symbol.lower()] = symbols[symbol]
    return symbols, names


_SYMBOLS, _NAMES = _table()


def find_unit(name: str | None) -> tuple[str, float | None] | None:
    """(usual symbol, metres) of the unit called ``name`` in any spelling; None if the name is empty or unknown.

    ``metres`` is None for pixels and similar units.
    """
    text = (name or "").strip().replace("\\u00B5", "µ").replace("\\u00b5", "µ")
    text = text.replace("Â", "").replace("\u212b", "Å")  # mis-decoded µ and Å; the angstrom sign
    if text in _SYMBOLS:
        return _SYMBOLS[text]
    lower = " ".join(text.lower().split())
    if lower in _UNMEASURED:
        return "pixel", None
    return _NAMES.get(lower) or _NAMES.get(lower.replace("_", "").replace(" ", ""))


def ome_name(symbol: str | None) -> str | None:
    """The name of a unit in OME-Zarr; None if it has none."""
    others = {"Å": "angstrom", "in": "inch", "ft": "foot", "yd": "yard", "mi": "mile", "pc": "parsec"}
    for prefix, (letter, _) in _PREFIXES.items():
        others[f"{letter}m"] = f"{prefix}meter"
    return others.get(symbol or "")


def one_unit(
    names: Sequence[str | None], used: Sequence[bool] | None = None
) -> tuple[list[float], str | None, str | None]:
    """Factors that convert lengths along x, y and z to one unit, the name of that unit, and a warning.

    The unit is that of the first axis, or None if none is known; the warning says what is wrong with the names, or is
    None. Axes that are not ``used`` (those of one voxel) are ignored.
    """
    texts = [(name or "").strip() for name in names]
    used = [True] * len(texts) if used is None else list(used)
    if not any(used):
        used = [True] * len(texts)
    found = [find_unit(text) for text in texts]
    unknown = sorted({n for n, f in zip(texts, found) if f is None and n})
    counted = [f for f, u in zip(found, used) if u]
    if all(f is None for f in counted):
        wrong = f"unknown unit of length {', '.join(map(repr, unknown))}" if unknown else None
        same = {n for n, u in zip(texts, used) if u}
        if len(same) > 1:
            wrong = f"units that cannot be brought to one ({_listed(texts)}); the numbers are kept"
        return [1.0] * len(texts), texts[0] or None, wrong
    symbol, metres = next(f for f in counted if f is not None)
    if all(f is not None and f[0] == symbol for f in counted):
        return [1.0] * len(texts), symbol, None
    if metres is None or any(f is None or f[1] is None for f in counted):
        wrong = f"units that cannot be brought to one ({_listed(texts)}); the numbers are kept"
        return [1.0] * len(texts), None, wrong
    factors = [1.0 if f is None or f[1] is None else _ratio(f[1], metres) for f in found]
    return factors, symbol, None


def _ratio(metres: float, of: float) -> float:
    """``metres`` / ``of``. Powers of ten are exact: in floating point 1e-9 / 1e-6 is not 1e-3 to the last bit."""
    ratio = metres / of
    power = round(math.log10(ratio))
    decimal = float(f"1e{power}")
    return decimal if math.isclose(ratio, decimal, rel_tol=1e-12) else ratio


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"{axis} {name or 'none'}" for axis, name in zip("xyz", names))
