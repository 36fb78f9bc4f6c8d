"""One effect of the vocabulary, as a pass of the analysis notes it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Effect:
    """One effect of the vocabulary: whether the scene needs it, and the reason in words."""

    name: str
    called_for: bool
    reason: str


def yes(name: str, reason: str) -> Effect:
    return Effect(name, True, reason)


def no(name: str, reason: str) -> Effect:
    return Effect(name, False, reason)


def joined(reasons: Iterable[str]) -> str:
    """The distinct reasons, at most three of them."""
    distinct = list(dict.fromkeys(reasons))
    more = [f"and {len(distinct) - 3} more"] if len(distinct) > 3 else []
    return "; ".join(distinct[:3] + more)


def counted(count: int, noun: str) -> str:
    """A count with its noun, such as "1 light" or "3 lights"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
