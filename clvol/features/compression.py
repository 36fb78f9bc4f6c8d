"""Compression of a scene's volume: what it applies to, and what it does, in words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from clvol.errors import ClvolWarning, SceneError
from clvol.scene.compression import Compression
from clvol.scene.resolve import ResolvedScene
from clvol.store.stored_codes import CodesFacts, missed
from clvol.store.zarr_store import StoredBlocks
from clvol.volume.volume import Volume

_LARGE = 0.1  # of the range: a voxel that is wrong by so much may well be seen as something else


def coded_source(volume: Volume) -> StoredBlocks | None:
    """The store of codes that ``volume`` is; None for any other volume."""
    source = getattr(volume, "blocks_source", None)
    return source if isinstance(source, StoredBlocks) and source.codes is not None else None


def facts_of(source: StoredBlocks) -> CodesFacts:
    """What a store of codes says of them."""
    assert source.codes is not None
    return source.codes


def is_compressed(resolved: ResolvedScene) -> bool:
    """Whether the voxels come from codes: those of a store, or those that the scene has made."""
    return resolved.compression.codec != "none" or coded_source(resolved.volume) is not None


def check_compression(resolved: ResolvedScene) -> None:
    """SceneError for a lossy codec of voxels that are known to be labels, or codes already."""
    codec, where = resolved.compression.codec, f"{resolved.origin}: compression.codec"
    if codec == "none":
        return
    if resolved.volume.labels and resolved.compression.is_lossy:
        raise SceneError(where, f"got {codec!r} for a volume of labels, which have to be exact", "'none' or 'labels'")
    if codec == "labels" and resolved.volume.dtype == np.float64:
        raise SceneError(where, "got 'labels' for float64 voxels", "voxels of one, two or four bytes, or 'none'")
    if coded_source(resolved.volume) is not None:
        raise SceneError(where, f"got {codec!r} for a store of codes", "'none', since its own codes are decoded")


def compression_warnings(settings: Compression, stats: Mapping[str, Any]) -> list[ClvolWarning]:
    """Warnings about decoded voxels with a large error, and about a target that was missed, of the volume and of
    fields. ``stats``: the entry "compression" of a frame's stats."""
    found = _warnings_of(settings, stats, "compression")
    for own in stats.get("fields", ()):
        found += _warnings_of(settings, own, f"field.{own['field']}: compression")
    return found


def _warnings_of(settings: Compression, stats: Mapping[str, Any], where: str) -> list[ClvolWarning]:
    found, error, psnr = [], stats["max_voxel_error"], stats["psnr"]
    if error >= _LARGE and settings.weighting == "even":  # else errors are large where nothing shows them
        what = f"the picture shows voxels that differ from the original ones by up to {100 * error:.2g} % of the range"
        codec = f"codec {stats['codec']!r}" + ("" if psnr is None else f", {psnr:.1f} dB")
        advice = "set compression.max_voxel_error, with the codec 'rvq', or compression.codec = 'none'"
        found.append(ClvolWarning(where, f"{what} ({codec})", advice))
    reached = math.inf if psnr is None else psnr
    if (off := missed(settings.target, reached, stats["bits_per_voxel"])) is not None:
        key = "psnr" if settings.psnr is not None else "bits_per_voxel"
        found.append(ClvolWarning(f"{where}.{key}", *off))
    return found


def explained(resolved: ResolvedScene) -> dict[str, Any] | None:
    """What compression does to the scene, and what it costs: "codec", "target", "decode", "does" and "costs", the last
    two in words. None for a scene without compression."""
    if not is_compressed(resolved):
        return None
    settings, source = resolved.compression, coded_source(resolved.volume)
    decode = "upload" if settings.decode == "auto" else settings.decode
    target = settings.target.to_json()
    if source is not None:
        codec, what = facts_of(source).codec, "the store holds codes, which are read instead of voxels"
        cost = "no voxel is encoded"
    else:
        codec = settings.codec
        of = "voxels, and those of density fields, are" if _has_coded_fields(resolved) else "voxels are"
        what = f"{of} replaced by those that codes stand for, {_kept_to(codec, target)}"
        cost = "encoding takes time once for a volume and these settings, however many pictures follow"
    if decode == "upload":
        what += "; all are decoded when they come to the device"
        cost += "; a frame takes the time and the device's memory of decoded voxels"
    else:
        what += "; codes stay on the device, and the blocks that a frame needs are decoded for it"
        cost += "; the device holds codes and a pool of decoded blocks"
    return {"codec": codec, "target": target, "decode": decode, "does": what, "costs": cost}


def _has_coded_fields(resolved: ResolvedScene) -> bool:
    return resolved.compression.is_lossy and any(field.role == "density" for field in resolved.fields)


def _kept_to(codec: str, target: Mapping[str, float]) -> str:
    if codec == "labels":
        return "which are the same"
    words = {
        "max_voxel_error": "each within {:g} of the range of values",
        "psnr": "with a signal-to-noise ratio of at least {:g} dB",
        "bits_per_voxel": "in at most {:g} bits per voxel",
    }
    return next((words[key].format(value) for key, value in target.items()), "as exact as the codec is by itself")
