"""Compressed volumes on their way to an integrator: encoded once for a scene's settings, and decoded as it says."""

from __future__ import annotations

import logging
import math
from collections.abc import Hashable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from clvol.device.code_decoder import CodeDecoder
from clvol.encoding.coded_volume import (
    CodedVolume,
    Decode,
    DecodedVolume,
    LabelTrainer,
    UndecodedVolume,
    decode_on_host,
    encoded_volume,
    in_words,
    measured_codes,
    stats_of,
    stored_codes,
)
from clvol.errors import RenderError, SceneError, UsageError
from clvol.features.compression import coded_source, facts_of, is_compressed
from clvol.integrators.base import Integrator, Progress, Shared
from clvol.integrators.code_weights import block_weights, check_weighting
from clvol.lazily import lazily
from clvol.opencl.context import DeviceContext
from clvol.scene.compression import NOT_COMPRESSED, Compression
from clvol.scene.field import ResolvedField
from clvol.scene.resolve import ResolvedScene
from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks
from clvol.store.codecs.encoding import Trainer
from clvol.store.geometry import BlockGrid
from clvol.volume.volume import Volume
from clvol.volume.voxel_layout import device_bytes

if TYPE_CHECKING:
    from clvol.encoding import trainer as training
else:
    training = lazily("clvol.encoding.trainer")

_KEPT_CODES, _KEPT_VOXELS = 12, 3  # of a volume, and decoded volumes of a device

_ROUNDING = 1 + 1e-9  # of the range and the bound in double precision

_log = logging.getLogger(__name__)
_known: WeakKeyDictionary[Volume, dict[Hashable, CodedVolume]] = WeakKeyDictionary()


def check_decoding(resolved: ResolvedScene, integrator: Integrator) -> None:
    """SceneError for codes that are to stay on the device, with an integrator that needs all voxels, and for weights in
    a scene that they do not suit."""
    check_weighting(resolved)
    holds = integrator.holds_codes or (integrator.reads_blocks and coded_source(resolved.volume) is not None)
    if is_compressed(resolved) and resolved.compression.decode == "resident" and not holds:
        where = f"{resolved.origin}: compression.decode"
        raise SceneError(where, f"got 'resident' with the method {integrator.name!r}", "'upload' or 'auto'")


def codes_of(
    resolved: ResolvedScene, shared: Shared, progress: Progress | None = None, *, decode: bool = True
) -> CodedVolume | None:
    """The scene's volume as codes, made (or read, from a store of codes) once; None for a scene without compression.

    Codes live as long as their volume, for all devices and Renderers, and are kept by what else they depend on: the
    codec, its target and the seed, and where they are weighted by it, the transfer function. ``decode``: the decoded
    voxels, which are needed once to measure their error, are kept for the device.
    """
    if not is_compressed(resolved):
        return None
    compression, volume = resolved.compression, resolved.volume
    key: tuple[Hashable, ...] = compression.codec, compression.target, compression.seed
    if compression.weighting != "even":
        key += resolved.transfer_function, resolved.background.tobytes()
    kept = _known.setdefault(volume, {})
    if key not in kept:
        is_stored = coded_source(volume) is not None
        codes = stored_codes(volume) if is_stored else _encoded(resolved, shared, progress, decode)
        while len(kept) >= _KEPT_CODES:
            kept.pop(next(iter(kept)), None)
        kept[key] = codes
    return kept[key]


def decoded_voxels(codes: CodedVolume, shared: Shared) -> DecodedVolume:
    """All voxels of ``codes``, decoded once on the device of ``shared``."""
    return shared.keep("decoded voxels", codes, lambda: _decoded(codes, shared.context), _KEPT_VOXELS)


def way_of_decoding(resolved: ResolvedScene, context: DeviceContext, integrator: Integrator) -> str:
    """"upload" or "resident": what the scene says, or, where it leaves that open, "resident" if the integrator holds
    codes and the decoded voxels fit neither into ``compression.memory`` nor, if that is left out, on the device."""
    way, allowed = resolved.compression.decode, resolved.compression.memory_bytes
    if way != "auto":
        return way
    if allowed is None:
        allowed = min(int(context.device.max_mem_alloc_size), int(context.device.global_mem_size))
    return "resident" if integrator.holds_codes and device_bytes(resolved.volume) > allowed else "upload"


def with_rendered_voxels(
    resolved: ResolvedScene, shared: Shared, integrator: Integrator, progress: Progress | None = None
) -> ResolvedScene:
    """``resolved`` with decoded voxels in place of a compressed volume: from here on they are the volume, so that empty
    space, statistics, gradients and surfaces are theirs. An integrator that decodes blocks itself gets an
    ``UndecodedVolume``; one that reads blocks reads those of a store of codes.

    ``resolved`` itself where there is nothing to decode.
    """
    if not is_compressed(resolved) or (integrator.reads_blocks and coded_source(resolved.volume) is not None):
        kept = NOT_COMPRESSED
        if is_compressed(resolved) and resolved.compression.decode == "resident":
            kept = Compression(decode="resident")
        return resolved if resolved.compression == kept else replace(resolved, compression=kept)
    is_resident = way_of_decoding(resolved, shared.context, integrator) == "resident"
    codes = codes_of(resolved, shared, progress, decode=not is_resident)
    assert codes is not None
    resolved = replace(resolved, fields=_decoded_fields(resolved, shared, progress))
    if is_resident:
        volume = shared.keep("undecoded voxels", codes, lambda: UndecodedVolume(codes), _KEPT_CODES)
        memory = Compression(decode="resident", memory=resolved.compression.memory)
        return replace(resolved, volume=volume, compression=memory)
    return replace(resolved, volume=decoded_voxels(codes, shared), compression=NOT_COMPRESSED)


