"""Volumes: arrays with a grid in the world, the files they come from, analytic fields for tests."""

from __future__ import annotations

from clvol.readers import ENDINGS, is_volume_path, load_volume
from clvol.volume.grid import Grid
from clvol.volume.volume import ACCEPTED_TYPES, Volume, describe

__all__ = [
    "ACCEPTED_TYPES",
    "ENDINGS",
    "Grid",
    "Volume",
    "describe",
    "is_volume_path",
    "load_volume",
]
