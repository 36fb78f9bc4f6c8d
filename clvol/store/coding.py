"""Making the codes of a store that is being built: the range of the voxels, training, and region by region the bytes of
blocks, their statistics and their errors.

Levels are means of the original voxels, or the most frequent labels. Everything that is said of samples (statistics,
range, counts) is of decoded ones. What neighbouring regions add to the reach of blocks is not known while a region is
made: a region records what it adds to its neighbours' blocks (``extended_reach``), and ``merged_reach`` joins that at
the end.
"""

from __future__ import annotations

import json
import math
import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.errors import ClvolWarning, RenderError, UsageError, VolumeError
from clvol.store.codecs import CODES, Codec
from clvol.store.codecs.coded_blocks import CodedBlocks, MeasuredError, RateTarget
from clvol.store.codecs.encoding import BlockEncoder, Trainer, Training
from clvol.store.format import StoreLayout
from clvol.store.journal import Journal
from clvol.store.packs import packed
from clvol.store.plain_encoders import LabelEncoder, RawEncoder, is_without_codes, raw_block, without_codes
from clvol.store.resolutions import describe_region, extended_reach, majorities, resolutions, split, whole_blocks
from clvol.store.source import BlockStatistics
from clvol.store.stored_codes import BlockCodes, codebooks_json, codebooks_of
from clvol.store.voxel_source import VoxelSource

REACH = {"reach_low": np.minimum, "reach_high": np.maximum, "holes": np.logical_or}
_RANGE, _TRAINING = "range", "training"  # records of the journal
_POSSIBLE = {"max_voxel_error": (0.0, 1.0), "psnr": (0.0, 200.0), "bits_per_voxel": (0.0, 64.0)}
_MOST_OF_RAW = 1.01  # bytes of codes and codebooks, as a share of the voxels'
_CACHED = 1 << 18  # voxels that are compared together
_LARGEST_FLOAT = float(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False)
class CodedRegion:
    """A region at all levels as the store's arrays hold it, and what the journal records of it."""

    stored: list[np.ndarray]
    decoded: np.ndarray
    statistics: BlockStatistics
    more: dict[str, np.ndarray]


def check_target(codec: Codec, target: RateTarget | None) -> RateTarget:
    """The target; UsageError if ``codec`` cannot keep to it, or if it is impossible."""
    own = {} if target is None else target.to_json()
    if own and not codec.targets:
        able = ", ".join(other.name for other in CODES.values() if other.targets)
        raise UsageError(next(iter(own)), f"with the lossless codec {codec.name!r}", f"one of the codecs {able}")
    if len(own) > 1:
        raise UsageError(list(own)[1], f"together with {next(iter(own))}", "one of " + ", ".join(_POSSIBLE))
    for key, value in own.items():
        low, high = _POSSIBLE[key]
        if not low < value <= high:
            raise UsageError(key, f"got {value!r}", f"more than {low:g}, at most {high:g}")
    return RateTarget(**own)


