"""Text that a terminal only shows."""

from __future__ import annotations

import unicodedata


def is_harmless(text: str) -> bool:
    return all(unicodedata.category(c) not in ("Cc", "Cf", "Cs", "Co", "Zl", "Zp") for c in text)
