"""Dask's logs, which are kept from the terminal."""

from __future__ import annotations

import logging


def silence() -> None:
    """Keeps dask's logs from the terminal: most of what they say is about workers that end, which is handled here."""
    for name in [*logging.root.manager.loggerDict, "distributed"]:
        if name.split(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
