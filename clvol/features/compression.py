"""Compression of a scene's volume: what it applies to, and what it does, in words."""

from __future__ import annotations

from typing import Any

from clvol.errors import SceneError
from clvol.scene.resolve import ResolvedScene
from clvol.volume.volume import Volume


def coded_source(volume: Volume) -> Any | None:
    """The store of codes that ``volume`` is; None for any other volume."""
    source = getattr(volume, "blocks_source", None)
    return source if getattr(source, "codebooks", None) is not None else None


def is_compressed(resolved: ResolvedScene) -> bool:
    """Whether the voxels come from codes: those of a store, or those that the scene has made."""
    return resolved.compression.codec != "none" or coded_source(resolved.volume) is not None


def check_compression(resolved: ResolvedScene) -> None:
    """SceneError for voxels that are labels, and for voxels that are codes already."""
    codec = resolved.compression.codec
    if codec == "none":
        return
    where = f"{resolved.origin}: compression.codec"
    for number, field in enumerate(resolved.fields):
        if field.role == "label" and _are_same(field.volume, resolved.volume):
            what = f"got {codec!r} for voxels that are labels (field.{number}), between which nothing may be interpolated"
            raise SceneError(where, what, "'none'")
    if coded_source(resolved.volume) is not None:
        raise SceneError(where, f"got {codec!r} for a store of codes", "'none': its own codes are decoded")


def _are_same(one: Volume, other: Volume) -> bool:
    return one is other or (one.path is not None and one.path == other.path)
