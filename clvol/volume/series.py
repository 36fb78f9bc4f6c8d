"""Volumes that change over time: a series of steps on one grid, of which few are in memory at a time."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from clvol.errors import ClvolWarning, VolumeError
from clvol.quietly import FILTERS
from clvol.volume.axis import ValueAxis, turned
from clvol.volume.grid import Grid
from clvol.volume.read_ahead import ReadAhead
from clvol.volume.series_checks import (
    CONVERTIBLE,
    StepDiffers,
    StepRange,
    check_alike,
    check_within,
    checked_range,
    converted,
    holds_whole,
    range_of,
    without_voxels,
)
from clvol.volume.series_steps import Step, steps_of
from clvol.volume.volume import Census, Volume

_EXCERPT = 1 << 21


@dataclass(frozen=True)
class SeriesFacts:
    """What all steps have in common. ``axis``: from stored numbers to values. ``census``: range and counts over all
    times; a count is that of the step that has most, but for one voxel if any voxel of the series is finite.
    ``widest``: the first of the steps whose range is widest; what is chosen from voxels is chosen from it."""

    grid: Grid
    dtype: np.dtype
    axis: ValueAxis
    census: Census
    widest: int
    frame: str = "index"
    unit: str | None = None
    labels: bool = False
    reads_blocks: bool = False
    format: str | None = None


class VolumeSeries:
    """A volume that changes over time. ``Scene(volume=series)`` shows the step of its ``animation.time``.

    ``steps``: a list of what ``Volume`` takes, or of functions without arguments that return such; a 4-D array
    [t, z, y, x]; or a DataArray of xarray with a dimension of time. What a function returns is used while its step is
    shown, and the next one is called, in a thread, while a frame is rendered: at most two steps are in memory beside
    the one on the device. ``names``: of the steps, for messages. ``spacing`` and what follows are as for ``Volume``.

    ``value_range``: the lowest and highest value over all times. Without it every step is read once, one after the
    other, since transfer function, window and look must not depend on the step. A step with values beyond a given
    range is refused.

    ``steps_per_second`` and ``loop`` are as the keys of [volume]: which step is shown at which time.

    All steps have the same shape, grid, type, slope and offset. VolumeError, which names the step, for one that
    differs. A step that cannot be read is reported (``failures``); the others can be rendered all the same.
    """

    def __init__(
        self,
        steps: Any,
        spacing: Sequence[float] | None = None,
        origin: Sequence[float] | None = None,
        direction: np.ndarray | None = None,
        name: str | None = None,
        *,
        names: Sequence[str] | None = None,
        unit: str | None = None,
        slope: float = 1.0,
        offset: float = 0.0,
        labels: bool = False,
        value_range: Sequence[float] | None = None,
        steps_per_second: float | None = None,
        loop: bool = False,
    ) -> None:
        self.steps_per_second, self.loop = steps_per_second, loop

        def made(array: Any) -> Volume:
            if isinstance(array, Volume):
                return array
            return Volume(array, spacing, origin, direction, unit=unit, slope=slope, offset=offset, labels=labels)

        found = steps_of(steps, made, names)
        self._start(found, name, value_range)

    steps_per_second: float | None = None
    loop = False

    @classmethod
    def of_steps(
        cls, steps: Sequence[Step], name: str | None, value_range: Sequence[float] | None = None
    ) -> VolumeSeries:
        """A series of ``steps`` that are read by themselves."""
        series = cls.__new__(cls)
        series._start(steps, name, value_range)
        return series

    @classmethod
    def of_facts(cls, steps: Sequence[Step], facts: SeriesFacts, name: str | None) -> VolumeSeries:
        """A series of which everything is known but the voxels."""
        series = cls.of_steps(steps, name)
        series._facts = facts
        return series

    def _start(self, steps: Sequence[Step], name: str | None, value_range: Sequence[float] | None) -> None:
        if not steps:
            raise VolumeError("series", "no step", "at least one step")
        self.steps, self.name = tuple(steps), name
        self.files: tuple[str, ...] = tuple(dict.fromkeys(step.path for step in steps if step.path is not None))
        self.ranges: dict[int, StepRange] = {}
        self.failures: dict[int, VolumeError] = {}
        self._given = None if value_range is None else checked_range(value_range)
        self._ahead = ReadAhead(self._read)
        self._views: WeakValueDictionary[tuple[int, bool], StepVolume] = WeakValueDictionary()
        self._facts: SeriesFacts | None = None
        self._like: Volume | None = None  # the first step that was read, without its voxels
        self._mirror: VolumeSeries | None = None
        self._excerpts: dict[bool, Volume] = {}
        self._held: dict[bool, StepVolume] = {}  # what is found out about the widest step is kept with it
        self.surveyed: Callable[[], None] | None = None  # called once all ranges are known

    def __len__(self) -> int:
        return len(self.steps)

    def __repr__(self) -> str:
        nx, ny, nz = self.facts.grid.size
        label = f" {self.name!r}" if self.name else ""
        return f"<VolumeSeries{label} of {len(self)} steps, {nx} x {ny} x {nz} {self.facts.dtype}>"

    # ---- over all times

    @property
    def facts(self) -> SeriesFacts:
        """What all steps have in common. Every step is read for it once, unless the range was given or is known."""
        if self._facts is None:
            self._facts = self._found_facts()
        return self._facts

    def survey(self, progress: Callable[[int, int], None] | None = None) -> SeriesFacts:
        """As ``facts``. ``progress(steps, all)`` is called after each step that is read for it."""
        if self._facts is None:
            self._facts = self._found_facts(progress)
        return self._facts

    def _found_facts(self, progress: Callable[[int, int], None] | None = None) -> SeriesFacts:
        if self._given is not None:
            self._first_readable()
        else:
            for k in range(len(self)):
                self._examine(k, then=k + 1 if k + 1 < len(self) else None)
                if progress is not None:
                    progress(k + 1, len(self))
            if self.surveyed is not None:
                self.surveyed()
        like = self._like
        if like is None:
            raise next(iter(self.failures.values()))
        if self.failures and self._given is None:
            self._warn_of_failures()
        dtype = self._common_type(like)
        if dtype != like.dtype or (self._given is None and len(self) > 1):
            self._ahead.close()  # the last step, in a type of its own
        census, widest = self._census(dtype, like)
        return SeriesFacts(
            like.grid, dtype, like.axis, census, widest, like.frame, like.unit, like.labels,
            getattr(like, "blocks_source", None) is not None, like.format,
        )  # fmt: skip

    def _warn_of_failures(self) -> None:
        number, error = next(iter(self.failures.items()))
        some = "step" if len(self.failures) == 1 else "steps"
        what = f"{len(self.failures)} {some} of {len(self)} cannot be read: step {number}, {error}"
        with FILTERS:
            warnings.warn(ClvolWarning(self.name or "series", what, "the others can be rendered"), stacklevel=3)

    def _first_readable(self) -> None:
        for k in range(len(self)):
            self._examine(k, None)
            if k not in self.failures:
                return

    def _examine(self, k: int, then: int | None) -> None:
        """Finds the range of step ``k``; ``then`` is read meanwhile."""
        step, known = self.steps[k], self._known(k)
        if known is not None:
            volume, self.ranges[k] = known
            self._compare(volume, step)
            return
        try:
            volume = self._ahead.take(k)
        except StepDiffers:
            raise
        except VolumeError as error:
            self.failures[k] = error
            return
        if then is not None and self._known(then) is None:
            self._ahead.begin(then)
        if k not in self.ranges:  # ``_read`` has counted already where a range was given
            self.ranges[k] = range_of(volume)
        if step.remember is not None:
            step.remember(volume, self.ranges[k])

    def _known(self, k: int) -> tuple[Volume, StepRange] | None:
        known = self.steps[k].known
        return None if known is None else known()

    def _common_type(self, like: Volume) -> np.dtype:
        """The type that all steps have; where integers were narrowed, or have holes, the smallest that holds all."""
        names = dict.fromkeys(found.dtype for found in self.ranges.values())
        names.setdefault(like.dtype.name)
        span = None
        if self._given is not None and (self.steps[0].may_convert or like.narrowed) and like.dtype.kind in "iu":
            span = sorted(like.axis.stored(np.array(self._given)).tolist())
        for name in ("uint8", "int8", "uint16", "int16", "float32", "float64"):
            holds = span is None or name == "float64" or holds_whole(np.dtype(name), *span)
            if holds and all(each == name or name in CONVERTIBLE.get(each, ()) for each in names):
                return np.dtype(name)
        return np.dtype(np.float64)

    def _census(self, dtype: np.dtype, like: Volume) -> tuple[Census, int]:
        voxels = math.prod(like.shape)
        if self._given is not None:
            low, high = (float(x) for x in sorted(like.axis.stored(np.array(self._given)).tolist()))
            # Whether any voxel has a hole is not known without reading them all.
            return Census(low, high, int(dtype.kind == "f" and voxels > 1), 0), min(self.ranges, default=0)
        spans = {k: found.span for k, found in self.ranges.items() if found.span is not None}
        nans = max((found.nans for found in self.ranges.values()), default=0)
        infs = max((found.infs for found in self.ranges.values()), default=0)
        if not spans:
            return Census(0.0, 0.0, nans, voxels - nans), min(self.ranges, default=0)
        low, high = min(span[0] for span in spans.values()), max(span[1] for span in spans.values())
        widest = max(spans, key=lambda k: (spans[k][1] - spans[k][0], -k))
        nans = min(nans, voxels - 1)
        return Census(low, high, nans, min(infs, voxels - 1 - nans)), widest

    # ---- steps

    def step(self, k: int) -> StepVolume:
        """The volume of step ``k``, whose voxels are read when they are used."""
        if not 0 <= k < len(self):
            raise VolumeError("series", f"no step {k}", f"0 to {len(self) - 1}")
        return self.view(k, plain=False)

    def view(self, k: int, plain: bool) -> StepVolume:
        """As ``step``; ``plain``: in stored numbers, as if these were values."""
        found = self._views.get((k, plain))
        if found is None:
            found = self._views[k, plain] = StepVolume(self, k, plain)
        return found

    def index(self, wanted: int | str, where: str = "step") -> int:
        """The number of a step by its number, or by its name (with or without folder and ending)."""
        if isinstance(wanted, int):
            if 0 <= wanted < len(self):
                return wanted
            raise VolumeError(where, f"got {wanted} of {len(self)} steps", f"0 to {len(self) - 1}")
        found = [k for k, step in enumerate(self.steps) if wanted in step.spellings]
        if len(found) == 1:
            return found[0]
        if not found and wanted.isdecimal() and int(wanted) < len(self):
            return int(wanted)
        some = ", ".join(step.name for step in self.steps[:4]) + (", ..." if len(self) > 4 else "")
        what = f"got {wanted!r}, which is the name of {len(found)} steps"
        raise VolumeError(where, what, f"a number from 0 to {len(self) - 1}, or one of {some}")

    def volume(self, k: int) -> Volume:
        """Step ``k``, read; the step before it is let go. VolumeError, which names it, if it cannot be read."""
        _ = self.facts
        return self._ahead.take(k)

    def show(self, k: int, volume: Volume) -> None:
        """Takes ``volume`` for step ``k``, as if it had been read."""
        self._ahead.put(k, volume)

    def read_ahead(self, k: int) -> None:
        """Begins to read step ``k`` in a thread, to be used next."""
        if self.facts.reads_blocks:  # blocks are read as they are needed
            return
        if 0 <= k < len(self):
            self._ahead.begin(k)

    def check_unchanged(self) -> None:
        """Nothing: each step is compared when it is read."""

    @property
    def reads(self) -> int:
        """How many times a step has been read."""
        return self._ahead.reads

    def _read(self, k: int) -> Volume:
        """Step ``k`` with its voxels, checked. Called by the thread that reads ahead, too."""
        step = self.steps[k]
        volume = step.read()
        if getattr(volume, "blocks_source", None) is None:
            _ = volume.data  # of a lazy volume
        if self._like is None:
            self._like = without_voxels(volume)
        else:
            self._compare(volume, step)
        if self._given is not None:
            found = self.ranges[k] = range_of(volume)
            check_within(found, volume, self._given, step.name)
        if self._facts is not None and volume.dtype != self._facts.dtype:
            volume = converted(volume, self._facts.dtype, step.name)
        return volume

    def _compare(self, volume: Volume, step: Step) -> None:
        """VolumeError that names ``step`` unless ``volume`` goes with the steps before it."""
        if self._like is None:
            self._like = without_voxels(volume)
        else:
            check_alike(volume, self._like, step, self.steps[0].name)

    def turned(self) -> VolumeSeries:
        """A series whose stored numbers have the reverse order (``clvol.volume.axis.turned``)."""
        if self._mirror is None:
            mirror = copy.copy(self)
            mirror._held, mirror._excerpts = {}, {}
            mirror._views, mirror._ahead = WeakValueDictionary(), ReadAhead(self._read_turned)
            facts = self.facts
            span = np.array([facts.census.lower, facts.census.upper])
            high, low = turned(span, facts.dtype).tolist()
            census = replace(facts.census, lower=low, upper=high)
            mirror._facts = replace(facts, census=census, axis=facts.axis.turned(facts.dtype), reads_blocks=False)
            self._mirror = mirror
        return self._mirror

    def _read_turned(self, k: int) -> Volume:
        volume = self._ahead.take(k)
        self._ahead.close()
        return Volume(turned(volume.data, volume.dtype))

    def close(self) -> None:
        """Lets go of all voxels, once the thread that reads has ended."""
        self._ahead.close()
        if self._mirror is not None:
            self._mirror._ahead.close()


class StepVolume(Volume):
    """One step of a ``series``. Range and counts are those over all times. ``data`` reads the voxels, if they are not
    those in memory; whoever uses them keeps the array, not this volume, in memory."""

    def __init__(self, series: VolumeSeries, number: int, plain: bool = False) -> None:
        facts = series.facts
        self.series, self.number, self._is_plain = series, number, plain
        self.axis = ValueAxis() if plain else facts.axis
        self.grid, self.frame, self.unit, self.labels = facts.grid, facts.frame, facts.unit, facts.labels
        self.name, self.path, self.format = series.name, series.steps[number].path, facts.format
        self.files = ()

    @property
    def data(self) -> np.ndarray:  # type: ignore[override]
        """The voxels [z, y, x]; VolumeError, which names the step, if it cannot be read."""
        return self.series.volume(self.number).data

    @property
    def dtype(self) -> np.dtype:
        return self.series.facts.dtype

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.grid.shape

    @property
    def nbytes(self) -> int:
        return math.prod(self.shape) * self.dtype.itemsize

    @property
    def blocks_source(self) -> Any:
        """That of a clvol store; AttributeError for other volumes."""
        if not self.series.facts.reads_blocks:
            raise AttributeError("blocks_source")
        return self.series.volume(self.number).blocks_source  # type: ignore[attr-defined]

    @property
    def _census(self) -> Census:  # type: ignore[override]
        return self.series.facts.census

    def at(self, number: int) -> StepVolume:
        """Another step of the same series, in the same numbers."""
        return self if number == self.number else self.series.view(number, self._is_plain)

    @property
    def widest(self) -> StepVolume:
        """The step from which is chosen what is chosen for all."""
        return self.series._held.setdefault(self._is_plain, self.at(self.series.facts.widest))

    @property
    def excerpt(self) -> Volume:
        """The middle of ``widest``, at most about ``_EXCERPT`` voxels, which stay in memory: for what is estimated
        again and again while steps and transfer functions change."""
        kept = self.series._excerpts
        if self._is_plain not in kept:
            whole = self.widest
            share = min(1.0, (_EXCERPT / math.prod(self.shape)) ** (1 / 3))
            counts = [max(min(n, 2), round(n * share)) for n in self.shape]
            part = tuple(slice((n - count) // 2, (n - count) // 2 + count) for n, count in zip(self.shape, counts))
            small = Volume(whole.data[part].copy(), self.grid.spacing, slope=self.axis.slope, offset=self.axis.offset)
            vars(small)["_census"] = self._census
            kept[self._is_plain] = small
        return kept[self._is_plain]

    def read(self) -> None:
        """Reads the voxels now, unless they are read by blocks."""
        self.series.volume(self.number)

    def check_unchanged(self) -> None:
        current = self.series._ahead.current(self.number)
        if current is not None:
            current.check_unchanged()

    @property
    def plain(self) -> tuple[Volume, ValueAxis]:
        """As ``Volume.plain``."""
        if self.axis.is_plain:
            return self, self.axis
        if self.axis.slope > 0:
            return self.series.view(self.number, plain=True), self.axis
        mirror = self.series.turned()
        return mirror.view(self.number, plain=True), mirror.facts.axis


def is_other_step(volume: Volume, than: Volume) -> bool:
    """Whether ``volume`` and ``than`` are two steps of one series."""
    return (
        isinstance(volume, StepVolume) and isinstance(than, StepVolume)
        and volume.series is than.series and volume.number != than.number
    )  # fmt: skip
