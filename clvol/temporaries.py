"""Temporary files, and who makes them: a process that is killed cannot remove its own, so that others must know them.

The name of a temporary file holds its process (``temporary_name``). Once that process has ended, whoever works in the
same folder may remove the file (``remove_leftovers``). Numbers of processes are used again, so a process is known by
its number, by when it began and by the start of its machine.
"""

from __future__ import annotations

import os
import re
import secrets
import socket
import zlib
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

_NAME = re.compile(r"\.([0-9a-f]{8})-(\d+)-(\d+)-[0-9a-f]{12}\.part(\..*)?")


@dataclass(frozen=True)
class Process:
    """The process ``pid``, begun at ``begun`` in the machine's clock ticks (0: not known), of the machine ``host``,
    which has been up since ``boot`` ("": not known)."""

    host: str
    boot: str
    pid: int
    begun: int

    @property
    def has_ended(self) -> bool:
        """Whether it has ended for certain: False for processes of other machines."""
        return is_here(self) and _begun(self.pid) != self.begun

    @property
    def label(self) -> str:
        """Names it in the names of files."""
        return f"{_machine(self.host, self.boot)}-{self.pid}-{self.begun}"


def this_process() -> Process:
    return _process(os.getpid())


@lru_cache(maxsize=1)
def _process(pid: int) -> Process:
    """This process, whose number is ``pid``; a fork has another one."""
    return Process(socket.gethostname(), _boot(), pid, _begun(pid))


def is_here(process: Process) -> bool:
    """Whether it is, or was, a process of this machine since its last start."""
    me = this_process()
    return bool(process.boot) and (process.host, process.boot) == (me.host, me.boot)


def temporary_name(ending: str = "") -> str:
    """A new name for a temporary file of this process. ``ending``: of the file that it becomes, such as ".png"."""
    return f".{this_process().label}-{secrets.token_hex(6)}.part{ending}"


def remove_leftovers(folder: str | os.PathLike[str]) -> None:
    """Removes the temporary files in ``folder`` whose processes ran on this machine and have ended. Those of other
    machines stay, since nobody here can tell a process that has ended from one that sleeps. What cannot be read or
    removed is left."""
    me = this_process()
    if not me.boot:
        return
    here = _machine(me.host, me.boot)
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            known = _NAME.fullmatch(entry.name)
            if known is None:
                continue
            if known[1] == here and _begun(int(known[2])) != int(known[3]):
                with suppress(OSError):
                    os.unlink(entry.path)


def _machine(host: str, boot: str) -> str:
    return f"{zlib.crc32(f'{host} {boot}'.encode()):08x}"


def _boot() -> str:
    """Differs for each start of the machine, and for containers with process numbers of their own."""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    return ""


def _begun(pid: int) -> int:
    """When process ``pid`` of this machine began; 0 if there is none, or if that is not known."""
    with suppress(OSError, ValueError, IndexError):
        text = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        fields = text.rpartition(")")[2].split()
        return 0 if fields[0] in "ZX" else int(fields[19])
    return 0
