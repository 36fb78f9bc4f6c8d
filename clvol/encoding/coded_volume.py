"""A volume as codes: encoded from voxels in memory or on disk, or read from a store of codes, and decoded again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from clvol.errors import VolumeError
from clvol.scene.compression import Compression
from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks, MeasuredError, RateTarget
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.encoding import BlockEncoder, Progress, Trainer, Training
from clvol.store.codecs.labels import encode_labels, label_codebooks
from clvol.store.geometry import BlockGrid
from clvol.store.resolutions import split, whole_blocks
from clvol.store.voxel_source import VolumeSource, VoxelSource
from clvol.store.zarr_store import StoredBlocks
from clvol.volume.grid import Grid
from clvol.volume.lazy import LazyVolume
from clvol.volume.volume import Volume

EDGE = 16  # voxels per axis of a block
_INDEX_BYTES = 4  # of a block: where its bytes begin
_PIECE = 1 << 22  # voxels that are encoded or decoded together
_CACHED = 1 << 16  # voxels that are compared together, so that temporaries stay in the cache
_LARGEST = float(np.finfo(np.float32).max)

Decode = Callable[[CodedBlocks, BlockGrid, Codebooks], np.ndarray]
"""The voxels [nz, ny, nx] of all blocks of a grid, in order."""


def decode_on_host(coded: CodedBlocks, blocks: BlockGrid, codebooks: Codebooks) -> np.ndarray:
    """A ``Decode`` by numpy."""
    edge, (layers, rows, columns) = blocks.edge, blocks.counts
    samples = decode_blocks(coded, edge, codebooks).reshape(layers, rows, columns, edge, edge, edge)
    whole = samples.transpose(0, 3, 1, 4, 2, 5).reshape(layers * edge, rows * edge, columns * edge)
    return np.ascontiguousarray(whole[tuple(slice(n) for n in blocks.shape)])


@dataclass(frozen=True, eq=False)
class CodedVolume:
    """The blocks of level 0 of a volume as codes, in the order of ``blocks``.

    ``measured``: the error of the decoded voxels, and ``value_range`` that of the finite ones, once they are known
    (``measured_codes``). ``nan_count`` and ``inf_count``: such voxels, which are those of the original volume.
    """

    grid: Grid
    blocks: BlockGrid
    codebooks: Codebooks
    coded: CodedBlocks
    measured: MeasuredError | None = None
    name: str = "volume"
    frame: str = "index"
    unit: str | None = None
    value_range: tuple[float, float] = (0.0, 0.0)
    nan_count: int = 0
    inf_count: int = 0

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

    def read_codes(self, level: int, blocks: np.ndarray) -> CodedBlocks:
        """The bytes of ``blocks`` (numbers, int64 [k]) at level 0, the only one there is."""
        if level:
            raise ValueError(f"no codes of level {level}")
        return CodedBlocks(self.coded.data, self.coded.start[blocks], self.coded.size[blocks])

    def layers(self, decode: Decode) -> Iterator[tuple[int, np.ndarray]]:
        """The decoded voxels [:, ny, nx] of a few layers of blocks after another, each with its first z."""
        edge, counts = self.blocks.edge, self.blocks.counts
        each = counts[1] * counts[2]
        at_once = max(1, _PIECE // (each * edge**3))
        for first in range(0, counts[0], at_once):
            count = min(at_once, counts[0] - first)
            shape = min(count * edge, self.grid.shape[0] - first * edge), *self.grid.shape[1:]
            part = self.read_codes(0, np.arange(first * each, (first + count) * each))
            yield first * edge, decode(part, BlockGrid(shape, edge), self.codebooks)


class DecodedVolume(Volume):
    """A volume of decoded voxels; ``codes`` is the coded volume that they come from."""

    def __init__(self, voxels: np.ndarray, codes: CodedVolume) -> None:
        grid = codes.grid
        super().__init__(
            voxels, grid.spacing, grid.origin, grid.direction, codes.name, frame=codes.frame, unit=codes.unit
        )
        self.codes = codes

    def layers(self) -> Iterator[tuple[int, np.ndarray]]:
        """The voxels, as ``CodedVolume.layers`` gives them."""
        thick = max(1, _PIECE // math.prod(self.shape[1:]))
        for z in range(0, self.shape[0], thick):
            yield z, self.data[z : z + thick]


class UndecodedVolume(LazyVolume):
    """A volume that only its ``codes`` hold, for integrators that decode blocks themselves (``holds_codes``). Its
    ``data`` are decoded by the host if anything asks for them."""

    def __init__(self, codes: CodedVolume) -> None:
        super().__init__(codes.dtype, codes.grid, codes.name, codes.frame, codes.name, None, codes.unit)
        self.codes = codes

    @property
    def stored_range(self) -> tuple[float, float]:
        return self.codes.value_range

    @property
    def nan_count(self) -> int:
        return self.codes.nan_count

    @property
    def inf_count(self) -> int:
        return self.codes.inf_count

    def _load(self) -> np.ndarray:
        return decode_on_host(self.codes.coded, self.codes.blocks, self.codes.codebooks)


def encoded_volume(
    volume: Volume,
    compression: Compression,
    trainer: Trainer,
    progress: Progress | None = None,
    weights: np.ndarray | None = None,
) -> CodedVolume:
    """``volume`` (stored numbers) as codes that keep to ``compression``. Their error is not measured yet.

    ``progress(done, total)`` reports training, and then the voxels that are encoded. ``weights`` [blocks]: of their
    squared errors; 1 if left out. VolumeError for float64 voxels
    beyond the range of float32.
    """
    low, high = value_range = volume.stored_range
    if not -_LARGEST <= low <= high <= _LARGEST:
        what = f"voxels from {low:g} to {high:g}, which codes (float32) cannot express"
        raise VolumeError(volume.name or "volume", what, f"at most {_LARGEST:g}, or compression.codec = 'none'")
    source = VolumeSource(volume)
    training = trainer.train(source, value_range, compression.codec, compression.target, compression.seed, progress)
    blocks = BlockGrid(volume.shape, EDGE)
    coded = _joined(_encoded_layers(source, blocks, trainer.encoder(training), progress, weights))
    return CodedVolume(volume.grid, blocks, training.codebooks, coded, **_about(volume))


def stored_codes(volume: Volume) -> CodedVolume:
    """The codes of the store that ``volume`` is, and the error that the store states."""
    source = getattr(volume, "blocks_source", None)
    assert isinstance(source, StoredBlocks) and source.codes is not None
    coded = source.read_codes(0, np.arange(source.blocks.count))
    codebooks = source.codebooks or label_codebooks(source.dtype)
    codes = CodedVolume(volume.grid, source.blocks, codebooks, coded, **_about(volume))
    return replace(codes, measured=source.codes.measured, value_range=source.value_range)


def _about(volume: Volume) -> dict[str, Any]:
    """What decoded voxels have in common with those of ``volume``."""
    names = {"name": volume.name or "volume", "frame": volume.frame, "unit": volume.unit}
    return {**names, "nan_count": volume.nan_count, "inf_count": volume.inf_count}


class WeighingEncoder(Protocol):
    """A ``BlockEncoder`` that can weigh the errors of blocks."""

    def encode(self, samples: np.ndarray, weights: np.ndarray) -> CodedBlocks:
        """As ``BlockEncoder.encode``, with ``weights`` [k] of the squared errors of each block."""
        ...


class LabelTrainer:
    """A ``Trainer`` and ``BlockEncoder`` of the codec "labels", which has nothing to learn."""

    def train(
        self,
        source: VoxelSource,
        value_range: tuple[float, float],
        codec: str,
        target: RateTarget,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Training:
        return Training(label_codebooks(source.dtype))

    def encoder(self, training: Training) -> LabelTrainer:
        self.training = training
        return self

    def encode(self, samples: np.ndarray) -> CodedBlocks:
        return encode_labels(samples)


def _encoded_layers(
    source: VolumeSource,
    blocks: BlockGrid,
    encoder: BlockEncoder,
    progress: Progress | None,
    weights: np.ndarray | None,
) -> Iterator[CodedBlocks]:
    """The blocks of a few layers after another."""
    nz, ny, nx = blocks.shape
    thick = blocks.edge * max(1, _PIECE // (blocks.edge * blocks.counts[1] * blocks.counts[2] * blocks.edge**2))
    for z in range(0, nz, thick):
        end = min(z + thick, nz)
        slab = source.box(z, end, 0, ny, 0, nx)
        samples = split(whole_blocks(as_coded_type(slab), blocks.edge), blocks.edge)
        first = z // blocks.edge * blocks.counts[1] * blocks.counts[2]
        own = None if weights is None else weights[first : first + len(samples)]
        yield encoder.encode(samples) if own is None else cast(WeighingEncoder, encoder).encode(samples, own)
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


def measured_codes(codes: CodedVolume, original: Volume, layers: Iterable[tuple[int, np.ndarray]]) -> CodedVolume:
    """``codes`` with the range of their decoded ``layers``, and with the error of these, over all finite voxels of the
    ``original``."""
    low, high = original.stored_range
    # Differences of floating-point voxels are halved and divided before they are squared, since they may overflow.
    is_float = original.dtype.kind == "f"
    span = high / 2 - low / 2 if is_float else high - low
    source, (_, ny, nx) = VolumeSource(original), original.shape
    largest, total, count = 0.0, 0.0, 0
    least, most = math.inf, -math.inf
    for z, layer in layers:
        whole, decoded = source.box(z, z + len(layer), 0, ny, 0, nx).reshape(-1), layer.reshape(-1)
        for first in range(0, whole.size, _CACHED):
            voxels, others = whole[first : first + _CACHED], decoded[first : first + _CACHED]
            if is_float:
                is_finite = np.isfinite(voxels)
                voxels, others = voxels[is_finite].astype(np.float64), others[is_finite].astype(np.float64)
                if not voxels.size:
                    continue
                difference = voxels / 2 - others / 2
            else:  # exact in single precision
                difference = np.subtract(voxels, others, dtype=np.float32)
            least, most = min(least, float(others.min())), max(most, float(others.max()))
            largest = max(largest, float(difference.max()), -float(difference.min()))
            squared = difference / (span or 1.0) if is_float else difference.astype(np.float64)
            total += float(np.dot(squared, squared))
            count += difference.size
    total /= 1.0 if is_float else (span or 1.0) ** 2
    psnr = -10 * math.log10(total / count) if total else math.inf
    share = largest / span if span else math.inf if largest else 0.0
    value_range = (least, most) if count else (0.0, 0.0)
    return replace(codes, measured=MeasuredError(psnr, share, codes.bits_per_voxel), value_range=value_range)


def stats_of(codec: str, measured: MeasuredError | None, device_bytes: int, decoded_voxels: int) -> dict[str, Any]:
    """The entry "compression" of a frame's stats. ``psnr`` is None where the codes are exact."""
    assert measured is not None
    return {
        "codec": codec,
        "bits_per_voxel": measured.bits_per_voxel,
        "psnr": None if math.isinf(measured.psnr) else measured.psnr,
        "max_voxel_error": measured.max_voxel_error,
        "device_bytes": device_bytes,
        "decoded_voxels": decoded_voxels,
    }


def in_words(codes: CodedVolume) -> str:
    """What became of the volume, for logs."""
    measured = codes.measured
    assert measured is not None
    return (
        f"encoded {math.prod(codes.grid.shape)} voxels: codec {codes.codebooks.codec}, "
        f"{measured.bits_per_voxel:.3g} bits per voxel, {measured.psnr:.4g} dB, "
        f"largest error {measured.max_voxel_error:.3g} of the range"
    )
