"""Switches Python's warnings off temporarily.

All threads share the list of filters of the module ``warnings``, and restoring an older list discards what other
threads changed in between. Code in clvol that changes the filters therefore holds one lock.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

FILTERS = threading.RLock()  # held by all code that changes the filters or relies on them


@contextmanager
def without_warnings(category: type[Warning] = Warning) -> Iterator[None]:
    """Suppresses warnings of ``category`` inside the block."""
    with FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield
