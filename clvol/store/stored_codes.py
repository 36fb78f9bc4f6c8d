"""What a store says of its codes: codebooks as an array with a checksum, parameters and measured errors as JSON.

"codes" in the root's metadata has: version, codec, codebooks (what ``Codebooks`` holds besides entries, with a
checksum), checksum (of the file of entries, which binds it to this store; null if there are none), seed, target,
policy, original (dtype and value_range of the voxels that were coded) and measured.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.store.arrays import open_array, what_failed
from clvol.store.codecs import find_codec
from clvol.store.codecs.coded_blocks import ENTRIES, Codebooks, CodedBlocks, MeasuredError, RateTarget
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.layout import check_codes
from clvol.store.codecs.working_values import WorkingValues
from clvol.store.format import JOURNAL, StoreLayout, codebooks_metadata
from clvol.store.places import file_checksum

VERSION = 2  # of the layout in codecs/coded_blocks.py; 1 had the stages of escaped sub-blocks after all others
CODEBOOKS = "codebooks"


@dataclass(frozen=True, eq=False)
class BlockCodes:
    """How the blocks of one store are decoded."""

    codebooks: Codebooks

    def decode(self, coded: CodedBlocks, s: int) -> np.ndarray:
        """Samples [k, s, s, s] of blocks that are possible."""
        return decode_blocks(coded, s, self.codebooks)

    def impossible(self, coded: CodedBlocks, s: int) -> np.ndarray:
        """Numbers of the blocks whose bytes are impossible, int64, ascending."""
        return check_codes(coded, s, self.codebooks)


@dataclass(frozen=True, eq=False)
class CodesFacts:
    """"codes" of a store's root metadata. ``codebooks`` (JSON): what they hold besides entries."""

    codec: str
    codebooks: dict
    checksum: int | None
    seed: int
    target: RateTarget
    policy: dict
    original_dtype: np.dtype
    original_range: tuple[float, float]
    measured: MeasuredError
    sizes: dict[str, int] = field(default_factory=dict)

    @property
    def missed_target(self) -> tuple[str, str] | None:
        """How a target was missed that is estimated from a part of the volume, and what helps; None if none was."""
        return missed(self.target, self.measured.psnr, self.measured.bits_per_voxel)

    @property
    def bits_per_voxel_all(self) -> float:
        """Of all files but the root's metadata."""
        return self.measured.facts["bits_per_voxel_all"]


def missed(target: RateTarget, psnr: float, bits_per_voxel: float) -> tuple[str, str] | None:
    """How a ``target`` of PSNR or rate was missed, and what to ask for instead; None if it was not."""
    if target.psnr is not None and psnr < target.psnr:
        more = math.ceil((2 * target.psnr - psnr) * 100 + 1) / 100
        return f"PSNR {psnr:.2f} dB, less than {target.psnr:g}", f"a PSNR of {more:g} dB as the target reaches it"
    if target.bits_per_voxel is not None and bits_per_voxel > target.bits_per_voxel:
        what = f"{bits_per_voxel:.3g} bits per voxel, more than {target.bits_per_voxel:g}"
        less = target.bits_per_voxel**2 / bits_per_voxel
        return what, f"{less:.2g} as the target reaches it, if codebooks and metadata alone do not take more"
    return None


def codes_json(facts: CodesFacts) -> dict[str, Any]:
    measured = facts.measured
    return {
        "version": VERSION, "codec": facts.codec, "codebooks": facts.codebooks, "checksum": facts.checksum,
        "seed": facts.seed, "target": facts.target.to_json(), "policy": facts.policy,
        "original": {"dtype": facts.original_dtype.name, "value_range": list(facts.original_range)},
        "measured": {
            "psnr": measured.psnr if math.isfinite(measured.psnr) else None,
            "max_voxel_error": measured.max_voxel_error,
            "bits_per_voxel": measured.bits_per_voxel,
            **measured.facts,
        },
    }  # fmt: skip


def parse_codes(own: Any, layout: StoreLayout, where: str) -> CodesFacts:
    """What ``own``, "codes" of the root, says. KeyError, TypeError or ValueError if it is damaged; VolumeError if it is
    of another version.
    """
    if own["version"] != VERSION:
        raise VolumeError(where, f"codes of version {own['version']!r}", f"version {VERSION}: store the volume again")
    codec = find_codec(str(own["codec"]), where)
    if not codec.coded or any(level.coded and level is not codec for level in layout.codecs):
        raise ValueError(f"codec {codec.name}")
    low, high = (float(value) for value in own["original"]["value_range"])
    measured = dict(own["measured"])
    psnr = measured.pop("psnr")
    error = MeasuredError(
        math.inf if psnr is None else float(psnr),
        float(measured.pop("max_voxel_error")), float(measured.pop("bits_per_voxel")), measured,
    )  # fmt: skip
    float(measured["bits_per_voxel_all"])
    checksum = None if own["checksum"] is None else int(own["checksum"])
    books = dict(own["codebooks"])
    target = RateTarget(**{key: float(value) for key, value in own["target"].items()})
    return CodesFacts(
        codec.name, books, checksum, int(own["seed"]), target, dict(own["policy"]),
        np.dtype(own["original"]["dtype"]), (low, high), error,
    )  # fmt: skip


