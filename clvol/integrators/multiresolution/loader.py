"""Reads and unpacks blocks in a thread of their own, in pieces small enough to be staged at once.

The thread uses a source of blocks and no OpenCL.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import cast

import numpy as np

from clvol.features.vocabulary import BLOCK_CODECS
from clvol.integrators.multiresolution.coded_source import FEWEST, CodedSource, is_coded
from clvol.store.codecs.coded_blocks import CodedBlocks
from clvol.store.source import BlockSource

RAW, CONSTANT = BLOCK_CODECS["raw"], BLOCK_CODECS["constant"]

_MOST_READY = 8  # pieces waiting to be taken


@dataclass(frozen=True, eq=False)
class Request:
    """``blocks`` (numbers) at ``level``."""

    level: int
    blocks: np.ndarray


@dataclass(frozen=True, eq=False)
class Piece:
    """The blocks of a ``Request``, ready to be staged: block k begins at element ``first[k]`` of
    ``staged``, encoded by ``codec[k]``."""

    level: int
    blocks: np.ndarray
    staged: np.ndarray
    first: np.ndarray
    codec: np.ndarray


@dataclass(frozen=True, eq=False)
class CodedPiece:
    """The blocks of a ``Request`` as codes."""

    level: int
    blocks: np.ndarray
    coded: CodedBlocks


def requests(
    blocks: np.ndarray,
    levels: np.ndarray,
    edge: int,
    most_samples: int,
    most_blocks: int,
    window: int,
) -> list[Request]:
    """Requests for ``blocks`` at ``levels``, in that order, except that within windows of about ``window`` samples
    they are sorted by level and then by number, since neighbours at one level are read together.

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
    """``samples`` [k, s, s, s] as a piece; blocks of a single value have one sample
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
    """Reads the latest requests, in order, in one thread that ends when there are no more. Of a source of codes,
    pieces are codes at all levels that have them.

    ``convert`` is applied to samples before they are staged. Only a few pieces wait to
    be taken at a time; then the thread waits, too. An error cancels all requests and is returned
    by ``take``.
    """

    def __init__(
        self, source: BlockSource, convert: Callable[[np.ndarray], np.ndarray] | None = None
    ) -> None:
        self._source, self._convert = source, convert
        self._codes = cast(CodedSource, source) if is_coded(source) else None
        self._condition = threading.Condition()
        self._requests: deque[Request] = deque()
        self._ready: deque[Piece | CodedPiece] = deque()
        self._error: Exception | None = None
        self._generation = 0  # of the requests: pieces of older ones are dropped
        self._thread: threading.Thread | None = None

    def ask(self, wanted: Iterable[Request]) -> None:
        """Replaces all requests, and discards pieces that have not been taken."""
        with self._condition:
            self._generation += 1
            self._requests = deque(wanted)
            self._ready.clear()
            self._error = None
            self._condition.notify_all()
            if self._requests and self._thread is None:
                self._thread = threading.Thread(target=self._run, name="clvol-blocks", daemon=True)
                self._thread.start()

    def take(self) -> tuple[list[Piece | CodedPiece], Exception | None]:
        """The pieces that have arrived since the last call, and the error that followed them, if there was one."""
        with self._condition:
            pieces, error = list(self._ready), self._error
            self._ready.clear()
            self._error = None
            self._condition.notify_all()
            return pieces, error

    def wait(self) -> None:
        """Waits until there is something to take, or nothing more will arrive."""
        with self._condition:
            self._condition.wait_for(lambda: self._ready or self._error or self._thread is None)

    def close(self) -> None:
        """Ends the thread, and returns once it has ended."""
        self.ask(())
        with self._condition:
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()

    def _run(self) -> None:
        while (work := self._next()) is not None:
            generation, request = work
            piece: Piece | CodedPiece | None = None
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
        """The next request, or None: then the thread has ended, and the next ``ask`` starts another one."""
        with self._condition:
            if self._requests:
                return self._generation, self._requests.popleft()
            self._thread = None
            self._condition.notify_all()
            return None

    def _read(self, request: Request) -> Piece | CodedPiece:
        if self._codes is not None and self._source.blocks.samples(request.level) >= FEWEST:
            codes = self._codes.read_codes(request.level, request.blocks)
            return CodedPiece(request.level, request.blocks, codes)
        samples = self._source.read(request.level, request.blocks)
        return staged_piece(request, samples if self._convert is None else self._convert(samples))
