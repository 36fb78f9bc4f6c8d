"""How many errors mypy finds in each file of clvol/ (its settings are in setup.cfg).

    python tests/helpers/type_errors.py      # writes them to tests/types_baseline.json, which may only shrink
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BASELINE = ROOT / "tests" / "types_baseline.json"


def type_errors() -> tuple[dict[str, int], str]:
    """Errors by file, and what mypy says. RuntimeError where mypy itself fails."""
    command = [sys.executable, "-m", "mypy", "--no-error-summary"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise RuntimeError(done.stdout + done.stderr)
    files = re.findall(r"^(\S+?):\d+(?::\d+)?: error:", done.stdout, re.MULTILINE)
    return dict(sorted(Counter(file.replace("\\", "/") for file in files).items())), done.stdout


def main() -> int:
    found, _ = type_errors()
    BASELINE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"{sum(found.values())} errors in {len(found)} files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
