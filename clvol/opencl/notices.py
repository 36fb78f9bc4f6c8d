"""What is wrong with the machine but does not stop a picture: told once a process."""

from __future__ import annotations

import warnings

from clvol.errors import ClvolWarning

_told: dict[str, str] = {}


def notice(where: str, what: str) -> None:
    """Warns (:class:`clvol.errors.ClvolWarning`) of what is wrong with ``where``, unless that was told."""
    if where not in _told:
        _told[where] = what
        warnings.warn(ClvolWarning(where, what), stacklevel=3)


def told() -> dict[str, str]:
    """All that was told so far: what, by where."""
    return dict(_told)
