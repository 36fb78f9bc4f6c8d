"""Whether a picture is there already."""

from __future__ import annotations

from typing import Any

import clvol
from clvol.errors import ClvolError
from clvol.image import is_intact, load_image
from clvol.scene.resolve import ResolvedScene
from clvol.text import without_surrogates

# The memory that reading a picture of clvol takes; pictures that need more are from elsewhere.
_BYTES_PER_PIXEL = 48
_HEADER_BYTES = 1 << 20


def is_made_from(path: str, resolved: ResolvedScene, expected: dict[str, Any], measured: bool = False) -> bool:
    """Whether a picture is whole, and shows ``resolved`` made from what is ``expected`` (``clvol.render.made_from``).
    False if it does not say how it was made. ``measured``: its settings were chosen for an error, so scene and look may
    be others."""
    width, height = resolved.image.width, resolved.image.height
    try:
        picture = load_image(path, _BYTES_PER_PIXEL * width * height + _HEADER_BYTES)
        made_from = dict(picture["made_from"] or {})
    except ClvolError:
        return False
    if not is_intact(path, picture) or picture["rgba"].shape[:2] != (height, width):
        return False
    del made_from["pixels"]
    header = {name.lower(): value for name, value in picture["header"].items()}
    same = {
        "software": f"clvol {clvol.__version__}",
        "clvol_version": clvol.__version__,
    } | ({} if measured else {"scene": without_surrogates(resolved.source or "")})
    if any(header.get(name, value) != value for name, value in same.items()):
        return False
    expected = dict(expected)
    for name in ("scene", "look") if measured else ():
        made_from.pop(name, None)
        expected.pop(name, None)
    return made_from == expected and made_from["voxels"] is not None  # None: unknown, so possibly others
