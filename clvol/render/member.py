"""A device of a Renderer, with the scene that is prepared on it and what is known of how it works."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from time import perf_counter
from typing import Any

import numpy as np

from clvol.integrators.base import PartOfPicture, Prepared, Progress, TiledPictureParts
from clvol.opencl.context import DeviceContext
from clvol.opencl.failures import LacksMemory
from clvol.render.prepared_cache import PreparedCache
from clvol.scene.resolve import ResolvedScene
from clvol.text import one_line
from clvol.volume.series import is_other_step

_SPEED = 2e8  # cost per second and compute unit, as a first guess
_HALVINGS = 4  # of the tiles that a device renders at once, while it lacks memory


class Member:
    """A device of a Renderer.

    ``prepared``: ``scene``, ready to be rendered. ``speed``: in cost per second, which differs by the share
    ``unsteady`` from package to package (as ``Dispatcher`` takes it). ``lost``: why it is not used any more; a context
    that has failed does not recover, so it stays out while the Renderer is open. ``busy``: what it has not ended when a
    frame was complete without it; until then it takes no part in frames. ``writes_in_place``: whether tiles that it has
    rendered are in the arrays of the picture at once.
    """

    name: str
    units: int
    writes_in_place: bool

    def __init__(self) -> None:
        self.prepared: Prepared | None = None
        self.scene: ResolvedScene | None = None
        self.speed = _SPEED * max(self.units, 1)
        self.unsteady: float | None = 0.0
        self.lost: str | None = None
        self.busy: Future | None = None
        self._busy_since = 0.0
        self._most_tiles = 0  # that it renders at once; 0: any number
        self._halvings = 0

    @property
    def works(self) -> bool:
        return self.lost is None and (self.busy is None or self.busy.done())

    def leave_busy(self, work: Future) -> None:
        self.busy, self._busy_since = work, perf_counter()

    @property
    def busy_seconds(self) -> float:
        """How long it has not returned from what it did for an earlier frame."""
        return 0.0 if self.busy is None or self.busy.done() else perf_counter() - self._busy_since

    def interrupt(self, reason: str) -> None:
        """Ends what the device does, if that is possible."""

    def prepare(self, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None) -> None:
        """Makes ``resolved`` the scene that is rendered (``PreparedCache.prepare``)."""
        raise NotImplementedError

    def compression(self, resolved: ResolvedScene, blocks: Mapping[str, Any] | None) -> dict[str, Any]:
        """As ``PreparedCache.compression``."""
        raise NotImplementedError

    def take_compile_seconds(self) -> float:
        """Seconds that compilers took since the last call."""
        raise NotImplementedError

    def close(self) -> None:
        """Frees the device's memory."""
        raise NotImplementedError

    def render_part(self, part: TiledPictureParts, stage: int, tiles: np.ndarray) -> PartOfPicture:
        """``tiles`` of a picture. While the device lacks memory, fewer at once, from then on."""
        found: list[PartOfPicture] = []
        first = 0
        while first < len(tiles):
            piece = tiles[first : first + self._most_tiles] if self._most_tiles else tiles
            try:
                found.append(part.render(stage, piece))
            except (LacksMemory, MemoryError):
                if self._halvings == _HALVINGS or len(piece) == 1:
                    raise
                self._halvings += 1
                self._most_tiles = len(piece) // 2
                continue
            first += len(piece)
        return found[0] if len(found) == 1 else _joined(found)


class LocalMember(Member):
    """A device that this process uses itself."""

    def __init__(self, context: DeviceContext) -> None:
        self.context, self.cache = context, PreparedCache(context)
        self.name, self.units = context.name, int(context.device.max_compute_units)
        super().__init__()
        if context.uses_all_threads:
            self.unsteady = None

    @property
    def writes_in_place(self) -> bool:  # type: ignore[override]
        return self.context.is_cpu

    def prepare(self, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None) -> None:
        if self.prepared is not None and is_other_step(self.prepared.resolved.volume, resolved.volume):
            self.prepared = None  # its volume is needed for this step, or its memory
        self.prepared = self.cache.prepare(resolved, progress, wait)

    def compression(self, resolved: ResolvedScene, blocks: Mapping[str, Any] | None) -> dict[str, Any]:
        return self.cache.compression(resolved, blocks)

    def take_compile_seconds(self) -> float:
        seconds, self.context.compile_seconds = self.context.compile_seconds, 0.0
        return seconds

    def close(self) -> None:
        if self.busy is not None and not self.busy.done():
            return  # a driver that does not return would not return from this, either
        self.cache.close()
        self.context.release()


def _joined(parts: list[PartOfPicture]) -> PartOfPicture:
    counters: dict[str, int] = {}
    for part in parts:
        for name, count in part.counters.items():
            counters[name] = counters.get(name, 0) + count
    costs = np.concatenate([part.costs for part in parts])
    return PartOfPicture(costs, sum(p.samples for p in parts), sum(p.rays for p in parts), counters)


def reason_of(error: BaseException) -> str:
    """``error`` in one line."""
    return one_line(" ".join(str(error).split()) or type(error).__name__)


