"""Transfer functions of other tools: read from their files and colour maps, and written for them.

Files are data and are only parsed. ``files.ENDINGS`` lists what is read, ``files.WRITTEN`` what is written.
"""

from __future__ import annotations

from clvol.transfer.exchange.colormaps import load_colormap
from clvol.transfer.exchange.files import ENDINGS, load_imported, save_function
from clvol.transfer.exchange.imported import Imported, OpacityCurve

__all__ = ["ENDINGS", "Imported", "OpacityCurve", "load_colormap", "load_imported", "save_function"]
