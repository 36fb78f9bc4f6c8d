"""Colour maps by name, from matplotlib, colorcet and cmap, or as objects of these packages."""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches
from typing import Any

import numpy as np

from clvol.errors import SceneError
from clvol.transfer.color import srgb_to_linear
from clvol.transfer.exchange.imported import Imported
from clvol.transfer.exchange.sampled import thinned

EXTRA = "colormaps"
_SAMPLES = 256
_ERROR = 1 / 255  # of a component: listed colours are often rounded to 8 bits
_FEW = 64  # listed colours up to which a colour map is a list of separate colours
_LIBRARIES = ("matplotlib", "colorcet", "cmap")


def load_colormap(colormap: Any, where: str = "colormap") -> Imported:
    """A colour map from 0 to 1, to within a level of 8 bits of the sRGB-encoded colour.

    ``colormap`` is a name, a Colormap object of matplotlib or cmap, or anything that maps an array of numbers from 0 to
    1 to colours [n, 3] or [n, 4]. A name is looked up in matplotlib, then in colorcet and cmap where they are installed
    (extra "colormaps"); "matplotlib:NAME", "colorcet:NAME" and "cmap:NAME" name one of them. Maps of at most 64 listed
    colours (tab10, glasbey) become steps of equal width. Raises SceneError.
    """
    found = _by_name(colormap, where) if isinstance(colormap, str) else colormap
    if not callable(found):
        expected = "the name of a colour map, or a Colormap of matplotlib or cmap"
        raise SceneError(where, f"got {type(colormap).__name__}", expected)
    listed = _listed(found)
    if listed is not None:
        return Imported(where, _steps(listed), is_relative=True)
    at = np.linspace(0.0, 1.0, _SAMPLES)
    encoded = _colors(found, at, where)
    kept = thinned(at, encoded, _ERROR)
    return Imported(where, (at[kept], srgb_to_linear(encoded[kept])), is_relative=True)


def _colors(colormap: Callable[[np.ndarray], Any], at: np.ndarray, where: str) -> np.ndarray:
    try:
        colors = np.asarray(colormap(at), dtype=float)[:, :3]
        good = colors.shape == (len(at), 3) and bool(np.isfinite(colors).all())
    except Exception:  # whatever an object of another package raises
        good = False
    if not good or colors.min() < 0.0 or colors.max() > 1.0:
        what = f"{type(colormap).__name__} gives no colours from 0 to 1"
        raise SceneError(where, what, "a function from numbers to colours [n, 3]")
    return colors


def _listed(colormap: Any) -> np.ndarray | None:
    """The colours of a colour map that is a short list, [n, 3] sRGB-encoded; None for any other."""
    if getattr(colormap, "interpolation", None) == "nearest" and hasattr(colormap, "color_stops"):  # cmap
        count = len(colormap.color_stops)
    else:
        count = len(colormap.colors) if hasattr(colormap, "colors") and hasattr(colormap, "N") else 0
    if not 1 <= count <= _FEW:
        return None
    at = (np.arange(count) + 0.5) / count
    return np.asarray(colormap(at), dtype=float)[:, :3]


def _steps(encoded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    edges = np.linspace(0.0, 1.0, len(encoded) + 1)
    values = np.stack([edges[:-1], edges[1:]], axis=1).ravel()
    return values, np.repeat(srgb_to_linear(encoded), 2, axis=0)


def _by_name(name: str, where: str) -> Any:
    prefix, colon, rest = name.partition(":")
    asked = prefix.lower()
    if colon and asked in _LIBRARIES:
        found = _FINDERS[asked](rest)
        if found is None and not _is_installed(asked):
            raise SceneError(where, f"got {name!r}, but {asked} is not installed", f"pip install clvol[{EXTRA}]")
        if found is not None:
            return found
    else:
        for library in _LIBRARIES:
            if (found := _FINDERS[library](name)) is not None:
                return found
    raise SceneError(where, f"got {name!r}, no colour map", _expected(rest if colon and asked in _LIBRARIES else name))


def _expected(name: str) -> str:
    import matplotlib

    known = [known for known in matplotlib.colormaps if not known.endswith("_r")]
    near = get_close_matches(name, known, n=1) if len(name) <= 100 else []
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    missing = [library for library in _LIBRARIES[1:] if not _is_installed(library)]
    more = f"; {' and '.join(missing)}: pip install clvol[{EXTRA}]" if missing else ""
    return "a name such as 'viridis', 'magma' or 'colorcet:fire'" + hint + more


def _is_installed(library: str) -> bool:
    from importlib.util import find_spec

    return find_spec(library) is not None


def _from_matplotlib(name: str) -> Any:
    import matplotlib

    return matplotlib.colormaps[name] if name in matplotlib.colormaps else None


def _from_colorcet(name: str) -> Any:
    if not _is_installed("colorcet"):
        return None
    import colorcet
    from matplotlib.colors import ListedColormap

    palette = colorcet.palette.get(name.removeprefix("cet_"))
    # Categorical palettes are as long as continuous ones; their names say what they are.
    if palette is None:
        return None
    return ListedColormap(palette[:_FEW] if name.removeprefix("cet_").startswith("glasbey") else palette)


def _from_cmap(name: str) -> Any:
    if not _is_installed("cmap"):
        return None
    import cmap

    try:
        return cmap.Colormap(name)
    except (ValueError, TypeError, KeyError):
        return None


_FINDERS: dict[str, Callable[[str], Any]] = {
    "matplotlib": _from_matplotlib, "colorcet": _from_colorcet, "cmap": _from_cmap
}  # fmt: skip
