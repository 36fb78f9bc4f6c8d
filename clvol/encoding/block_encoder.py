"""Blocks of samples as bytes, by what a training says: the same on every device, and however blocks are grouped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.encoding.kernels import ChosenCodes, CutBlocks, EncoderKernels, levels_of, search_tables
from clvol.encoding.packing import in_octants, pack_coded, pack_fixed, samples_of
from clvol.encoding.policy import Policy
from clvol.store.codecs.coded_blocks import CODED, CONSTANT, ESCAPED, FIXED, MOST_STAGES, RAW, RAW_SAMPLES, CodedBlocks
from clvol.store.codecs.encoding import Training
from clvol.store.codecs.working_values import WORKING_BITS, WorkingValues

_AT_ONCE = 1 << 21  # samples


@dataclass(frozen=True, eq=False)
class Samples:
    """Blocks [k, s, s, s] as they come, and as working values.

    ``odd`` bool of the same shape, or None: voxels that working values do not express. ``alike`` bool [k]: all samples
    of a block are the same bits.
    """

    voxels: np.ndarray
    work: np.ndarray
    odd: np.ndarray | None
    alike: np.ndarray


class ToWorking:
    """Voxels to working values, by a table where they are integers."""

    def __init__(self, values: WorkingValues) -> None:
        self.values = values
        self.table = None
        if not values.is_float:
            every = np.arange(1 << 8 * values.dtype.itemsize).astype(values.dtype.str.replace("i", "u"))
            voxels = every.view(values.dtype)
            self.table = values.encoded(voxels).astype(np.uint16)
            outside = (voxels.astype(np.int64) < values.low) | (voxels.astype(np.int64) > values.low + values.span)
            self.outside = outside if outside.any() else None

    def __call__(self, voxels: np.ndarray) -> Samples:
        voxels = np.ascontiguousarray(voxels, self.values.dtype)
        bits = voxels.view(f"u{voxels.dtype.itemsize}").reshape(len(voxels), -1)
        alike = (bits == bits[:, :1]).all(axis=1)
        if self.table is None:
            odd = ~np.isfinite(voxels)
            work = self.values.encoded(voxels).astype(np.uint16)
            return Samples(voxels, work, odd if odd.any() else None, alike)
        codes = voxels.view(f"u{voxels.dtype.itemsize}")
        odd = None
        if self.outside is not None:
            low, high = self.values.low, self.values.low + self.values.span
            if int(voxels.min()) < low or int(voxels.max()) > high:
                odd = self.outside[codes]
        return Samples(voxels, self.table[codes], odd, alike)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was chosen for blocks: ``kinds`` uint8 [k], squared error and bits int64 [k], largest error int64 [k]."""

    kinds: np.ndarray
    squares: np.ndarray
    bits: np.ndarray
    largest: np.ndarray


