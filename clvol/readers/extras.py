"""Libraries of formats that not everybody needs: extras of the package, which a missing one is refused with."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from clvol.errors import VolumeError


def library(name: str, extra: str, path: Path) -> Any:
    """The module ``name``; VolumeError, which names the extra, if it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        what = f"cannot be read, since {name.partition('.')[0]} is not installed"
        raise VolumeError(str(path), what, f"pip install 'clvol[{extra}]'") from None
