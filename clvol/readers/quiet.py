"""Keeps format libraries from writing to stderr: mistakes in files are reported by one VolumeError."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from clvol.quietly import FILTERS as _lock
from clvol.quietly import without_warnings

_LOGGERS = ("nibabel", "nibabel.global", "tifffile", "nrrd", "pydicom", "mrcfile", "bioio", "xarray")


@contextmanager
def quiet() -> Iterator[None]:
    """A context without Python warnings and log lines of the format libraries."""
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
    """A context that raises what a library only logs at level ERROR, and prints nothing. Messages whose exceptions
    the library catches itself are in the list.
    """
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


class LoggedError(Exception):
    """A message that a library has logged. Continuing could take forever, since every page of a file may fail."""


class _Collector(logging.Handler):
    def __init__(self, messages: list[str]) -> None:
        super().__init__(logging.ERROR)
        self._messages = messages

    def emit(self, record: logging.LogRecord) -> None:
        self._messages.append(record.getMessage())
        raise LoggedError(self._messages[0])
