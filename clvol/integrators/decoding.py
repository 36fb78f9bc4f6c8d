"""Compressed volumes on their way to an integrator: encoded once per scene's settings, decoded as the scene says."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import replace
from typing import Any

from clvol.encoding.coded_volume import CodedVolume, Decode, DecodedVolume, encoded_volume, measured_error, stats_of
from clvol.errors import SceneError
from clvol.features.compression import is_compressed
from clvol.integrators.base import Integrator, Progress, Shared
from clvol.scene.compression import NOT_COMPRESSED
from clvol.scene.resolve import ResolvedScene
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.encoding import Trainer
from clvol.volume.voxel_layout import device_bytes

_KEPT_CODES, _KEPT_VOXELS = 12, 3  # volumes


def holds_codes(integrator: Integrator) -> bool:
    """Whether the integrator keeps codes on the device and decodes the blocks that a frame needs."""
    return getattr(integrator, "holds_codes", False)


def check_decoding(resolved: ResolvedScene, integrator: Integrator) -> None:
    """SceneError for codes that are to stay on the device, with an integrator that needs all voxels."""
    if is_compressed(resolved) and resolved.compression.decode == "resident" and not holds_codes(integrator):
        where = f"{resolved.origin}: compression.decode"
        raise SceneError(where, f"got 'resident' with the method {integrator.name!r}", "'upload' or 'auto'")


def way_of_decoding(resolved: ResolvedScene, shared: Shared, integrator: Integrator) -> str:
    """"upload" or "resident", which is taken where the scene leaves it open and the decoded voxels do not fit."""
    way = resolved.compression.decode
    if way != "auto" or not holds_codes(integrator):
        return "upload" if way == "auto" else way
    device, needed = shared.context.device, device_bytes(resolved.volume)
    fits = needed <= min(int(device.max_mem_alloc_size), int(device.global_mem_size))
    if integrator.reads_blocks:
        fits &= needed <= resolved.multiresolution.memory_bytes
    return "upload" if fits else "resident"


def codes_of(resolved: ResolvedScene, shared: Shared, progress: Progress | None = None) -> CodedVolume | None:
    """The scene's volume as codes, made once; None for a scene without compression."""
    if not is_compressed(resolved):
        return None
    compression, volume = resolved.compression, resolved.volume
    key: Hashable = volume
    if compression.codec != "none":
        key = volume, compression.codec, compression.target, compression.seed
    return shared.keep("codes", key, lambda: _made(resolved, shared, progress), _KEPT_CODES)


def with_rendered_voxels(
    resolved: ResolvedScene, shared: Shared, integrator: Integrator, progress: Progress | None = None
) -> ResolvedScene:
    """``resolved`` with decoded voxels, or with codes that the integrator decodes, in place of its volume."""
    codes = codes_of(resolved, shared, progress)
    if codes is None:
        is_default = resolved.compression == NOT_COMPRESSED
        return resolved if is_default else replace(resolved, compression=NOT_COMPRESSED)
    decode = decoder(shared)
    volume: DecodedVolume = shared.keep("decoded voxels", codes, lambda: codes.decoded(decode), _KEPT_VOXELS)
    return replace(resolved, volume=volume, compression=NOT_COMPRESSED)


def compression_stats(resolved: ResolvedScene, shared: Shared) -> dict[str, Any] | None:
    """The entry "compression" of a frame's stats; None for a scene without compression."""
    codes = codes_of(resolved, shared)
    if codes is None:
        return None
    volume = shared.keep("decoded voxels", codes, lambda: codes.decoded(decoder(shared)), _KEPT_VOXELS)
    return stats_of(codes, device_bytes(volume), math.prod(volume.shape))


def _made(resolved: ResolvedScene, shared: Shared, progress: Progress | None) -> CodedVolume:
    volume, decode = resolved.volume, decoder(shared)
    codes = encoded_volume(volume, resolved.compression, trainer(shared), progress)
    error = measured_error(volume, codes.layers(decode), codes.bits_per_voxel)
    return replace(codes, measured=error)


def trainer(shared: Shared) -> Trainer:
    raise NotImplementedError


def decoder(shared: Shared) -> Decode:
    """Decodes blocks on the device of ``shared``."""
    return decode_blocks
