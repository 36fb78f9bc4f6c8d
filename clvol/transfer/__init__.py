"""Transfer functions: colour and opacity by the value of the volume."""

from __future__ import annotations

from clvol.transfer.color import linear_to_srgb, srgb_to_linear
from clvol.transfer.function import TransferFunction
from clvol.transfer.presets import PRESETS, preset

__all__ = ["PRESETS", "TransferFunction", "linear_to_srgb", "preset", "srgb_to_linear"]
