"""The settings that a caller passes for a file, and the warnings that a reader returns with the voxels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from clvol.errors import SeveralChannels, VolumeError
from clvol.volume.array_axes import Axis

Key = Literal["channel", "time", "series"]
_SHOWN = 12
ALL_TIMES = "all"  # as ``time``: all of them, one after the other
_ONE = {"channel": "one channel", "time": "one time", "series": "one series"}
_SEVERAL = {"channel": "channels", "time": "times", "series": "series"}


class SeveralTimes(Exception):
    """Raised in place of reading where all times are requested: the ``names`` of the times that there are, None for
    those without a name, and the ``numbers`` by which each is selected."""

    def __init__(self, names: Sequence[str | None], numbers: Sequence[int]) -> None:
        super().__init__(f"{len(names)} times")
        self.names, self.numbers = list(names), list(numbers)


@dataclass(frozen=True)
class Displayed:
    """How a file says that a channel is displayed: its sRGB ``color`` (three numbers from 0 to 1), and the ``range`` of
    values from black to the full colour; None where it does not say so."""

    color: tuple[float, float, float] | None = None
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class ReadOptions:
    """Settings of one ``load_volume`` call.

    ``dims`` (nx, ny, nz), ``dtype``, ``header_bytes`` (-1: the voxels are at the end of the file) and ``byte_order``
    ("little", "big") are for .raw files. ``spacing`` or None; ``memory_cap`` in bytes or None.

    ``channel``, ``time`` and ``series`` (an index from 0, a name, or None) select one of several; readers call
    ``choose`` for them. ``notes`` collects the texts of ``warn``.
    """

    dims: Sequence[int] | None = None
    dtype: str | np.dtype | None = None
    spacing: Sequence[float] | None = None
    memory_cap: int | None = None
    channel: int | str | None = None
    time: int | str | None = None
    series: int | str | None = None
    header_bytes: int | None = None
    byte_order: str | None = None
    notes: list[str] = field(default_factory=list)
    consulted: set[str] = field(default_factory=set)

    def warn(self, text: str) -> None:
        """Records something that the user should know, in one sentence. Reading continues."""
        if text not in self.notes:
            self.notes.append(text)

    def choose(
        self,
        key: Key,
        where: str,
        names: Sequence[str | None],
        *,
        numbers: Sequence[int] | None = None,
        shown: Sequence[str] | None = None,
        displayed: Sequence[Displayed] = (),
    ) -> int:
        """The index of the channel, time or series that the caller selects.

        ``names`` has one entry per choice, None for a choice without a name. ``numbers`` are the numbers by which
        choices can be selected, by default 0, 1, 2...; ``shown`` describes each choice in error messages, by default
        its name; ``displayed`` is how the file says that each is displayed. VolumeError, which lists the choices,
        unless exactly one is selected (SeveralChannels, where none of several channels is); a single choice need not be
        selected.
        """
        self.consulted.add(key)
        wanted = getattr(self, key)
        count = len(names)
        if key == "time" and wanted == ALL_TIMES:
            raise SeveralTimes(names, range(count) if numbers is None else numbers)
        if wanted is None and count == 1:
            return 0
        numbers = range(count) if numbers is None else numbers
        if wanted is not None:
            found = _found(wanted, names, numbers)
            if len(found) == 1:
                return found[0]
        listed = _listed(numbers, shown or [_quoted(name) for name in names])
        if wanted is None:
            what = f"{count} {_SEVERAL[key]}: {listed}"
        elif count == 1:
            what = f"volume.{key} = {_quoted(wanted)}, where there is {_ONE[key]}: {listed}"
        else:
            what = f"volume.{key} = {_quoted(wanted)} among {count} {_SEVERAL[key]}: {listed}"
        if key == "channel" and wanted is None:
            several = SeveralChannels(where, what, "volume.channel = one of them")
            several.numbers, several.names = tuple(numbers), tuple(names)
            shown_as = [*displayed, *[Displayed()] * (count - len(displayed))]
            several.colors = tuple(each.color for each in shown_as)
            several.ranges = tuple(each.range for each in shown_as)
            raise several
        series = f', or "{ALL_TIMES}" for a volume that changes over time' if key == "time" and count > 1 else ""
        raise VolumeError(where, what, f"volume.{key} = one of them{series}")

    def check_consulted(self, where: str) -> None:
        """VolumeError if a key was given for which the file offers no choice; 0 is always accepted."""
        for key in ("channel", "time", "series"):
            wanted = getattr(self, key)
            is_all = key == "time" and wanted == ALL_TIMES  # of one
            if wanted is not None and wanted != 0 and key not in self.consulted and not is_all:
                what = f"volume.{key} = {_quoted(wanted)}, where there is {_ONE[key]}"
                raise VolumeError(where, what, f"no volume.{key} for this file")


def named_axes(names: Sequence[str | None], options: ReadOptions) -> list[Axis]:
    """The axes of an array by their names. The first of four axes without any names is one of times where
    ``options.time`` says so."""
    axes = [Axis(name) for name in names]
    if options.time is not None and len(axes) == 4 and not any(names):
        axes[0] = Axis("t")
    return axes


def _found(wanted: int | str, names: Sequence[str | None], numbers: Sequence[int]) -> list[int]:
    """Matches by name, by name in another case if that is unique, or by number."""
    if not isinstance(wanted, str):
        return [k for k, number in enumerate(numbers) if number == wanted]
    same = [k for k, name in enumerate(names) if name == wanted]
    if not same:
        folded = wanted.strip().casefold()
        same = [k for k, name in enumerate(names) if (name or "").strip().casefold() == folded]
    if not same and wanted.strip().isdecimal():
        same = [k for k, number in enumerate(numbers) if str(number) == wanted.strip()]
    return same


def _listed(numbers: Sequence[int], shown: Sequence[str]) -> str:
    said = [" ".join(filter(None, (str(n), text))) for n, text in zip(numbers, shown)]
    if len(said) > _SHOWN:
        said = [*said[: _SHOWN - 1], f"... {said[-1]}"]
    return ", ".join(said)


def _quoted(value: int | str | None) -> str:
    return f'"{value}"' if isinstance(value, str) else "" if value is None else str(value)
