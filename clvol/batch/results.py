"""What became of the pictures of a job: lines of JSON, which processes append to one file."""

from __future__ import annotations

import hashlib
import json
import os
from typing import Any

from clvol.errors import RenderError
from clvol.json_values import plain
from clvol.text import json_escaped


def line_of(result: dict[str, Any]) -> str:
    """``result`` as one line. Infinities and NaN become null."""
    return json_escaped(json.dumps(plain(result), ensure_ascii=False, allow_nan=False))


def append(path: str, result: dict[str, Any]) -> None:
    """Appends a line to the file ``path`` in one write, so that lines of several processes do not mix."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(descriptor, (line_of(result) + "\n").encode())
        finally:
            os.close(descriptor)
    except OSError as error:
        raise RenderError(path, f"the file cannot be written: {error.strerror or error}") from error


def results_in(path: str) -> list[dict[str, Any]]:
    """The results in the file ``path``, in its order; none if it cannot be read."""
    return ResultsReader(path).new()


class ResultsReader:
    """Reads the results that processes append to the file ``path``, each once. Lines that are no results are left out:
    a process may have been killed while it wrote one."""

    def __init__(self, path: str) -> None:
        self._path = path
        self._read = 0  # bytes

    def new(self) -> list[dict[str, Any]]:
        """Those since the last call."""
        try:
            with open(self._path, "rb") as file:
                file.seek(self._read)
                text = file.read()
        except OSError:
            return []
        whole = text[: text.rfind(b"\n") + 1]
        self._read += len(whole)
        return [result for line in whole.splitlines() if (result := _result(line)) is not None]


def _result(line: bytes) -> dict[str, Any] | None:
    try:
        result = json.loads(line.decode("utf-8", errors="replace"))
    except ValueError:
        return None
    return result if isinstance(result, dict) and isinstance(result.get("files"), list) else None


def digest_of(request: Any) -> str:
    """16 hexadecimal digits that differ where ``request``, of JSON values, does."""
    text = json.dumps(plain(request), sort_keys=True, ensure_ascii=False)
    return hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).hexdigest()
