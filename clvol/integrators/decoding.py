"""Compressed volumes on their way to an integrator: encoded once for a scene's settings, and decoded as it says."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.device.code_decoder import CodeDecoder
from clvol.encoding.coded_volume import (
    CodedVolume,
    DecodedVolume,
    encoded_volume,
    measured_error,
    stats_of,
    stored_codes,
)
from clvol.encoding.trainer import CodeTrainer
from clvol.errors import SceneError
from clvol.features.compression import coded_source, is_compressed
from clvol.integrators.base import Integrator, Progress, Shared
from clvol.opencl.context import DeviceContext
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


def codes_of(resolved: ResolvedScene, shared: Shared, progress: Progress | None = None) -> CodedVolume | None:
    """The scene's volume as codes, made (or read, from a store of codes) once; None for a scene without compression.

    Codes are kept by what they depend on: the volume, the codec, its target and the seed.
    """
    if not is_compressed(resolved):
        return None
    compression, volume = resolved.compression, resolved.volume
    key: Hashable = volume, compression.codec, compression.target, compression.seed
    if coded_source(volume) is not None:
        return shared.keep("codes", volume, lambda: stored_codes(volume), _KEPT_CODES)
    return shared.keep("codes", key, lambda: _encoded(resolved, shared, progress), _KEPT_CODES)


def decoded_voxels(codes: CodedVolume, shared: Shared) -> DecodedVolume:
    """All voxels of ``codes``, decoded once on the device of ``shared``."""
    return shared.keep("decoded voxels", codes, lambda: _decoded(codes, shared.context), _KEPT_VOXELS)


def with_rendered_voxels(
    resolved: ResolvedScene, shared: Shared, integrator: Integrator, progress: Progress | None = None
) -> ResolvedScene:
    """``resolved`` with decoded voxels in place of a compressed volume: from here on they are the volume, so that empty
    space, statistics, gradients and surfaces are theirs. A store of codes is left to an integrator that reads blocks.

    ``resolved`` itself where there is nothing to decode.
    """
    if not is_compressed(resolved) or (integrator.reads_blocks and coded_source(resolved.volume) is not None):
        is_default = resolved.compression == NOT_COMPRESSED
        return resolved if is_default else replace(resolved, compression=NOT_COMPRESSED)
    codes = codes_of(resolved, shared, progress)
    assert codes is not None
    return replace(resolved, volume=decoded_voxels(codes, shared), compression=NOT_COMPRESSED)


def compression_stats(resolved: ResolvedScene, shared: Shared, integrator: Integrator) -> dict[str, Any] | None:
    """The entry "compression" of a frame's stats; None for a scene without compression."""
    source = coded_source(resolved.volume)
    if source is not None and integrator.reads_blocks:
        return None
    codes = codes_of(resolved, shared)
    return None if codes is None else stats_of(codes, device_bytes(codes), _count(codes))


def _count(codes: CodedVolume) -> int:
    return math.prod(codes.grid.shape)


def _encoded(resolved: ResolvedScene, shared: Shared, progress: Progress | None) -> CodedVolume:
    """The scene's volume as codes, with their error over all voxels, which are then decoded already."""
    volume = resolved.volume
    codes = encoded_volume(volume, resolved.compression, trainer(shared.context), progress)
    decoded = _decoded(codes, shared.context)
    codes = replace(codes, measured=measured_error(volume, decoded.layers(), codes.bits_per_voxel))
    decoded.codes = codes
    shared.keep("decoded voxels", codes, lambda: decoded, _KEPT_VOXELS)
    return codes


def trainer(context: DeviceContext) -> Trainer:
    """Makes encoders whose search runs on the device."""
    return CodeTrainer(context)


def _decoded(codes: CodedVolume, context: DeviceContext) -> DecodedVolume:
    """The voxels, decoded by the device, or by the host where they exceed what one buffer of the device may hold."""
    if _count(codes) * codes.dtype.itemsize > int(context.device.max_mem_alloc_size):
        return codes.decoded(decode_blocks)
    voxels = context.output(codes.dtype, codes.grid.shape)
    corners = codes.blocks.places(np.arange(codes.blocks.count)) * codes.blocks.edge
    decoder = CodeDecoder(context, codes.codebooks, codes.name or "codes")
    decoder.decode_volume(codes.coded, codes.blocks.edge, voxels, corners)
    return DecodedVolume(context.take(voxels), codes)
