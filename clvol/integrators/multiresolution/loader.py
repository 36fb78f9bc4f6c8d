"""Blocks read and unpacked in a thread of their own, in pieces small enough to be staged at once.

The thread knows a source of blocks and nothing of OpenCL.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from clvol.features.vocabulary import BLOCK_CODECS
from clvol.store.source import BlockSource

RAW, CONSTANT = BLOCK_CODECS["raw"], BLOCK_CODECS["constant"]

_MOST_READY = 8  # pieces that wait to be taken


@dataclass(frozen=True, eq=False)
class Request:
    """``blocks`` (numbers) at ``level``."""

    level: int
    blocks: np.ndarray


@dataclass(frozen=True, eq=False)
class Piece:
    """What a ``Request`` brought, as it is staged: block k begins at element ``first[k]`` of
    ``staged``, in ``codec[k]``."""

    level: int
    blocks: np.ndarray
    staged: np.ndarray
    first: np.ndarray
    codec: np.ndarray


def requests(
    blocks: np.ndarray,
    levels: np.ndarray,
    edge: int,
    most_samples: int,
    most_blocks: int,
    window: int,
) -> list[Request]:
    """``blocks`` at ``levels``, in that order but for windows of about ``window`` samples: inside
    one they are by level and then by number, since neighbours at one level are read together.

    No request has more than ``most_samples`` samples or ``most_blocks`` blocks.
    """
    blocks, levels = np.asarray(blocks, np.int64), np.asarray(levels, np.int64)
    sizes = (edge >> levels) ** 3
    windows = (np.cumsum(sizes) - sizes) // window
    order = np.lexsort((blocks, levels, windows))
    blocks, levels, windows = blocks[order], levels[order], windows[order]
    new = (np.diff(levels) != 0) | (np.diff(windows) != 0)
    bounds = [0, *(np.flatnonzero(new) + 1).tolist(), len(blocks)]
    found = []
    for first, last in zip(bounds[:-1], bounds[1:]):
        if first == last:  # no blocks at all
            continue
        level = int(levels[first])
        most = max(min(most_samples // (edge >> level) ** 3, most_blocks), 1)
        found += [Request(level, blocks[k : min(k + most, last)]) for k in range(first, last, most)]
    return found


def staged_piece(request: Request, samples: np.ndarray) -> Piece:
    """``samples`` [k, s, s, s] as they are staged; of blocks that have a single value one sample
    each, after all others."""
    flat = np.ascontiguousarray(samples).reshape(len(samples), -1)
    constant = flat[:, 0] == flat[:, -1]
    rows = np.flatnonzero(constant)
    constant[rows] = (flat[rows] == flat[rows, :1]).all(axis=1)
    count, size = np.count_nonzero(~constant), flat.shape[1]
    first = np.empty(len(flat), np.int32)
    first[~constant] = size * np.arange(count)
    first[constant] = size * count + np.arange(len(flat) - count)
    staged = flat.ravel()
    if count < len(flat):
        staged = np.concatenate([flat[~constant].ravel(), flat[constant, 0]])
    codec = np.where(constant, CONSTANT, RAW).astype(np.int32)
    return Piece(request.level, request.blocks, staged, first, codec)


class Loader:
    """Reads what was last asked for, in order, in one thread that ends when there is no more.

    ``convert``: what becomes of samples before they are staged. No more than a few pieces wait to
    be taken: until then the thread waits too. An error ends what was asked for and is handed out
    by ``take``.
    """

    def __init__(
        self, source: BlockSource, convert: Callable[[np.ndarray], np.ndarray] | None = None
    ) -> None:
        self._source, self._convert = source, convert
        self._condition = threading.Condition()
        self._requests: deque[Request] = deque()
        self._ready: deque[Piece] = deque()
        self._error: Exception | None = None
        self._generation = 0  # of what is asked for: a piece of an older one is dropped
        self._thread: threading.Thread | None = None

    def ask(self, wanted: Iterable[Request]) -> None:
        """Instead of all that was asked for and is not yet taken."""
        with self._condition:
            self._generation += 1
            self._requests = deque(wanted)
            self._ready.clear()
            self._error = None
            self._condition.notify_all()
            if self._requests and self._thread is None:
                self._thread = threading.Thread(target=self._run, name="clvol-blocks", daemon=True)
                self._thread.start()

    def take(self) -> tuple[list[Piece], Exception | None]:
        """What has come since the last call, and what went wrong after that."""
        with self._condition:
            pieces, error = list(self._ready), self._error
            self._ready.clear()
            self._error = None
            self._condition.notify_all()
            return pieces, error

    def wait(self) -> None:
        """Until there is something to take, or nothing to come."""
        with self._condition:
            self._condition.wait_for(lambda: self._ready or self._error or self._thread is None)

    def close(self) -> None:
        """Ends the thread; returns when it has ended."""
        self.ask(())
        with self._condition:
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _run(self) -> None:
        while (work := self._next()) is not None:
            generation, request = work
            piece: Piece | None = None
            error: Exception | None = None
            try:
                piece = self._read(request)
            except Exception as caught:
                error = caught
            with self._condition:
                if piece is not None:
                    self._condition.wait_for(
                        lambda: generation != self._generation or len(self._ready) < _MOST_READY
                    )
                if generation != self._generation:
                    continue
                if piece is not None:
                    self._ready.append(piece)
                else:
                    self._error = error
                    self._requests.clear()
                self._condition.notify_all()

    def _next(self) -> tuple[int, Request] | None:
        """What to read, or None: then the thread has ended, and the next ``ask`` starts another."""
        with self._condition:
            if self._requests:
                return self._generation, self._requests.popleft()
            self._thread = None
            self._condition.notify_all()
            return None

    def _read(self, request: Request) -> Piece:
        samples = self._source.read(request.level, request.blocks)
        return staged_piece(request, samples if self._convert is None else self._convert(samples))
