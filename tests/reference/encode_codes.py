"""What the encoder (clvol/encoding) makes of a block, in numpy and plain loops: integers of any size, no float.

``encoded_block(samples, training)`` gives the bytes of one block [s, s, s].
"""

from __future__ import annotations

import itertools

import numpy as np

from reference.plain_codes import Coded, Constant, Fixed, Raw, SubBlock, write

MOST_STAGES, ENTRIES = 12, 256


def encoded_block(samples: np.ndarray, training, weight: float = 1.0) -> bytes:
    return _Block(samples, training, weight).bytes()


def nearest(residual: np.ndarray, entries: np.ndarray, shift: int, count: int = 1) -> list:
    """The codes of the ``count`` nearest codewords, no two of them alike modulo 16; the lowest of equally near ones.
    Residuals are clipped to what codewords have, and compared in quarters of 1 << shift (vectors of 8 samples: in
    32nds). Codewords of zeros count as unused, but for code 0."""
    residual, parts = residual.astype(np.int64), 32 if len(residual) == 8 else 4
    step = 1 << shift
    compared = (residual - 1) // (step // parts) if step > parts else residual * (parts // step)
    compared = np.clip(compared, 1 - 128 * parts, 128 * parts - 1)
    words = entries.astype(np.int64)
    scores = words @ compared - parts // 2 * (words * words).sum(axis=1)
    unused = ~words.any(axis=1)
    unused[0] = False
    scores[unused] = -(1 << 40)
    lanes = [max(range(lane, ENTRIES, 16), key=lambda code: (scores[code], -code)) for lane in range(16)]
    return sorted(lanes, key=lambda code: (-scores[code], code))[:count]


