"""ruff finds nothing, and mypy no more than tests/types_baseline.json says, file by file."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from helpers.paths import ROOT
from helpers.type_errors import BASELINE, type_errors

UPDATE = "python tests/helpers/type_errors.py"


def test_ruff_finds_nothing():
    pytest.importorskip("ruff", reason="ruff is not installed: it is in the extra `test`")
    done = subprocess.run([sys.executable, "-m", "ruff", "check", "."], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_types_have_no_more_errors_than_are_known():
    pytest.importorskip("mypy", reason="mypy is not installed: it is in the extra `test`")
    found, told = type_errors()
    known = json.loads(BASELINE.read_text(encoding="utf-8"))
    more = {file: n for file, n in found.items() if n > known.get(file, 0)}
    lines = [line for line in told.splitlines() if line.partition(":")[0] in more]
    assert not more, "more errors than before:\n" + "\n".join(lines)
    fewer = {file: n for file, n in known.items() if found.get(file, 0) < n}
    assert not fewer, f"fewer errors than before in {sorted(fewer)}; say so by `{UPDATE}`"
