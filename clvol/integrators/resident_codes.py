"""Codes that stay on the device, for the integrators that sample bricks of decoded voxels."""

from __future__ import annotations

from clvol.device.brick_pool import CodedBricks
from clvol.encoding.coded_volume import EDGE, UndecodedVolume
from clvol.errors import SceneError
from clvol.features import effects
from clvol.features.compression import coded_source, is_compressed
from clvol.integrators.base import Shared
from clvol.integrators.raycast.bricks import BrickVolume
from clvol.scene.resolve import ResolvedScene
from clvol.volume.voxel_layout import holds_pairs

# Effects that read voxels in other ways than rays do, or others than the volume's own.
_OF_ALL_VOXELS = {"precomputed gradients", "prefilter", "minification"}
_KEPT = 3  # volumes as bricks


def bricks_for(shared: Shared, resolved: ResolvedScene) -> BrickVolume | None:
    """The bricks of the scene's codes, shared by all scenes that allow them as much memory; None where the device has
    all voxels."""
    volume = resolved.volume
    if not isinstance(volume, UndecodedVolume) or needs_all_voxels(resolved) is not None:
        return None
    memory, context, codes = resolved.compression.memory_bytes, shared.context, volume.codes

    def make() -> BrickVolume:
        source = CodedBricks(context, volume, codes.blocks, codes.codebooks, codes.coded, codes.name or "volume")
        return BrickVolume(context, source, memory, pairs=holds_pairs(volume))

    return shared.keep("bricks", (codes, memory), make, _KEPT)


def brick_switches(resolved: ResolvedScene) -> dict[str, int]:
    """The switches of codes that are to stay on the device."""
    if resolved.compression.decode != "resident" or not is_compressed(resolved):
        return {}
    source = coded_source(resolved.volume)
    return {"BRICKS": (EDGE if source is None else source.blocks.edge).bit_length() - 1}


def check_resident(resolved: ResolvedScene) -> None:
    """SceneError for codes that are to stay on the device in a scene that needs all voxels there."""
    if resolved.compression.decode == "resident" and (reason := needs_all_voxels(resolved)) is not None:
        where = f"{resolved.origin}: compression.decode"
        raise SceneError(where, f"got 'resident' in a scene that calls for {reason}", "'upload' or 'auto'")


def needs_all_voxels(resolved: ResolvedScene) -> str | None:
    """An effect of the scene for which all voxels have to be on the device at once; None if there is none."""
    for effect in effects(resolved):
        if effect.called_for and effect.name in _OF_ALL_VOXELS:
            return effect.name
    return "quantised voxels" if resolved.integration.voxel_precision != "stored" else None
