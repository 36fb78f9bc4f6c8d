"""Claims: processes of any machine that share a folder agree on who makes which file, without a server or locks.

A claim is a small file beside the one that is made. It appears by a hard link to a file that is complete already, which
is atomic on local file systems and on NFS (open(2) of Linux recommends it there), or by exclusive creation where a file
system has no hard links. Its owner touches it every few seconds; a claim that nobody has touched for long, or whose
process on this machine has ended, is stale.

A stale claim is not replaced, since two processes could find it at the same time and one would remove the claim of the
other. Instead it has at most one successor, whose name holds the token of the stale claim, and which is created in
the same atomic way. Who owns the file is said by the last claim of this chain.

Times are those of the file system alone: clocks of different machines need not agree.
"""

from __future__ import annotations

import errno
import json
import os
import secrets
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clvol.errors import RenderError
from clvol.temporaries import Process, is_here, remove_leftovers, temporary_name, this_process

STALE = 60.0  # seconds without a sign of life
_TOUCH = 5.0  # seconds between signs of life
_LONGEST_CHAIN = 1000


@dataclass(frozen=True)
class Owner(Process):
    """The process that has made a claim. ``token`` differs for each claim."""

    token: str


class Claims:
    """The claims of this process in any folders. Signs of life are given by a thread, while there are claims.

    ``stale``: seconds without a sign of life after which a claim of another machine counts no more.
    """

    def __init__(self, stale: float = STALE) -> None:
        self._stale = stale
        self._own: dict[str, list[Path]] = {}  # chain of claims by claimed file, the own one last
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> Claims:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Gives up all claims."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        for path in list(self._own):
            self.release(path)

    def claim(self, path: str | os.PathLike[str]) -> bool:
        """Whether ``path`` is this process's to make: False while another one that lives has claimed it. RenderError if
        the folder does not let a claim be created."""
        target = os.path.realpath(path)
        if target in self._own:
            return True
        try:
            chain = self._append(Path(target))
        except OSError as error:
            raise RenderError(str(path), f"no claim can be created beside it: {error.strerror or error}") from error
        if chain is None:
            return False
        if len(chain) > 1:
            remove_leftovers(os.path.dirname(target))
        with self._lock:
            self._own[target] = chain
        if self._thread is None:
            self._stop.clear()
            self._thread = threading.Thread(target=self._give_signs, name="clvol-claims", daemon=True)
            self._thread.start()
        return True

    def release(self, path: str | os.PathLike[str]) -> None:
        """Removes the own claim. Others may then claim ``path``, so it must be made, or given up, by then."""
        with self._lock:
            chain = self._own.pop(os.path.realpath(path), [])
        for claim in chain:  # the first one first: see _append
            with suppress(OSError):
                claim.unlink()

    def owns(self, path: str | os.PathLike[str]) -> bool:
        """Whether the own claim still counts: a process that was stopped for long may have lost it."""
        target = Path(os.path.realpath(path))
        with self._lock:
            chain = self._own.get(str(target))
        if not chain:
            return False
        own = _read(chain[-1])
        return own is not None and own.pid == os.getpid() and _read(_place(target, own.token)) is None

    @contextmanager
    def of(self, path: str | os.PathLike[str]) -> Iterator[bool]:
        """Yields whether ``path`` was claimed; releases it after the block."""
        claimed = self.claim(path)
        try:
            yield claimed
        finally:
            if claimed:
                self.release(path)

    def _append(self, target: Path) -> list[Path] | None:
        """The chain of claims of ``target`` with an own one at its end; None if somebody else owns it."""
        chain: list[tuple[Path, str]] = []
        while len(chain) < _LONGEST_CHAIN:
            claim = _place(target, chain[-1][1] if chain else "")
            owner = _read(claim)
            if owner is None:
                own = _me(secrets.token_hex(8))
                if _create(claim, own):
                    # Someone who releases a chain removes its first claim first. If all claims before this one are
                    # still there, nobody else can begin another chain.
                    if all((found := _read(each)) is not None and found.token == known for each, known in chain):
                        return [*(each for each, _ in chain), claim]
                    claim.unlink()
                chain.clear()
                continue  # somebody was faster, or has just released it
            if not self._is_stale(claim, owner):
                return None
            chain.append((claim, owner.token))
        raise OSError(errno.ELOOP, "too many claims were given up")

    def _is_stale(self, claim: Path, owner: Owner) -> bool:
        if is_here(owner):
            return owner.has_ended
        try:
            return _now(claim.parent) - claim.stat().st_mtime > self._stale
        except OSError:
            return False

    def _give_signs(self) -> None:
        while not self._stop.wait(_TOUCH):
            with self._lock:
                claims = [chain[-1] for chain in self._own.values()]
            for claim in claims:
                with suppress(OSError):
                    os.utime(claim)


def _place(target: Path, token: str) -> Path:
    """The claim of ``target`` that follows one with ``token``; the first one without."""
    return target.parent / f".{target.name}{f'.{token}' if token else ''}.claim"


def _create(claim: Path, owner: Owner) -> bool:
    """Whether ``claim`` did not exist and now does, whole."""
    draft = claim.parent / temporary_name()
    try:
        with open(draft, "x", encoding="utf-8") as file:
            json.dump(vars(owner), file)
        try:
            os.link(draft, claim)
        except FileExistsError:
            return False
        except OSError:
            if draft.stat().st_nlink == 2:  # it was linked, but the answer was lost, as may happen on NFS
                return True
            return _create_exclusively(claim, owner)
        return True
    finally:
        with suppress(OSError):
            draft.unlink()


def _create_exclusively(claim: Path, owner: Owner) -> bool:
    """As ``_create``, for file systems without hard links."""
    try:
        with open(claim, "x", encoding="utf-8") as file:
            json.dump(vars(owner), file)
    except FileExistsError:
        return False
    return True


def _read(claim: Path) -> Owner | None:
    """Who has made ``claim``; None if it does not exist."""
    try:
        text = claim.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    try:
        known: dict[str, Any] = json.loads(text)
        host, boot, token = (str(known[name]) for name in ("host", "boot", "token"))
        return Owner(host, boot, int(known["pid"]), int(known["begun"]), token)
    except (ValueError, KeyError, TypeError):  # being written, without hard links; or damaged
        return Owner("", "", 0, 0, f"{zlib.crc32(text.encode()):08x}")


def _now(folder: Path) -> float:
    """The time of the file system."""
    probe = folder / temporary_name()
    with open(probe, "x"):
        pass
    try:
        return probe.stat().st_mtime
    finally:
        with suppress(OSError):
            probe.unlink()


def _me(token: str) -> Owner:
    return Owner(**vars(this_process()), token=token)
