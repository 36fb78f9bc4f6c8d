"""Modules that are imported when something of them is first used: what a plain picture does not need.

A process that renders a small picture spends most of its time on imports. ``lazily`` is called at the top of a module,
in place of an import, so that the imports of a file stay in one place::

    if TYPE_CHECKING:
        from clvol.encoding import coded_volume
    else:
        coded_volume = lazily("clvol.encoding.coded_volume")
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class _WhenUsed:
    """Stands for a module. Nothing is kept of it, so that tests may replace what is in it."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(import_module(self._name), attribute)


def lazily(name: str) -> Any:
    """The module of that name, which is imported when one of its attributes is first accessed."""
    return _WhenUsed(name)
