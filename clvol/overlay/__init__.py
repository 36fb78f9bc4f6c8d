"""What is drawn over a displayed picture: scale bar, colour bar, orientation, box, title and caption ([overlay])."""

from __future__ import annotations

from clvol.overlay.description import Description
from clvol.overlay.drawing import DrawnOverlay

__all__ = ["Description", "DrawnOverlay"]
