"""Zarr images by URL (http, https, s3, gs), through tensorstore.

``RemotePath`` has those methods of ``pathlib.Path`` that reading Zarr metadata needs. HTTP cannot list a folder: the
members of a group are those of its consolidated metadata, or else are called 0, 1, 2, ...
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from clvol.errors import VolumeError
from clvol.store.arrays import system_words, tensorstore_context

_URL = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+)://(?P<rest>.*)", re.DOTALL)
SCHEMES = ("http", "https", "s3", "gs")
EXPECTED = "a Zarr image by http://, https://, s3:// or gs://"
SECONDS = 20.0  # to the answer to one request for metadata
_MOST_MEMBERS = 100
_MARKS = ("zarr.json", ".zarray", ".zgroup")


def is_url(path: str | os.PathLike) -> bool:
    """Whether ``path`` is a URL of whatever scheme, and not the name of a file."""
    return _URL.match(os.fspath(path)) is not None


class RemotePath:
    """A place below a URL. ``str()`` is the URL as it was typed, with what was appended."""

    def __init__(self, url: str, root: _Root | None = None, key: str = "") -> None:
        self._url, self._key = url, key
        self._root = root or _Root(url)

    def __truediv__(self, name: str) -> RemotePath:
        return RemotePath(f"{self._url.rstrip('/')}/{name}", self._root, f"{self._key}{name}/")

    def joinpath(self, *names: str) -> RemotePath:
        path = self
        for name in names:
            path = path / name
        return path

    def __str__(self) -> str:
        return self._url

    @property
    def name(self) -> str:
        return self._url.partition("?")[0].rstrip("/").rpartition("/")[2]

    def resolve(self) -> RemotePath:
        return self

    def exists(self) -> bool:
        """Whether there is a file of this name; folders are none."""
        return self._root.read(self._key.rstrip("/")) is not None

    def is_file(self) -> bool:
        return self.exists()

    def is_dir(self) -> bool:
        return any((self / mark).exists() for mark in _MARKS)

    def read_text(self, encoding: str = "utf-8") -> str:
        return (self._root.read(self._key.rstrip("/")) or b"").decode(encoding)

    def stat(self) -> SimpleNamespace:
        return SimpleNamespace(st_size=len(self._root.read(self._key.rstrip("/")) or b""))

    def iterdir(self) -> Iterator[RemotePath]:
        """The members of a group."""
        names = self._consolidated()
        if names is not None:
            yield from (self / name for name in names)
            return
        for k in range(_MOST_MEMBERS):
            if not (child := self / str(k)).is_dir():
                return
            yield child

    def _consolidated(self) -> list[str] | None:
        """The members' names by consolidated metadata, of Zarr v3 or v2; None without them."""
        for mark, find in (("zarr.json", _members_v3), (".zmetadata", _members_v2)):
            file = self / mark
            if not file.exists():
                continue
            try:
                found = find(json.loads(file.read_text()))
            except (ValueError, AttributeError, TypeError, RecursionError):
                continue
            if found is not None:
                return sorted({name.split("/")[0] for name in found})[:_MOST_MEMBERS]
        return None

    def kvstore(self) -> dict[str, Any]:
        """The specification of this folder for tensorstore."""
        spec = dict(self._root.spec)
        if "path" in spec:
            spec["path"] += self._key
        else:
            spec["base_url"] += self._key
        return spec


def _members_v3(metadata: Any) -> list[str] | None:
    inside = (metadata.get("consolidated_metadata") or {}).get("metadata")
    return None if inside is None else list(inside)


def _members_v2(metadata: Any) -> list[str] | None:
    return [key for key in metadata.get("metadata") or {} if "/" in key]


Place = Path | RemotePath


class _Root:
    """What is read of one URL; small files are kept."""

    def __init__(self, url: str) -> None:
        self._url, self.spec = url, _spec(url)
        self._files: dict[str, bytes | None] = {}
        self._store: Any = None

    def read(self, key: str) -> bytes | None:
        """The content of a file, or None if there is none. VolumeError if the URL cannot be had."""
        if key not in self._files:
            try:
                if self._store is None:
                    import tensorstore

                    opened = tensorstore.KvStore.open(self.spec, context=tensorstore_context())
                    self._store = opened.result(timeout=SECONDS)
                found = self._store.read(key).result(timeout=SECONDS)
            except TimeoutError:
                what = f"no answer within {SECONDS:g} seconds"
                raise VolumeError(self._url, what, "a URL that can be reached") from None
            except ValueError as error:
                what = f"cannot be read ({_reason(str(error))})"
                raise VolumeError(self._url, what, "a URL that can be reached") from None
            self._files[key] = bytes(found.value) if found.state == "value" else None
        return self._files[key]


def _reason(text: str) -> str:
    """The part of tensorstore's message that says what happened."""
    match = re.search(r"Could not [^:]*: ([^\[]*)|(HTTP response code: \d+)", text)
    return system_words(next(filter(None, match.groups()), text) if match else text).strip()


def _spec(url: str) -> dict[str, Any]:
    match = _URL.match(url)
    scheme = match["scheme"].lower() if match else ""
    if match is None or scheme not in SCHEMES:
        raise VolumeError(url, f"a URL of the scheme {scheme!r}", EXPECTED)
    if scheme in ("http", "https"):
        if "?" in url or "#" in url:
            raise VolumeError(url, "a URL with a query or a fragment", "the URL of a folder")
        return {"driver": "http", "base_url": url.rstrip("/") + "/"}
    bucket, _, path = match["rest"].partition("/")
    if not bucket:
        raise VolumeError(url, "no bucket", f"{scheme}://BUCKET/PATH")
    path = path.rstrip("/") + "/" if path.rstrip("/") else ""
    if scheme == "gs":
        return {"driver": "gcs", "bucket": bucket, "path": path}
    spec: dict[str, Any] = {"driver": "s3", "bucket": bucket, "path": path}
    if endpoint := os.environ.get("AWS_ENDPOINT_URL"):
        spec |= {"endpoint": endpoint, "aws_region": os.environ.get("AWS_REGION", "us-east-1")}
    if not _has_aws_account():
        spec["aws_credentials"] = {"type": "anonymous"}
    return spec


def _has_aws_account() -> bool:
    named = any(os.environ.get(name) for name in ("AWS_ACCESS_KEY_ID", "AWS_PROFILE", "AWS_ROLE_ARN"))
    return named or Path("~/.aws/credentials").expanduser().exists()