# ---- codebooks -----------------------------------------------------------------------------------


def codebooks_json(books: Codebooks) -> dict[str, Any]:
    """What ``books`` hold besides their entries, with a checksum."""
    own = {
        "codec": books.codec, "side": books.side, "shifts": books.shifts.tolist(),
        "residual_step": int(books.residual_step), "values": books.values.to_json(),
    }  # fmt: skip
    return own | {"crc32": _checksum(own)}


def _checksum(own: dict) -> int:
    return zlib.crc32(json.dumps({**own, "crc32": None}, sort_keys=True).encode())


def codebooks_of(own: dict, entries: np.ndarray | None) -> Codebooks:
    """The codebooks of ``codebooks_json`` and their ``entries`` (None if there is no stage). KeyError, TypeError or
    ValueError if they are impossible."""
    if own["crc32"] != _checksum(own):
        raise ValueError("their parameters are damaged")
    side, shifts = int(own["side"]), np.array(own["shifts"], np.int32).reshape(-1)
    if entries is None:
        entries = np.zeros((0, ENTRIES, side**3), np.int8)
    values = WorkingValues.from_json(own["values"])
    books = Codebooks(str(own["codec"]), side, entries, shifts, values, int(own["residual_step"]))
    if (fault := books.fault()) is not None:
        raise ValueError(fault)
    return books


def write_codebooks(folder: Path, books: Codebooks) -> int | None:
    """Writes the array of ``books`` in the place of any other; returns the checksum of its file, None if they have no
    stages."""
    if (folder / CODEBOOKS).exists():
        shutil.rmtree(folder / CODEBOOKS)
    if not books.stages:
        return None
    array = open_array(folder / CODEBOOKS, codebooks_metadata(books.entries.shape))
    array.write(books.entries).result()
    return file_checksum(_file(folder))


def read_codebooks(folder: Path, facts: CodesFacts, dtype: np.dtype, where: str, wanted: str) -> Codebooks:
    """The codebooks of the store ``folder``, whose samples are of ``dtype``. VolumeError, with ``where`` and
    ``wanted``, if they are damaged or belong to another store."""
    own = facts.codebooks
    try:
        entries = None
        if len(own["shifts"]):
            array = open_array(folder / CODEBOOKS)
            shape = [len(own["shifts"]), ENTRIES, int(own["side"]) ** 3]
            if list(array.shape) != shape or array.dtype.name != "int8":
                raise VolumeError(where, f"codebooks of shape {list(array.shape)}", wanted)
            entries = array.read().result()
            if file_checksum(_file(folder)) != facts.checksum:
                raise VolumeError(where, "the codebooks belong to another store", wanted)
    except ValueError as error:
        raise VolumeError(where, f"the codebooks: {what_failed(error)}", wanted) from None
    except (KeyError, TypeError, OverflowError):
        raise VolumeError(where, "damaged zarr.json (codebooks)", wanted) from None
    try:
        books = codebooks_of(own, entries)
        if books.codec != facts.codec or books.values.dtype != dtype:
            raise ValueError(f"of codec {books.codec} for {books.values.dtype}")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise VolumeError(where, f"damaged zarr.json (codebooks: {str(error)[:100]})", wanted) from None
    return books


def sizes_on_disk(folder: Path) -> dict[str, int]:
    """Bytes of the store's files, by what they are of: "codes" (level 0), "codebooks", "levels" (all coarser ones),
    "blocks" (statistics and checksums). The metadata of arrays are included, that of the root and the journal are not.
    """
    sizes = {"codes": 0, "codebooks": 0, "levels": 0, "blocks": 0}
    for place, _, names in os.walk(folder):
        top = Path(place).relative_to(folder).parts[:1]
        if top and top[0] != JOURNAL:
            part = {"0": "codes", CODEBOOKS: CODEBOOKS, "blocks": "blocks"}.get(top[0], "levels")
            sizes[part] += sum(os.stat(os.path.join(place, name)).st_size for name in names)
    return sizes


def _file(folder: Path) -> Path:
    return folder / CODEBOOKS / "c/0/0/0"
