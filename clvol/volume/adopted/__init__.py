"""Volumes from objects of other libraries, recognised without importing a library that the caller has not.

``adopt`` is for the constructor of ``Volume``. A new kind of object is a function in a module of this package, and a
line in ``_BY_LIBRARY`` of ``adopt.py``.
"""

from __future__ import annotations

from clvol.volume.adopted.adopt import adopt, is_array_like
from clvol.volume.adopted.facts import Adopted

__all__ = ["Adopted", "adopt", "is_array_like"]
