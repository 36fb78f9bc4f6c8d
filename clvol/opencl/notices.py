"""Problems of the machine that do not prevent a picture, reported once per process."""

from __future__ import annotations

import warnings

from clvol.errors import ClvolWarning

_told: dict[str, str] = {}


def notice(where: str, what: str) -> None:
    """Warns (:class:`clvol.errors.ClvolWarning`) about a problem with ``where``, unless it has been reported."""
    if where not in _told:
        _told[where] = what
        warnings.warn(ClvolWarning(where, what), stacklevel=3)


def told() -> dict[str, str]:
    """All problems reported so far, by ``where``."""
    return dict(_told)
