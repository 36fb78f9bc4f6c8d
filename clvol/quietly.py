"""Python's warnings switched off for a while.

The filters of the module ``warnings`` are one list for all threads, and putting an older one back loses what others
changed in between: so those of clvol take turns.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

FILTERS = threading.RLock()  # whoever changes the filters, or counts on them, holds it


@contextmanager
def without_warnings(category: type[Warning] = Warning) -> Iterator[None]:
    """No warnings of ``category`` inside the block."""
    with FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield
