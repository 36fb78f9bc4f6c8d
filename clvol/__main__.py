"""``python -m clvol`` runs the command ``clvol``."""

from __future__ import annotations

from clvol.cli.ending import command_line

if __name__ == "__main__":
    command_line()
