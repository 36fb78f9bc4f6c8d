"""Reads mutated copies of good files: run as a program, since a crash must not take the tests along.

    python mutated_files.py FOLDER SEED COUNT

FOLDER holds a good file or folder of each kind. Prints a JSON object: how many were read, how many
refused, and what was neither. Kinds and changes depend on the seed alone.
"""

from __future__ import annotations

import json
import random
import resource
import shutil
import sys
import time
import warnings
from pathlib import Path

_CAP = 64 << 20
_SLOWEST = 10.0  # seconds a file, on a machine that others use, too


def change(raw: bytes, dice: random.Random) -> bytes:
    """A few bytes, mostly of the header, set to what breaks parsers; or a piece cut or doubled."""
    data = bytearray(raw)
    for _ in range(dice.randint(1, 4)):
        if not data:
            break
        head = min(len(data), dice.choice((64, 400, 2000, len(data))))
        at = dice.randrange(head)
        how = dice.randrange(6)
        if how == 0:
            data[at] = dice.choice((0, 1, 0x7F, 0x80, 0xFF, dice.randrange(256)))
        elif how == 1:
            data[at : at + 4] = dice.choice((b"\xff\xff\xff\x7f", b"\xff" * 4, b"\0" * 4))
        elif how == 2:
            data[at : at + 2] = dice.choice((b"\xff\xff", b"\0\0", b"\0\x80"))
        elif how == 3:
            del data[at : at + dice.randint(1, 40)]
        elif how == 4:
            data[at:at] = data[at : at + dice.randint(1, 40)]
        else:
            data[at : at + 1] = bytes([data[at] ^ (1 << dice.randrange(8))])
    return bytes(data)


def attempt(path: Path) -> str | None:
    """None if read, "" if refused in one line, else what went wrong."""
    from clvol.errors import VolumeError
    from clvol.readers import load_volume

    start = time.monotonic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            volume = load_volume(path, memory_cap=_CAP)
            if volume.data.shape != volume.grid.shape or volume.data.nbytes > _CAP:
                return f"shape {volume.data.shape}, grid {volume.grid.shape}"
            result = None
    except VolumeError as error:
        message = str(error)
        result = "" if "\n" not in message and str(path) in message else f"says {message!r}"
    except BaseException as error:
        return f"{type(error).__name__}: {error}"
    seconds = time.monotonic() - start
    return result if seconds < _SLOWEST else f"took {seconds:.1f} s"


def main(folder: Path, seed: int, count: int) -> None:
    dice = random.Random(seed)
    kinds = sorted(path for path in folder.iterdir() if not path.name.startswith("tried"))
    told = {"read": 0, "refused": 0, "wrong": []}
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(count):
        kind = dice.choice(kinds)
        tried = folder / f"tried_{k}{''.join(kind.suffixes)}"
        copy = shutil.copytree if kind.is_dir() else shutil.copy
        copy(kind, tried)
        files = sorted(f for f in tried.rglob("*") if f.is_file()) if tried.is_dir() else [tried]
        file = dice.choice(files)
        file.write_bytes(change(file.read_bytes(), dice))
        said = attempt(tried)
        if said:
            told["wrong"].append(f"{tried.name}: {said}")
            continue
        told["read" if said is None else "refused"] += 1
        shutil.rmtree(tried) if tried.is_dir() else tried.unlink()
    told["MiB"] = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory) // 1024
    print(json.dumps(told))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
