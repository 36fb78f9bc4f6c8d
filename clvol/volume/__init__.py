"""Volumes: arrays on a grid in world space, and analytic fields."""

from __future__ import annotations

from clvol.volume.grid import Grid
from clvol.volume.series import VolumeSeries
from clvol.volume.volume import ACCEPTED_TYPES, Volume, describe

__all__ = ["ACCEPTED_TYPES", "Grid", "Volume", "VolumeSeries", "describe"]
