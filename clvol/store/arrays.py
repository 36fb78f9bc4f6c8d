"""Zarr arrays by tensorstore: opened with little memory, with readable errors."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

from clvol.errors import VolumeError

_OPEN_FILES = 8
_RETRIES = {"max_retries": 2, "initial_delay": "200ms", "max_delay": "2s"}


def open_array(
    path: Any, metadata: dict | None = None, *, driver: str = "zarr3", whole: bool = True
) -> Any:
    """The tensorstore array in the folder ``path`` (a Path, or a place with a ``kvstore``).

    With ``metadata`` it is created if it does not exist.
    ``whole``: every chunk must exist; a missing one does not stand for the fill value. ValueErrors of tensorstore
    pass.
    """
    import tensorstore

    if hasattr(path, "kvstore"):  # a URL
        spec: dict[str, Any] = {"driver": driver, "kvstore": path.kvstore()}
    else:
        place = f"{path.resolve()}/"
        if not is_utf8(place):
            raise ValueError(NOT_UTF8)
        spec = {"driver": driver, "kvstore": {"driver": "file", "path": place}}
    spec |= {"recheck_cached_metadata": "open", "recheck_cached_data": True}
    if whole:
        spec |= {"fill_missing_data_reads": False, "store_data_equal_to_fill_value": True}
    if metadata is not None:
        left = {
            key: value for key, value in metadata.items() if key not in ("zarr_format", "node_type")
        }
        spec |= {"metadata": left, "open": True, "create": True}
    return tensorstore.open(spec, context=tensorstore_context()).result()


NOT_UTF8 = "a name that is not UTF-8, which tensorstore cannot open"


def is_utf8(path: str) -> bool:
    """Whether the name is valid text. Python represents undecodable bytes as surrogates."""
    return not re.search("[\ud800-\udfff]", path)


def cores() -> int:
    """The number of processor cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


_made: list = []


def tensorstore_context() -> Any:
    """The context of all arrays. Nothing is cached, so only the data that are read take memory."""
    if not _made:
        import tensorstore

        _made.append(
            tensorstore.Context(
                {
                    "cache_pool": {"total_bytes_limit": 0},
                    "data_copy_concurrency": {"limit": cores()},
                    "file_io_concurrency": {"limit": _OPEN_FILES},
                    "http_request_retries": _RETRIES,
                    "s3_request_retries": _RETRIES,
                    "gcs_request_retries": _RETRIES,
                }
            )
        )
    return _made[0]


def what_failed(error: BaseException) -> str:
    """A short description of a failed read."""
    text = str(error)
    if text.startswith("NOT_FOUND"):
        return "is missing"
    if "igest mismatch" in text or "hecksum" in text or "CRC" in text:
        return "checksum does not match"
    if text.startswith(("DATA_LOSS", "OUT_OF_RANGE", "INVALID_ARGUMENT", "FAILED_PRECONDITION")):
        return "is damaged"
    return f"cannot be read ({system_words(text)})"


def system_words(text: str) -> str:
    """The system's own message within one of tensorstore, such as 'No space left on device'."""
    code = re.search(r"os_error_code='(\d+)'", text)
    if code is not None:
        return os.strerror(int(code[1]))
    line = text.splitlines()[0] if text else "unknown error"
    return line.split(" [tensorstore_spec=")[0][:160]


def read_json(path: Path, where: str) -> Any:
    """The contents of a JSON file; VolumeError if it is not JSON. OSError passes."""
    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe would block
        raise VolumeError(where, f"{path.name} is not a regular file", "JSON")
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        raise VolumeError(where, f"{path.name} is damaged", "JSON") from None
