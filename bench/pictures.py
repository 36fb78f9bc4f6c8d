"""Pictures that were compared, kept to be looked at, and how far they lie apart."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np


def save_side_by_side(pictures: Sequence[np.ndarray], path: Path) -> Path:
    """PNG of ``pictures`` (linear premultiplied [h, w, 4], all of one size), sRGB over black."""
    from PIL import Image

    linear = np.clip(np.concatenate([p[..., :3] for p in pictures], axis=1), 0.0, 1.0)
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.rint(255 * shown).astype(np.uint8)).save(path)
    return path


def apart(a: np.ndarray, b: np.ndarray) -> dict[str, Any]:
    """How unlike two pictures [h, w, 4] are, and whether they show the same view.

    "rmse": over all pixels and channels. "best_flip": what of ``b`` is likest to ``a``: "none"
    where both are the same way round. "outline": share of the pixels that either covers at all, of
    which the other has less than half the opacity.
    """
    flips = {"none": b, "left-right": b[:, ::-1], "up-down": b[::-1], "both": b[::-1, ::-1]}
    errors = {name: float(np.sqrt(np.mean((a - flip) ** 2))) for name, flip in flips.items()}
    most, least = np.maximum(a[..., 3], b[..., 3]), np.minimum(a[..., 3], b[..., 3])
    covered = most > 0.01
    unlike = covered & (least < 0.5 * most)
    return {
        "rmse": errors["none"],
        "best_flip": min(errors, key=errors.__getitem__),
        "outline": float(unlike.sum() / max(covered.sum(), 1)),
    }
