"""Pictures of channels in double precision: the twin's picture of every channel, blended by definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reference.march import render_twin


def render_channels(resolved) -> np.ndarray:
    """The picture of a scene with ``channels``, premultiplied linear RGBA, float64 [height, width, 4]."""
    pictures = [
        render_twin(replace(resolved, volume=each.volume, transfer_function=each.function, channels=()))
        for each in resolved.channels
    ]
    if resolved.integration.blend == "maximum":
        return np.max(pictures, axis=0)
    screened = 1.0 - np.prod(1.0 - np.clip(pictures, 0.0, 1.0), axis=0)
    if resolved.integration.blend == "screen":
        return screened
    return np.concatenate([np.sum(pictures, axis=0)[..., :3], screened[..., 3:]], axis=-1)
