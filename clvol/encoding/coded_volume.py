"""A volume as codes: encoded from voxels in memory or on disk, or read from a store of codes, and decoded again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.scene.compression import Compression
from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks, MeasuredError
from clvol.store.codecs.encoding import BlockEncoder, Progress, Trainer
from clvol.store.geometry import BlockGrid
from clvol.store.resolutions import split, whole_blocks
from clvol.store.voxel_source import VolumeSource
from clvol.store.zarr_store import StoredBlocks
from clvol.volume.grid import Grid
from clvol.volume.volume import Volume

EDGE = 16  # voxels per axis of a block
_INDEX_BYTES = 8  # of each block: where its bytes are
_PIECE = 1 << 22  # voxels that are compared together
_LARGEST = float(np.finfo(np.float32).max)

Decode = Callable[[CodedBlocks, int, Codebooks], np.ndarray]
"""The voxels [k, s, s, s] of coded blocks of s samples per axis."""


@dataclass(frozen=True, eq=False)
class CodedVolume:
    """The blocks of level 0 of a volume as codes, in the order of ``blocks``.

    ``measured``: the error of the decoded voxels, None where it is not known. ``name``, ``frame``, ``unit``: of the
    volume.
    """

    grid: Grid
    blocks: BlockGrid
    codebooks: Codebooks
    coded: CodedBlocks
    measured: MeasuredError | None = None
    name: str | None = None
    frame: str = "index"
    unit: str | None = None

    @property
    def dtype(self) -> np.dtype:
        """The type of decoded voxels."""
        return self.codebooks.values.dtype

    @property
    def nbytes(self) -> int:
        """Bytes of codes, codebooks, and an index of the blocks."""
        return len(self.coded.data) + self.codebooks.nbytes + _INDEX_BYTES * len(self.coded)

    @property
    def bits_per_voxel(self) -> float:
        """``nbytes`` in bits, divided by the number of voxels."""
        return 8.0 * self.nbytes / math.prod(self.grid.shape)

    def layers(self, decode: Decode) -> Iterator[tuple[int, np.ndarray]]:
        """The decoded voxels [:, ny, nx] of a few layers of blocks after another, each with its first z."""
        edge, (nz, ny, nx) = self.blocks.edge, self.grid.shape
        layers, rows, columns = self.blocks.counts
        each = rows * columns
        at_once = max(1, _PIECE // (each * edge**3))
        for first in range(0, layers, at_once):
            count, z = min(at_once, layers - first), first * edge
            samples = decode(self.part(first * each, (first + count) * each), edge, self.codebooks)
            by_place = samples.reshape(count, rows, columns, edge, edge, edge).transpose(0, 3, 1, 4, 2, 5)
            yield z, by_place.reshape(count * edge, rows * edge, columns * edge)[: nz - z, :ny, :nx]

    def decoded(self, decode: Decode) -> DecodedVolume:
        """The volume of the decoded voxels."""
        voxels = np.empty(self.grid.shape, self.dtype)
        for z, layer in self.layers(decode):
            voxels[z : z + len(layer)] = layer
        return DecodedVolume(voxels, self)

    def part(self, first: int, last: int) -> CodedBlocks:
        """The blocks ``first`` to ``last`` - 1."""
        return CodedBlocks(self.coded.data, self.coded.start[first:last], self.coded.size[first:last])


class DecodedVolume(Volume):
    """A volume of decoded voxels; ``codes`` is the coded volume that they come from."""

    def __init__(self, voxels: np.ndarray, codes: CodedVolume) -> None:
        grid = codes.grid
        super().__init__(
            voxels, grid.spacing, grid.origin, grid.direction, codes.name, frame=codes.frame, unit=codes.unit
        )
        self.codes = codes

    def layers(self) -> Iterator[tuple[int, np.ndarray]]:
        """The voxels as ``CodedVolume.layers`` gives them."""
        thick = max(1, _PIECE // math.prod(self.shape[1:]))
        for z in range(0, self.shape[0], thick):
            yield z, self.data[z : z + thick]


def encoded_volume(
    volume: Volume, compression: Compression, trainer: Trainer, progress: Progress | None = None
) -> CodedVolume:
    """``volume`` (stored numbers) as codes that keep to ``compression``. Their error is not measured yet.

    ``progress(done, total)`` reports training, and then the voxels that are encoded. VolumeError for float64 voxels
    beyond the range of float32.
    """
    low, high = value_range = volume.stored_range
    if not -_LARGEST <= low <= high <= _LARGEST:
        what = f"voxels from {low:g} to {high:g}, which codes (float32) cannot express"
        raise VolumeError(volume.name or "volume", what, f"at most {_LARGEST:g}, or compression.codec = 'none'")
    source = VolumeSource(volume)
    training = trainer.train(source, value_range, compression.codec, compression.target, compression.seed, progress)
    blocks = BlockGrid(volume.shape, EDGE)
    coded = _joined(_encoded_layers(source, blocks, trainer.encoder(training), progress))
    return CodedVolume(
        volume.grid, blocks, training.codebooks, coded, name=volume.name, frame=volume.frame, unit=volume.unit
    )


def stored_codes(volume: Volume) -> CodedVolume:
    """The codes of the store that ``volume`` is, and the error that the store states."""
    source = getattr(volume, "blocks_source", None)
    assert isinstance(source, StoredBlocks) and source.codebooks is not None and source.codes is not None
    coded = source.read_codes(0, np.arange(source.blocks.count))
    about = source.codes.measured, volume.name, volume.frame, volume.unit
    return CodedVolume(volume.grid, source.blocks, source.codebooks, coded, *about)


def _encoded_layers(
    source: VolumeSource, blocks: BlockGrid, encoder: BlockEncoder, progress: Progress | None
) -> Iterator[CodedBlocks]:
    """The blocks of a few layers after another."""
    nz, ny, nx = blocks.shape
    thick = blocks.edge * max(1, _PIECE // (blocks.edge * blocks.counts[1] * blocks.counts[2] * blocks.edge**2))
    for z in range(0, nz, thick):
        end = min(z + thick, nz)
        slab = source.box(z, end, 0, ny, 0, nx)
        yield encoder.encode(split(whole_blocks(as_coded_type(slab), blocks.edge), blocks.edge))
        if progress is not None:
            progress(end * ny * nx, nz * ny * nx)


def as_coded_type(voxels: np.ndarray) -> np.ndarray:
    """``voxels`` in the type that is encoded: float32 for float64."""
    return voxels.astype(np.float32) if voxels.dtype == np.float64 else voxels


def _joined(parts: Iterator[CodedBlocks]) -> CodedBlocks:
    data, start, size, at = [], [], [], 0
    for part in parts:
        data.append(part.data)
        start.append(part.start + at)
        size.append(part.size)
        at += len(part.data)
    return CodedBlocks(np.concatenate(data), np.concatenate(start), np.concatenate(size))


def measured_error(original: Volume, layers: Iterable[tuple[int, np.ndarray]], bits_per_voxel: float) -> MeasuredError:
    """The error of decoded ``layers`` of a volume, over all finite voxels of the ``original``."""
    low, high = original.stored_range
    span = high / 2 - low / 2  # differences are halved, too, since they may overflow
    source, (_, ny, nx) = VolumeSource(original), original.shape
    largest, total, count = 0.0, 0.0, 0
    for z, layer in layers:
        voxels = source.box(z, z + len(layer), 0, ny, 0, nx).astype(np.float64)
        is_finite = np.isfinite(voxels)
        difference = np.abs(voxels[is_finite] / 2 - layer[is_finite].astype(np.float64) / 2)
        if difference.size:
            largest = max(largest, float(difference.max()))
            total += float(np.square(difference / (span or 1.0)).sum())
            count += difference.size
    psnr = -10 * math.log10(total / count) if total else math.inf
    share = largest / span if span else math.inf if largest else 0.0
    return MeasuredError(psnr, share, bits_per_voxel)


def stats_of(codes: CodedVolume, device_bytes: int, decoded_voxels: int) -> dict[str, Any]:
    """The entry "compression" of a frame's stats. ``psnr`` is None where the codes are exact, and so are both errors
    where they are not known."""
    known = codes.measured
    psnr = None if known is None or math.isinf(known.psnr) else known.psnr
    return {
        "codec": codes.codebooks.codec,
        "bits_per_voxel": codes.bits_per_voxel,
        "psnr": psnr,
        "max_voxel_error": None if known is None else known.max_voxel_error,
        "device_bytes": device_bytes,
        "decoded_voxels": decoded_voxels,
    }