class CodeEncoder:
    """A ``BlockEncoder`` of ``training`` by ``kernels``."""

    def __init__(self, kernels: EncoderKernels, training: Training) -> None:
        self.kernels, self.training = kernels, training
        self.codebooks = training.codebooks
        self.policy = Policy.from_json(training.policy)
        self.levels = levels_of(self.codebooks)
        self.to_working = ToWorking(self.codebooks.values)
        self.tables = search_tables(kernels.context, *_at_least_one(self.codebooks.entries, self.codebooks.shifts))

    def encode(self, samples: np.ndarray, weights: np.ndarray | None = None) -> CodedBlocks:
        """The bytes of blocks of ``samples`` [k, s, s, s] of the volume's type (float64 already as float32).

        ``weights`` [k] >= 0: how much the squared errors of each block count, such as its visibility; 0 where it cannot
        be seen. 1 of all if None.
        """
        samples = np.asarray(samples)
        each = max(1, _AT_ONCE // max(1, int(np.prod(samples.shape[1:]))))
        parts = []
        for first in range(0, len(samples), each):
            part = slice(first, first + each)
            parts.append(self._encode(samples[part], None if weights is None else np.asarray(weights)[part])[0])
        return joined(parts)

    def outcome(self, samples: np.ndarray) -> Outcome:
        """What ``encode`` would choose for ``samples``, which are few enough to be encoded at once."""
        return self._encode(samples, None, pack=False)[1]

    def _encode(
        self, voxels: np.ndarray, weights: np.ndarray | None, pack: bool = True
    ) -> tuple[CodedBlocks, Outcome]:
        samples = self.to_working(voxels)
        if voxels.shape[1] < 4 or self.policy.bound == -1:
            return self._plain(samples)
        lambdas, bounds = self.policy.per_block(weights, len(voxels))
        if self.codebooks.codec == "rvq":
            return self._encode_stages(samples, lambdas, bounds, pack)
        return self._encode_fixed(samples, lambdas, bounds)

    def _plain(self, samples: Samples) -> tuple[CodedBlocks, Outcome]:
        """Constant blocks where all bits are the same, and raw ones."""
        kinds = np.where(samples.alike, CONSTANT, RAW).astype(np.uint8)
        coded = pack_fixed(kinds, samples.voxels, samples.voxels[:, 0, 0, 0], [])
        none = np.zeros(len(kinds), np.int64)
        return coded, Outcome(kinds, none, 8 * coded.size, none)

    # rvq

    def _encode_stages(
        self, samples: Samples, lambdas: np.ndarray, bounds: np.ndarray, pack: bool
    ) -> tuple[CodedBlocks, Outcome]:
        k, edge = samples.work.shape[:2]
        cut = self.kernels.cut(samples.work, self.levels)
        per_block = cut.octants // k
        odd = np.zeros((cut.octants, cut.subs), np.uint8)
        if samples.odd is not None:
            n = edge // 4
            cells = samples.odd.astype(np.uint8).reshape(k, n, 4, n, 4, n, 4).max(axis=(2, 4, 6))
            odd = np.ascontiguousarray(in_octants(cells, cut.subs))
        packed = self.policy.packed
        chosen = self.kernels.choose(
            cut, odd, self.tables, self.codebooks.stages, np.repeat(lambdas, per_block), np.repeat(bounds, per_block),
            self.policy.weight, packed, 8 * samples.voxels.dtype.itemsize, self.levels, self.policy.beam,
        )  # fmt: skip
        found = chosen.found.astype(np.int64).reshape(k, per_block, 3)
        bits = found[:, :, 1].sum(axis=1) + 8 + (8 * ((per_block + 7) // 8) if cut.subs == 8 else 0)
        # Depths of four bits fill whole bytes: octants have eight sub-blocks.
        sums = cut.sums.astype(np.int64).reshape(k, per_block, 4)
        outcome, constants = self._kinds(
            samples, CODED, found[:, :, 0].sum(axis=1), bits, found[:, :, 2].max(axis=1), sums, lambdas, bounds
        )
        if not pack:
            return joined([]), outcome
        in_coded = np.repeat(outcome.kinds == CODED, per_block)
        escaped = np.flatnonzero((chosen.depths == ESCAPED) & (in_coded & (chosen.split != 0))[:, None])
        coded = pack_coded(
            outcome.kinds, samples.voxels, constants, cut.means, chosen.split != 0, chosen.depths, chosen.codes,
            chosen.escapes, escaped, self._residuals(samples, cut, chosen, escaped),
        )  # fmt: skip
        return coded, outcome

    def _residuals(
        self, samples: Samples, cut: CutBlocks, chosen: ChosenCodes, escaped: np.ndarray
    ) -> np.ndarray:
        """int32 [n, 64]: what is left of escaped sub-blocks after their stages, in residual steps."""
        books = self.codebooks
        octant, sub = np.divmod(escaped, cut.subs)
        escapes = chosen.escapes.reshape(-1)[escaped]
        stages = np.where(escapes == RAW_SAMPLES, 0, escapes & 15)
        work = samples_of(samples.work, octant, sub).astype(np.int32)
        working = np.repeat((cut.means[octant, sub].astype(np.int32) << 8)[:, None] + 128, 64, axis=1)
        codes = chosen.codes.reshape(-1, MOST_STAGES)[escaped]
        for stage in range(int(stages.max(initial=0))):
            own = np.flatnonzero(stages > stage)
            working[own] += books.entries[stage].astype(np.int32)[codes[own, stage]] << int(books.shifts[stage])
        working = np.clip(working, 0, (1 << WORKING_BITS) - 1).astype(np.int64)
        levels = self.levels
        left = (work.astype(np.int64) * levels >> WORKING_BITS) - (working * levels >> WORKING_BITS)
        bound = self.policy.packed
        return (np.sign(left) * ((np.abs(left) + bound) // (2 * bound + 1))).astype(np.int32)

    # vq, vq-mean, hvq

    def _encode_fixed(
        self, samples: Samples, lambdas: np.ndarray, bounds: np.ndarray
    ) -> tuple[CodedBlocks, Outcome]:
        books, side, k = self.codebooks, self.codebooks.side, len(samples.work)
        work = cut_in_order(samples.work, side)
        residual, means = first_residual(work, books.codec)
        parts = [] if books.codec == "vq" else [means.reshape(k, -1)]
        context = self.kernels.context
        on_device, left = context.share(work), context.upload(residual, writable=True)
        squares, largest = np.zeros(len(work), np.uint64), np.zeros(len(work), np.int32)
        for stage in range(books.stages):
            codes, squares, largest = self.kernels.advance(
                on_device, left, work.shape, books.entries[stage], int(books.shifts[stage]), self.levels
            )
            parts.append(codes.reshape(k, -1).copy())
        steps = (samples.work.astype(np.int64) * self.levels >> WORKING_BITS).reshape(k, 1, -1)
        sums = np.stack([steps.sum(2), (steps * steps).sum(2), steps.min(2), steps.max(2)], axis=2)
        bits = np.full(k, 8 + 8 * sum(part.shape[1] for part in parts), np.int64)
        outcome, constants = self._kinds(
            samples, FIXED, squares.reshape(k, -1).sum(axis=1).astype(np.int64), bits,
            largest.reshape(k, -1).max(axis=1).astype(np.int64), sums, lambdas, bounds,
        )  # fmt: skip
        return pack_fixed(outcome.kinds, samples.voxels, constants, parts), outcome

    # Blocks

    def _kinds(
        self, samples: Samples, kind: int, squares: np.ndarray, bits: np.ndarray, largest: np.ndarray,
        sums: np.ndarray, lambdas: np.ndarray, bounds: np.ndarray,
    ) -> tuple[Outcome, np.ndarray]:  # fmt: skip
        """The kind of each block, and the constant [k] of those that have one. ``sums`` int64 [k, octants, 4]: sums,
        sums of squares, least and largest of voxels' steps."""
        k, itemsize = len(bits), samples.voxels.dtype.itemsize
        voxels = samples.voxels[0].size
        weight = self.policy.weight
        total, square = sums[:, :, 0].sum(axis=1), sums[:, :, 1].sum(axis=1)
        lowest, highest = sums[:, :, 2].min(axis=1), sums[:, :, 3].max(axis=1)
        if weight:
            level = (2 * total + voxels) // (2 * voxels)  # rounded to nearest
        else:
            level = (lowest + highest) // 2
        alone = square - 2 * level * total + voxels * level * level
        far = np.maximum(highest - level, level - lowest)
        is_odd = np.zeros(k, bool) if samples.odd is None else samples.odd.reshape(k, -1).any(axis=1)
        never = np.int64(2**62)
        cost = weight * squares + lambdas * bits
        if kind == FIXED:
            cost[is_odd | (largest > bounds)] = never
        constant_bits, raw_bits = 8 + 8 * itemsize, 8 + 8 * itemsize * voxels
        flat = weight * alone + lambdas * constant_bits
        flat[is_odd | (far > bounds)] = never
        if not self.policy.raw:
            raw = np.where((raw_bits <= bits) | (cost == never), lambdas * raw_bits, never - 1)
            flat[alone > 0] = never
        else:
            raw = lambdas * raw_bits
        kinds = np.full(k, kind, np.uint8)
        kinds[raw < cost] = RAW
        kinds[flat <= np.minimum(cost, raw)] = CONSTANT
        kinds[samples.alike] = CONSTANT
        plain, constant = kinds != kind, kinds == CONSTANT
        outcome = Outcome(
            kinds,
            np.where(plain, np.where(constant & ~samples.alike, alone, 0), squares),
            np.where(plain, np.where(constant, constant_bits, raw_bits), bits),
            np.where(plain, np.where(constant & ~samples.alike, far, 0), largest),
        )
        constants = self._voxels_of(level)
        constants[samples.alike] = samples.voxels[samples.alike, 0, 0, 0]
        return outcome, constants

    def _voxels_of(self, steps: np.ndarray) -> np.ndarray:
        """Voxels of ``steps``: see ``levels_of``."""
        values = self.codebooks.values
        if values.is_float:
            return values.decoded(steps)
        return (values.low + steps).astype(values.dtype)


def cut_in_order(blocks: np.ndarray, side: int) -> np.ndarray:
    """Sub-blocks [n, side^3] of blocks [k, s, s, s], in C order of each block."""
    k, n = len(blocks), blocks.shape[1] // side
    cut = blocks.reshape(k, n, side, n, side, n, side).transpose(0, 1, 3, 5, 2, 4, 6)
    return np.ascontiguousarray(cut).reshape(-1, side**3)


def first_residual(work: np.ndarray, codec: str) -> tuple[np.ndarray, np.ndarray]:
    """What means leave of ``work`` (uint16 [n, samples]): int32 of the same shape; and the means uint8 [n]."""
    wide = work.astype(np.int32)
    if codec == "vq":
        return wide - (1 << WORKING_BITS - 1), np.zeros(len(work), np.uint8)
    means = (wide.sum(axis=1, dtype=np.int64) // work.shape[1] >> 8).astype(np.uint8)
    return wide - (means.astype(np.int32)[:, None] << 8) - 128, means


def joined(parts: list[CodedBlocks]) -> CodedBlocks:
    """The blocks of ``parts`` one after another."""
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return CodedBlocks(np.empty(0, np.uint8), np.empty(0, np.int64), np.empty(0, np.int64))
    data = np.concatenate([part.data for part in parts])
    size = np.concatenate([part.size for part in parts])
    return CodedBlocks(data, np.cumsum(size) - size, size)


def _at_least_one(entries: np.ndarray, shifts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``entries`` and ``shifts`` of a stage more if there is none, since buffers are not empty."""
    if len(shifts):
        return entries, shifts
    return np.zeros((1, *entries.shape[1:]), np.int8), np.zeros(1, np.int32)