def coded_fields(resolved: ResolvedScene) -> dict[int, ResolvedScene]:
    """For each field that is encoded, too, by its number: a scene whose volume it is. These are densities; labels and
    masks are exact."""
    if not resolved.compression.is_lossy:
        return {}
    compression = resolved.compression.model_copy(update={"weighting": "even", "decode": "upload"})
    return {
        k: replace(resolved, volume=field.volume, compression=compression, fields=())
        for k, field in enumerate(resolved.fields)
        if field.role == "density" and not field.volume.labels and coded_source(field.volume) is None
    }


def _decoded_fields(
    resolved: ResolvedScene, shared: Shared, progress: Progress | None
) -> tuple[ResolvedField, ...]:
    fields = list(resolved.fields)
    for k, own in coded_fields(resolved).items():
        codes = codes_of(own, shared, progress)
        assert codes is not None
        fields[k] = replace(fields[k], volume=decoded_voxels(codes, shared))
    return tuple(fields)


def compression_stats(
    resolved: ResolvedScene, shared: Shared, integrator: Integrator, blocks: Mapping[str, Any] | None = None
) -> dict[str, Any] | None:
    """The entry "compression" of a frame's stats; None for a scene without compression.

    ``blocks``: the entry of that name. An integrator that decodes blocks itself says in its own notes how many voxels
    it decoded for the frame, and the bytes of these. Fields that are encoded are listed in "fields".
    """
    stats = _stats_of_volume(resolved, shared, integrator, blocks)
    if stats is not None and (fields := coded_fields(resolved)):
        stats = stats | {"fields": [{"field": k, **_stats_of_field(own, shared)} for k, own in fields.items()]}
    return stats


def _stats_of_field(own: ResolvedScene, shared: Shared) -> dict[str, Any]:
    codes = codes_of(own, shared)
    assert codes is not None
    voxels = math.prod(codes.grid.shape)
    return stats_of(codes.codebooks.codec, codes.measured, 4 * voxels, voxels)  # float32, whatever their type


def _stats_of_volume(
    resolved: ResolvedScene, shared: Shared, integrator: Integrator, blocks: Mapping[str, Any] | None
) -> dict[str, Any] | None:
    source = coded_source(resolved.volume)
    if source is not None and integrator.reads_blocks:
        blocks = blocks or {"bytes_on_device": 0, "bytes_of_samples": 0}
        decoded = blocks["bytes_of_samples"] // source.dtype.itemsize
        facts = facts_of(source)
        return stats_of(facts.codec, facts.measured, blocks["bytes_on_device"], decoded)
    codes = codes_of(resolved, shared)
    if codes is None:
        return None
    if way_of_decoding(resolved, shared.context, integrator) == "resident":
        stats = stats_of(codes.codebooks.codec, codes.measured, codes.nbytes, 0)
    else:
        stats = stats_of(codes.codebooks.codec, codes.measured, device_bytes(codes), math.prod(codes.grid.shape))
    weighting = resolved.compression.weighting
    return stats if weighting == "even" else stats | {"weighting": weighting}


def _encoded(resolved: ResolvedScene, shared: Shared, progress: Progress | None, decode: bool) -> CodedVolume:
    """The scene's volume as codes, with their error over all voxels. ``decode``: all are decoded at once, and kept."""
    volume, context = resolved.volume, shared.context
    is_exact = resolved.compression.codec == "labels"
    teacher = LabelTrainer() if is_exact else trainer(context)
    try:
        codes = encoded_volume(volume, resolved.compression, teacher, progress, block_weights(resolved))
    except UsageError as error:  # of a target, by its name
        raise SceneError(f"{resolved.origin}: compression.{error.where}", error.what, error.expected) from None
    decoded = _decoded(codes, context) if decode else None
    layers = codes.layers(decode_on(context)) if decoded is None else decoded.layers()
    codes = measured_codes(codes, volume, layers)
    _check_bound(codes, resolved)
    _log.info("%s", in_words(codes))
    if decoded is not None:
        decoded.codes = codes
        shared.keep("decoded voxels", codes, lambda: decoded, _KEPT_VOXELS)
    return codes


def _check_bound(codes: CodedVolume, resolved: ResolvedScene) -> None:
    """RenderError for a voxel that is further off than the scene allows."""
    bound, measured = resolved.compression.max_voxel_error, codes.measured
    assert measured is not None
    if bound is not None and resolved.compression.weighting == "even" and measured.max_voxel_error > bound * _ROUNDING:
        what = f"a voxel is off by {measured.max_voxel_error:.6g} of the range"
        raise RenderError(f"{resolved.origin}: compression.max_voxel_error", what, f"at most {bound:g}")


def trainer(context: DeviceContext) -> Trainer:
    """Makes encoders whose search runs on the device."""
    return training.CodeTrainer(context)


def _decoded(codes: CodedVolume, context: DeviceContext) -> DecodedVolume:
    return DecodedVolume(decode_on(context)(codes.coded, codes.blocks, codes.codebooks), codes)


def decode_on(context: DeviceContext) -> Decode:
    """Decodes blocks on the device, or on the host where they exceed what one buffer of the device may hold."""

    def decode(coded: CodedBlocks, blocks: BlockGrid, codebooks: Codebooks) -> np.ndarray:
        dtype = codebooks.values.dtype
        if math.prod(blocks.shape) * dtype.itemsize > int(context.device.max_mem_alloc_size):
            return decode_on_host(coded, blocks, codebooks)
        voxels = context.output(dtype, blocks.shape)
        corners = blocks.places(np.arange(blocks.count)) * blocks.edge
        CodeDecoder(context, codebooks).decode_volume(coded, blocks.edge, voxels, corners)
        return context.take(voxels)

    return decode
