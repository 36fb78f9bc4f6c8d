"""Training of an encoder on a source of voxels."""

from __future__ import annotations

import math

import numpy as np

from clvol.encoding.block_encoder import CodeEncoder, ToWorking, first_residual
from clvol.encoding.codebook import trained_codebook
from clvol.encoding.draws import MOST_VOXELS, drawn_blocks, drawn_by_weight
from clvol.encoding.kernels import EncoderKernels, levels_of
from clvol.encoding.policy import Policy, bound_of
from clvol.opencl.context import DeviceContext
from clvol.store.codecs.coded_blocks import ENTRIES, MOST_STAGES, SHAPES, Codebooks, RateTarget
from clvol.store.codecs.encoding import Progress, Training
from clvol.store.codecs.working_values import working_values
from clvol.store.voxel_source import VoxelSource

DEFAULT_ERROR = 0.02  # of the range, where a target is not given ("rvq")
_ROWS = 60000  # sub-blocks that a stage is trained on
_POOL = 1 << 18  # sub-blocks that they are drawn from


class CodeTrainer:
    """A ``Trainer`` whose search runs on ``context``."""

    def __init__(self, context: DeviceContext) -> None:
        self.kernels = EncoderKernels(context)

    def encoder(self, training: Training) -> CodeEncoder:
        return CodeEncoder(self.kernels, training)

    def train(
        self,
        source: VoxelSource,
        value_range: tuple[float, float],
        codec: str,
        target: RateTarget,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Training:
        dtype = np.dtype(np.float32) if np.dtype(source.dtype).kind == "f" else np.dtype(source.dtype)
        if not all(math.isfinite(v) for v in value_range):
            value_range = (0.0, 0.0)
        values = working_values(dtype, value_range)
        side = SHAPES[codec][0]
        pool = self._pool(source, values, side, seed)
        levels = levels_of(Codebooks(codec, side, np.zeros((0, ENTRIES, side**3), np.int8), np.zeros(0), values))
        stages = {"vq": 1, "vq-mean": 1, "hvq": 2, "rvq": MOST_STAGES}[codec]
        entries, shifts = np.zeros((stages, ENTRIES, side**3), np.int8), np.zeros(stages, np.int32)
        residual, _ = first_residual(pool, codec)
        context = self.kernels.context
        on_device = context.upload(pool if len(pool) else np.zeros((1, side**3), np.uint16))
        errors = np.ones(len(pool), np.uint64)
        for stage in range(stages):
            rows = residual[drawn_by_weight(errors, min(_ROWS, len(pool)), seed + stage)]
            if codec == "hvq" and stage == 0:
                rows = _means_of_eighths(rows)
            entries[stage], shifts[stage] = trained_codebook(rows, self.kernels.nearest)
            if codec == "hvq" and stage == 0:
                entries[stage] = _means_of_eighths(entries[stage].astype(np.int32)).astype(np.int8)
            if len(pool) and stage + 1 < stages:
                left = context.upload(residual, writable=True)
                _, errors, _ = self.kernels.advance(
                    on_device, left, pool.shape, entries[stage], int(shifts[stage]), levels
                )
                residual = context.read(left)
            if progress is not None:
                progress(stage + 1, stages + 1)
        books = Codebooks(codec, side, entries, shifts, values)
        policy, stages = self._policy(source, value_range, books, target, seed)
        books = Codebooks(codec, side, entries[:stages], shifts[:stages], values, policy.residual_step)
        if progress is not None:
            progress(len(shifts) + 1, len(shifts) + 1)
        return Training(books, policy.to_json())

    def _pool(self, source, values, side, seed) -> np.ndarray:
        """Working values uint16 [n, side^3] of sub-blocks drawn from ``source``, of those that are not flat."""
        to_working = ToWorking(values)
        parts = []
        for blocks, _ in drawn_blocks(source, MOST_VOXELS, seed):
            work = to_working(blocks.astype(values.dtype)).work
            n = 32 // side
            cut = work.reshape(-1, n, side, n, side, n, side).transpose(0, 1, 3, 5, 2, 4, 6).reshape(-1, side**3)
            cut = cut[(cut != cut[:, :1]).any(axis=1)] if side == 4 else cut
            parts.append(cut)
        rows = np.concatenate(parts) if parts else np.empty((0, side**3), np.uint16)
        if len(rows) > _POOL:
            rows = rows[np.arange(_POOL) * len(rows) // _POOL]
        return np.ascontiguousarray(rows)

    def _policy(self, source, value_range, books, target, seed) -> tuple[Policy, int]:
        stages = books.stages
        if books.codec == "rvq" and not target.to_json():
            target = RateTarget(max_voxel_error=DEFAULT_ERROR)
        if target.max_voxel_error is not None:
            bound = bound_of(target.max_voxel_error, books.values, value_range)
            return Policy(bound=bound, lagrangian=1), stages
        if not target.to_json():
            return Policy(raw=False), stages
        sample = np.concatenate([blocks for blocks, _ in drawn_blocks(source, 1 << 23, seed)])
        sample = sample.astype(books.values.dtype)
        k = len(sample)
        sample = sample.reshape(k, 2, 16, 2, 16, 2, 16).transpose(0, 1, 3, 5, 2, 4, 6).reshape(-1, 16, 16, 16)
        peak = (value_range[1] - value_range[0]) / books.values.scale  # of integers, the scale is 1
        total = float(np.prod(source.shape, dtype=np.float64))
        low, high = 0, 40
        best = 1
        while low <= high:
            middle = (low + high) // 2
            policy = Policy(lagrangian=1 << middle)
            encoder = self.encoder(Training(books, policy.to_json()))
            squares = bits = 0
            for first in range(0, len(sample), 512):
                found = encoder.outcome(sample[first : first + 512])
                squares += int(found.squares.sum())
                bits += int(found.bits.sum()) + 32 * len(found.bits)
            psnr = 10 * math.log10(peak**2 * sample.size / squares) if squares else math.inf
            rate = bits / sample.size + 8 * books.nbytes / total
            if target.psnr is not None:
                fits = psnr >= target.psnr
                low, high = (middle + 1, high) if fits else (low, middle - 1)
            else:
                fits = rate <= target.bits_per_voxel
                low, high = (low, middle - 1) if fits else (middle + 1, high)
            if fits:
                best = middle
        return Policy(lagrangian=1 << best), stages


def _means_of_eighths(rows: np.ndarray) -> np.ndarray:
    """Rows [n, 64] with each of their 2^3 samples replaced by their mean (rounded down)."""
    eighths = rows.reshape(-1, 2, 2, 2, 2, 2, 2)
    means = eighths.sum(axis=(2, 4, 6), keepdims=True) >> 3
    return np.ascontiguousarray(np.broadcast_to(means, eighths.shape).reshape(rows.shape).astype(rows.dtype))
