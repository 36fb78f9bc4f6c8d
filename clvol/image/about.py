"""What a picture says about how it was made."""

from __future__ import annotations

import json
from importlib import metadata
from typing import Any


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def _plain(value: Any) -> Any:
    """numpy's scalars and arrays as JSON knows them; anything else by its text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def facts(frame: Any) -> dict[str, str]:
    """Texts for a header: software, versions, device, statistics, scene (where there is one)."""
    import clvol

    stats = getattr(frame, "stats", None) or {}
    texts = {
        "software": f"clvol {clvol.__version__}",
        "clvol_version": clvol.__version__,
        "pyopencl_version": _version("pyopencl"),
        "numpy_version": _version("numpy"),
        "device": ", ".join(str(d) for d in stats.get("devices", ())) or "unknown",
        "stats": json.dumps(stats, default=_plain),
    }
    if "accuracy" in stats:  # the picture's own claim, as numbers that any reader of headers finds
        for name in ("rmse", "bound", "confidence"):
            texts[f"error_{name}"] = repr(float(stats["accuracy"][name]))
    scene = getattr(frame, "scene_source", None)
    if scene:
        texts["scene"] = scene
    return texts
