"""Where the repository and what lies beside it are."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
VOLUMES = ROOT.parent / "shared" / "volumes"  # real volumes, which may be missing
