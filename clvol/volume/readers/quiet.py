"""Keeps libraries quiet on stderr: what is wrong with a file goes into one VolumeError."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from clvol.quietly import FILTERS as _lock
from clvol.quietly import without_warnings

_LOGGERS = ("nibabel", "nibabel.global", "tifffile", "nrrd")


@contextmanager
def quiet() -> Iterator[None]:
    """No Python warnings and no log lines from the format libraries inside the block."""
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    with _lock:
        before = [logger.disabled for logger in loggers]
        try:
            for logger in loggers:
                logger.disabled = True
            with without_warnings():
                yield
        finally:
            for logger, disabled in zip(loggers, before):
                logger.disabled = disabled


@contextmanager
def errors_logged(name: str) -> Iterator[list[str]]:
    """Collects what a library logs at level ERROR instead of raising it, and prints nothing."""
    logger = logging.getLogger(name)
    messages: list[str] = []
    handler = _Collector(messages)
    before = logger.disabled, logger.propagate
    logger.disabled, logger.propagate = False, False
    logger.addHandler(handler)
    try:
        yield messages
    finally:
        logger.removeHandler(handler)
        logger.disabled, logger.propagate = before


class _Collector(logging.Handler):
    def __init__(self, messages: list[str]) -> None:
        super().__init__(logging.ERROR)
        self._messages = messages

    def emit(self, record: logging.LogRecord) -> None:
        self._messages.append(record.getMessage())


@contextmanager
def quiet_native() -> Iterator[None]:
    """Sends the process's stderr (file descriptor 2) to nowhere: MetaIO and GDCM write there."""
    with _lock:
        try:
            saved = os.dup(2)
        except OSError:  # stderr is closed: nothing to keep quiet
            yield
            return
        try:
            if sys.stderr is not None:
                sys.stderr.flush()
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 2)
            os.close(nowhere)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
