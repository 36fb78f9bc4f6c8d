"""``python -m clvol``: the same as the command ``clvol``."""

from __future__ import annotations

import sys

from clvol.cli import main

if __name__ == "__main__":
    sys.exit(main())
