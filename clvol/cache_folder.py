"""The user's folder for what clvol keeps from run to run: programs, and ranges of series."""

from __future__ import annotations

from pathlib import Path


def cache_folder() -> Path | None:
    """The user's cache folder for clvol (``XDG_CACHE_HOME`` respected), or None where there is none."""
    import platformdirs

    try:
        folder = platformdirs.user_cache_path("clvol")
        if not folder.is_absolute():  # the XDG specification says to ignore such a path
            folder = Path("~/.cache/clvol").expanduser()
    except (OSError, RuntimeError, KeyError, ValueError):
        return None
    # Nobody's home is no place beside the data: "~" stays where neither HOME nor a user is known.
    return folder if folder.is_absolute() else None