class _Block:
    def __init__(self, samples, training, weight) -> None:
        self.samples, self.s = samples, samples.shape[0]
        self.books, policy = training.codebooks, training.policy
        self.values = self.books.values
        self.bound, self.lam, self.raw_allowed = policy["bound"], policy["lagrangian"], policy["raw"]
        self.beam = policy["beam"]
        self.weight = 256 if self.bound is None else 0
        self.limit = 2**31 - 1 if self.bound is None else self.bound
        if weight != 1.0 and self.bound is None:
            self.lam = min(1 << 40, max(1, round(self.lam / weight)))
        elif weight != 1.0:
            self.limit = min(int(self.bound / weight**0.5), 2**31 - 1)
        self.packed = 0 if self.bound is None else min(self.bound, 32767)
        self.levels = 65536 if self.values.is_float else self.values.span + 1
        self.odd = ~np.isfinite(samples)
        if not self.values.is_float:
            wide = samples.astype(np.int64)
            self.odd = (wide < self.values.low) | (wide > self.values.low + self.values.span)
        self.work = self.values.encoded(samples).astype(np.int64)

    def steps(self, working):
        """In what errors are counted."""
        return np.clip(working, 0, 65535) * self.levels >> 16

    def bytes(self) -> bytes:
        return write(self.described(), self.s, self.books)

    def described(self):
        raw = Raw(list(self.samples.reshape(-1)))
        bits = self.samples.reshape(-1).view(f"u{self.samples.itemsize}")
        if (bits == bits[0]).all():
            return Constant(self.samples[0, 0, 0])
        if self.s < 4 or self.bound == -1:
            return raw
        block, cost, size = self.coded() if self.books.codec == "rvq" else self.fixed()
        number, item = self.samples.size, 8 * self.samples.itemsize
        steps = self.steps(self.work)
        total, low, high = int(steps.sum()), int(steps.min()), int(steps.max())
        level = (2 * total + number) // (2 * number) if self.weight else (low + high) // 2
        alone = int(((steps - level) ** 2).sum())
        constant = None
        if not self.odd.any() and max(high - level, level - low) <= self.limit and (self.raw_allowed or alone == 0):
            constant = self.weight * alone + self.lam * (8 + item)
        raw_cost = self.lam * (8 + item * number)
        if not self.raw_allowed and cost is not None and 8 + item * number > size:
            raw_cost = None
        best = min(c for c in (cost, raw_cost, constant) if c is not None)
        if constant == best:
            voxel = self.values.decoded(np.array([level]))[0] if self.values.is_float else self.values.low + level
            return Constant(voxel)
        return block if cost == best else raw

    # vq, vq-mean, hvq

    def fixed(self):
        side, n = self.books.side, self.s // self.books.side
        means, codes, squares, largest = [], [[] for _ in range(self.books.stages)], 0, 0
        for z, y, x in itertools.product(range(n), repeat=3):
            part = np.s_[z * side : z * side + side, y * side : y * side + side, x * side : x * side + side]
            work = self.work[part].reshape(-1)
            start = 32768
            if self.books.codec != "vq":
                means.append(int(work.sum()) // side**3 >> 8)
                start = (means[-1] << 8) + 128
            left = work - start
            for stage in range(self.books.stages):
                (code,) = nearest(left, self.books.entries[stage], int(self.books.shifts[stage]))
                codes[stage].append(code)
                left = left - (self.books.entries[stage, code].astype(np.int64) << int(self.books.shifts[stage]))
            off = self.steps(work) - self.steps(work - left)
            squares, largest = squares + int((off * off).sum()), max(largest, int(np.abs(off).max()))
        size = 8 + 8 * (len(means) + sum(map(len, codes)))
        cost = self.weight * squares + self.lam * size
        return Fixed(means, codes), None if self.odd.any() or largest > self.limit else cost, size

    # rvq

    def coded(self):
        octants, cost, size = [], 0, 8
        if self.s > 4:
            size += 8 * -(-((self.s // 8) ** 3) // 8)
        for z, y, x in itertools.product(range(max(1, self.s // 8)), repeat=3):
            edge = min(8, self.s)
            part = np.s_[z * edge : z * edge + edge, y * edge : y * edge + edge, x * edge : x * edge + edge]
            octant, own_cost, own_size = self.octant(self.samples[part], self.work[part], self.odd[part])
            octants.append(octant)
            cost, size = cost + own_cost, size + own_size
        return Coded(octants), cost + self.lam * (size - sum_of(octants)), size

    def octant(self, samples, work, odd):
        corners = itertools.product(range(0, len(work), 4), repeat=3)
        parts = [np.s_[z : z + 4, y : y + 4, x : x + 4] for z, y, x in corners]
        subs = [self.sub_block(samples[p].reshape(-1), work[p].reshape(-1), odd[p].any()) for p in parts]
        head = 16 if len(subs) == 1 else 12
        cost = sum(c for _, c, _ in subs) + self.lam * head * len(subs)
        size = sum(b for _, _, b in subs) + head * len(subs)
        if len(subs) == 8 and not odd.any():
            # The mean of the sub-blocks' sums, each without its lowest four bits.
            mean = sum(int(work[p].sum()) >> 4 for p in parts) // 8 >> 10
            off = self.steps(work) - self.steps((mean << 8) + 128)
            flat = self.weight * int((off * off).sum()) + 8 * self.lam
            if int(np.abs(off).max()) <= self.limit and flat <= max(cost, 96 * self.lam):
                return mean, flat, 8
        return [sub for sub, _, _ in subs], cost, size

    def sub_block(self, samples, work, odd):
        """The best choice, its cost and bits, mean and depth left out."""
        mean = int(work.sum()) >> 14
        size = 8 + 64 * 8 * samples.itemsize
        best = (SubBlock(mean, raw=list(samples)), self.lam * size, size)
        kept = [(work - ((mean << 8) + 128), [])]
        for depth in range(self.books.stages + 1):
            if odd or 8 * depth * self.lam >= best[1]:
                break
            if depth:
                kept = self.gone_on(kept, depth - 1)
            for left, codes in kept:
                best = self.better(best, samples, work, mean, left, codes)
        return best

    def gone_on(self, kept, stage):
        entries, shift = self.books.entries[stage], int(self.books.shifts[stage])
        longer = [
            (left - (entries[code].astype(np.int64) << shift), [*codes, code])
            for left, codes in kept
            for code in nearest(left, entries, shift, self.beam)
        ]
        return sorted(longer, key=lambda one: int((np.minimum(np.abs(one[0]), 65535) ** 2).sum()))[: self.beam]

    def better(self, best, samples, work, mean, left, codes):
        """``best``, or what ``codes`` and packed residuals make of a sub-block if that costs less."""
        depth = len(codes)
        off = self.steps(work) - self.steps(work - left)
        if np.abs(off).max() <= self.limit:
            cost = self.weight * int((off * off).sum()) + self.lam * 8 * depth
            if cost < best[1]:
                best = (SubBlock(mean, codes), cost, 8 * depth)
        step = 2 * self.packed + 1
        residuals = [int(np.sign(o)) * ((abs(int(o)) + self.packed) // step) for o in off]
        bits = next((b for b in range(9) if all(fits(r, b) for r in residuals)), None)
        if bits is None:
            return best
        size = 8 + 8 * depth + 64 * bits
        if self.lam * size < best[1]:
            best = (SubBlock(mean, codes, bits=bits, residuals=residuals), self.lam * size, size)
        return best


def fits(value: int, bits: int) -> bool:
    return value == 0 if bits == 0 else -(1 << bits - 1) <= value < 1 << bits - 1


def sum_of(octants) -> int:
    """Bits of octants, which their costs already count."""
    total = 0
    for octant in octants:
        if not isinstance(octant, list):
            total += 8
            continue
        for sub in octant:
            total += 16 if len(octant) == 1 else 12
            if sub.raw is not None:
                total += 8 + 64 * 8 * np.asarray(sub.raw).itemsize
            elif sub.residuals is not None:
                total += 8 + 8 * len(sub.codes) + 64 * sub.bits
            else:
                total += 8 * len(sub.codes)
    return total