class Coding:
    """The codes of a store of ``layout`` of the voxels ``source``. Regions may be made by several threads."""

    def __init__(
        self, source: VoxelSource, layout: StoreLayout, target: RateTarget, trainer: Trainer | None, seed: int,
    ) -> None:  # fmt: skip
        self.layout, self.target, self.seed = layout, target, seed
        self.codec = layout.codecs[0].name
        if not layout.codecs[0].lossless:
            self._check_lossy(source, trainer)
        self.original_dtype = source.dtype
        self._voxels = source if source.dtype == layout.dtype else AsFloat32(source)
        self._trainer = None if layout.codecs[0].lossless else trainer
        self.range = (0.0, 0.0)
        self.training: Training | None = None
        self._encoder: BlockEncoder | None = None
        self._encoding = threading.Lock()

    def _check_lossy(self, source: VoxelSource, trainer: Trainer | None) -> None:
        if getattr(source, "labels", False):
            what = f"got {self.codec!r} for labels, which it would turn into other labels"
            raise UsageError("codec", what, "'labels', or another lossless codec")
        if trainer is None:
            raise UsageError("trainer", "got None", f"a Trainer for the codec {self.codec}")
        if source.dtype != self.layout.dtype:
            what = f"voxels of {source.dtype} are stored as {self.layout.dtype} by the codec {self.codec}"
            warning = ClvolWarning(source.name or "volume", what, "lossless codecs keep their type")
            warnings.warn(warning, stacklevel=4)

    def plan(self) -> dict[str, Any]:
        """What else an interrupted build must have in common with this one."""
        return {"target": self.target.to_json(), "seed": self.seed}

    # ---- range and training ----

    def known_range(self, journal: Journal) -> bool:
        """Takes the range from the journal, if it is there."""
        if (known := journal.kept(_RANGE)) is None:
            return False
        self.range = tuple(known["range"].tolist())
        return True

    def note_range(self, journal: Journal, low: float, high: float) -> None:
        """Records the range of the finite voxels; inf, -inf if there is none."""
        if low > high:
            low = high = 0.0
        if self.original_dtype != self.layout.dtype and max(-low, high) > _LARGEST_FLOAT:
            what = f"values of up to {max(-low, high):g}, which float32 cannot hold"
            raise VolumeError(self._voxels.name or "source", what, "a lossless codec, such as blosc-lz4")
        journal.keep(_RANGE, range=np.array([low, high]))
        self.range = (low, high)

    def train(self, journal: Journal, progress: Callable[[int, int], None] | None) -> None:
        """Takes the training from the journal, or trains and records it."""
        if self._trainer is None:
            self._encoder = LabelEncoder(self.layout.dtype)
            self.training = self._encoder.training
            return
        training = _training_of(journal.kept(_TRAINING))
        if training is None:
            target = self._target_of_encoder()
            made = self._trainer.train(self._voxels, self.range, self.codec, target, self.seed, progress)
            training = _recorded(made, journal)
        self._use(training)

    def _use(self, training: Training) -> None:
        self.training = training
        if is_without_codes(training):
            self._encoder = RawEncoder(training)
        elif self._trainer is not None:
            self._encoder = self._trainer.encoder(training)

    def gives_up(self, size: int, journal: Journal) -> bool:
        """Whether codes and codebooks of level 0, of ``size`` bytes, take more than voxels that are stored as they are
        may take. The records of regions are then gone, and regions that are made again have no codes."""
        assert self.training is not None
        raw = math.prod(self.layout.shape) * self.layout.dtype.itemsize
        if self._trainer is None or is_without_codes(self.training) or size <= _MOST_OF_RAW * raw:
            return False
        journal.forget_regions()  # before the training that they are of
        self._use(_recorded(without_codes(self.training), journal))
        return True

    def _target_of_encoder(self) -> RateTarget:
        """The target for voxels of float32, so that its bound holds for voxels of float64."""
        bound, extent = self.target.max_voxel_error, self.range[1] - self.range[0]
        if bound is None or extent == 0 or self.original_dtype == self.layout.dtype:
            return self.target
        rounding = float(np.spacing(np.float32(max(map(abs, self.range))))) / extent
        if rounding >= bound:
            what = f"a largest error of {bound:g} of the range, while rounding to float32 takes {rounding:.2g}"
            raise UsageError("max_voxel_error", what, "a larger one, or a lossless codec")
        return RateTarget(max_voxel_error=bound - rounding)

    @property
    def decoder(self) -> BlockCodes:
        assert self.training is not None
        return BlockCodes(self.training.codebooks)

    # ---- regions ----

    def make(self, box: np.ndarray, where: tuple[int, int, int]) -> CodedRegion:
        """The codes of the region ``box`` [z, y, x] of original voxels, which begins at voxel ``where``."""
        try:
            return self._made(box, where)
        except ValueError as error:  # would be taken for one of tensorstore's
            raise RenderError(_place(0, where), f"encoding failed: {error}", "voxels that can be encoded") from error

    def _made(self, box: np.ndarray, where: tuple[int, int, int]) -> CodedRegion:
        layout = self.layout
        reduce = majorities if self._trainer is None else resolutions
        made = reduce(box.astype(layout.dtype, copy=False), layout.blocks.levels)
        stored, decoded, errors = [], [], []
        for level, samples in enumerate(made):
            if not layout.codecs[level].coded:
                stored.append(samples)
                decoded.append(samples)
                continue
            s = layout.blocks.samples(level)
            full = whole_blocks(samples, s)
            coded = self._coded(split(full, s))
            try:
                there = _joined(self.decoder.decode(coded, s), full.shape)[tuple(map(slice, samples.shape))]
            except VolumeError as error:
                what = f"the encoder made impossible codes ({error.what})"
                raise RenderError(_place(level, where), what, "possible ones") from error
            counts = tuple(n // s for n in full.shape)
            stored.append(packed(coded, counts, layout.pack, layout.capacity(level)))
            decoded.append(there)
            errors.append(self._error(samples if level else box, there, level, where))
        z, y, x = box.shape
        _, statistics = describe_region(decoded[0], (slice(0, z), slice(0, y), slice(0, x)), layout.edge, decoded)
        more = dict(zip(("outer_" + name for name in REACH), extended_reach(decoded[0], layout.edge)))
        return CodedRegion(stored, decoded[0], statistics, {**more, "errors": np.stack(errors)})

    def _coded(self, samples: np.ndarray) -> CodedBlocks:
        """The bytes of blocks [k, s, s, s]; raw ones where codes would take more."""
        assert self._encoder is not None
        with self._encoding:
            coded = self._encoder.encode(samples)
        raw = samples[0].nbytes + 1
        if (coded.size <= raw).all():
            return coded
        parts = [
            coded.data[a : a + n] if n <= raw else raw_block(block)
            for a, n, block in zip(coded.start.tolist(), coded.size.tolist(), samples)
        ]
        size = np.minimum(coded.size, raw)
        return CodedBlocks(np.concatenate(parts), np.cumsum(size) - size, size)

    def _error(self, original: np.ndarray, decoded: np.ndarray, level: int, where: tuple) -> np.ndarray:
        """float64 [3]: sum of squared differences, the largest one, and the number of finite samples. RenderError if
        the bound does not hold, or if other samples are finite than before."""
        depth = max(_CACHED // max(original[0].size, 1), 1)
        parts = [
            _difference(original[z : z + depth], decoded[z : z + depth]) for z in range(0, len(original), depth)
        ]
        squares = math.fsum(part[0] for part in parts)
        largest, count = max(part[1] for part in parts), sum(part[2] for part in parts)
        place = _place(level, where)
        if math.isnan(largest):
            raise RenderError(place, "the encoder changed which voxels are finite", "the same ones")
        extent = self.range[1] - self.range[0]
        lossless = self._trainer is None or extent == 0
        bound = 0.0 if lossless else self.target.max_voxel_error
        if bound is not None and largest > bound * extent:
            share = largest / extent if extent else math.inf
            what = f"the encoder left an error of {largest:.6g}, {share:.6g} of the range"
            raise RenderError(place, what, f"at most {bound:g}")
        return np.array([squares, largest, count])

    # ---- the end ----

    def measured(self, errors: np.ndarray, sizes: dict[str, int]) -> MeasuredError:
        """``errors`` float64 [regions, levels with codes, 3], ``sizes`` in bytes, by what they are of."""
        extent, voxels = self.range[1] - self.range[0], math.prod(self.layout.shape)
        levels = []
        for own in errors.transpose(1, 0, 2):
            squares, count = math.fsum(own[:, 0]), own[:, 2].sum()
            psnr = math.inf
            if squares > 0:  # digits beyond these depend on the order of additions
                psnr = round(20 * math.log10(extent) - 10 * math.log10(squares / count), 6)
            largest = float(own[:, 1].max())
            levels.append((psnr, largest / extent if extent else 0.0))
        total = sum(sizes.values())
        facts = {
            "bits_per_voxel_all": 8 * total / voxels,
            "bytes": sizes,
            "levels": [
                {"psnr": psnr if math.isfinite(psnr) else None, "max_voxel_error": largest} for psnr, largest in levels
            ],
        }
        return MeasuredError(*levels[0], 8 * (sizes["codes"] + sizes["codebooks"]) / voxels, facts)


def _place(level: int, where: tuple[int, int, int]) -> str:
    return f"level {level}, the samples from {tuple(n >> level for n in where)}"


def _difference(original: np.ndarray, decoded: np.ndarray) -> tuple[float, float, int]:
    """Sum of squared differences, the largest one (NaN if a sample that is not finite is not as it was, or another one
    is not finite), and the number of finite samples."""
    if original.dtype.kind != "f":
        off = np.subtract(decoded, original, dtype=np.int32)
        largest = float(max(int(off.max()), -int(off.min())))
        flat = off.astype(np.float64).ravel()  # sums are below 2^53, and exact
        return float(np.einsum("i,i->", flat, flat)), largest, off.size
    finite = np.isfinite(original)
    if finite.all():
        flat = np.subtract(decoded, original, dtype=np.float64).ravel()
    else:
        others = ~finite
        if not np.array_equal(decoded[others], original[others].astype(decoded.dtype), equal_nan=True):
            return math.nan, math.nan, 0
        flat = np.subtract(decoded[finite], original[finite], dtype=np.float64)
    largest = float(np.abs(flat).max(initial=0.0))
    return float((flat * flat).sum()), largest if math.isfinite(largest) else math.nan, flat.size


def merged_reach(
    layout: StoreLayout, read: Callable[[int, str], np.ndarray], name: str, z: int
) -> np.ndarray:
    """The statistics ``name`` of the blocks of all regions in row ``z`` of regions, [bz, by, bx]. ``read(index, name)``
    reads what a region has recorded."""
    rows = layout.shard // layout.edge
    nz, ny, nx = layout.regions
    bz, by, bx = layout.blocks.counts
    first, last = z * rows, min((z + 1) * rows, bz)
    dtype, over = layout.statistics_types[name], REACH[name]
    start = {"reach_low": np.inf, "reach_high": -np.inf, "holes": False}[name]
    found = np.full((last - first, by, bx), start, np.float64 if name != "holes" else bool)
    for index in range(max(z - 1, 0) * ny * nx, min(z + 2, nz) * ny * nx):
        added = read(index, "outer_" + name)
        corner = np.array(np.unravel_index(index, layout.regions)) * rows - 1
        low = np.maximum(corner, [first, 0, 0])
        high = np.minimum(corner + added.shape, [last, by, bx])
        if (low < high).all():
            here = tuple(map(slice, low - [first, 0, 0], high - [first, 0, 0]))
            over(found[here], added[tuple(map(slice, low - corner, high - corner))], out=found[here])
    return found.astype(dtype)


def _recorded(training: Training, journal: Journal) -> Training:
    """Records ``training``; returns it as a resumed build has it."""
    said = {"codebooks": codebooks_json(training.codebooks), "policy": training.policy}
    journal.keep(_TRAINING, entries=training.codebooks.entries, json=np.array(json.dumps(said)))
    return _training_of(journal.kept(_TRAINING)) or training


def _training_of(kept: dict[str, np.ndarray] | None) -> Training | None:
    if kept is None:
        return None
    try:
        said = json.loads(str(kept["json"]))
        return Training(codebooks_of(said["codebooks"], kept["entries"]), said["policy"])
    except (KeyError, TypeError, ValueError):
        return None


def _joined(blocks: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The inverse of ``split``: [z, y, x] of ``shape``."""
    s = blocks.shape[-1]
    z, y, x = (n // s for n in shape)
    return blocks.reshape(z, y, x, s, s, s).transpose(0, 3, 1, 4, 2, 5).reshape(shape)


class AsFloat32:
    """``source`` with its voxels as float32."""

    dtype = np.dtype(np.float32)

    def __init__(self, source: VoxelSource) -> None:
        self._source = source

    def __getattr__(self, name: str) -> Any:
        if name == "_source":  # during copying
            raise AttributeError(name)
        return getattr(self._source, name)

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        return self._source.box(z0, z1, y0, y1, x0, x1).astype(np.float32)
