"""The plain twin of rays through a volume of blocks: the definition in numpy, float64, slow and
obvious.

Only tests use it. It shares with the kernels (cl/blocks.h, cl/blend_blocks.h, cl/step_blocks.h,
cl/march_blocks.h) nothing but what they define, and with them takes from a ray's entry into the
volume the same samples, so that both agree to float32's and the tables' rounding. Places are in
voxels, p = index + 1/2, as there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED, BlockSource
from reference.classify import MovedFunction, of_chord, of_value
from reference.clip import kept_stretches

DROPPED_DELTA = 2.0**-15  # half a sample, in blocks, of a block without samples
_CHUNK = 1 << 14  # places looked at together
# Bit x, y, z of the number of a block around a place: it lies across the nearest face along that
# axis.
_ACROSS = (np.arange(8)[:, None] >> np.arange(3)) & 1


def _edge_weight(near: np.ndarray, far: np.ndarray, d: np.ndarray, p2: bool) -> np.ndarray:
    """Of the block beyond a face at distance ``d``, on the edge between blocks with half samples
    ``near`` and ``far``."""
    if p2:
        return np.clip((near - d) / (near + far), 0.0, 1.0)
    e = np.maximum(0.5 - d / (2.0 * np.minimum(near, far)), 0.0)
    here, there = near == DROPPED_DELTA, far == DROPPED_DELTA
    e = np.where(there & ~here, np.maximum(1.0 - d / near, 0.0), e)
    return np.where(here & ~there, 0.0, e)


class BlockField:
    """The field of blocks of ``grid``, each at its level (uint8 [blocks], DROPPED for none).

    ``samples[level]`` [k, s, s, s] (z, y, x): of the blocks at that level, in order. ``means``
    [blocks]: the one value of blocks of one sample and of dropped ones.
    """

    def __init__(
        self, grid: BlockGrid, levels: np.ndarray, samples: Sequence[np.ndarray], means: np.ndarray
    ) -> None:
        self.grid, self.levels = grid, np.asarray(levels, np.uint8)
        self.means = np.asarray(means, np.float64)
        self._counts = np.array(grid.counts[::-1])
        self._slot = np.zeros(grid.count, np.int64)
        for level in range(grid.levels):
            those = np.flatnonzero(self.levels == level)
            self._slot[those] = np.arange(len(those))
        self._samples = [np.asarray(s, np.float64) for s in samples]
        steps = np.minimum(self.levels, grid.levels - 1).astype(np.int64)
        self._delta = np.where(self.levels == DROPPED, DROPPED_DELTA, 0.5 / (grid.edge >> steps))
        # Voxels from one sample to the next; of dropped blocks and those of one sample the edge.
        self.sample_edge = (1 << steps).astype(np.float64)

    @classmethod
    def of(
        cls, source: BlockSource, levels: np.ndarray, means: np.ndarray | None = None
    ) -> BlockField:
        """Reads ``source``; without ``means`` they are its statistics'."""
        levels = np.asarray(levels, np.uint8)
        if means is None:
            means = np.concatenate([part.mean[-1] for part in source.statistics()])
        samples = [
            source.read(level, np.flatnonzero(levels == level))
            for level in range(source.blocks.levels - 1)
        ]
        return cls(source.blocks, levels, samples, means)

    def block_at(self, p: np.ndarray) -> np.ndarray:
        """int64 [n, 3] (x, y, z): blocks that hold the places [n, 3]."""
        return np.clip(np.floor(p / self.grid.edge).astype(np.int64), 0, self._counts - 1)

    def number(self, blocks: np.ndarray) -> np.ndarray:
        """int64 [...]: numbers of blocks [..., 3] (x, y, z)."""
        x, y, z = np.moveaxis(blocks, -1, 0)
        return (z * self._counts[1] + y) * self._counts[0] + x

    def __call__(self, p: np.ndarray, interblock: bool | str = True) -> np.ndarray:
        """The field [n] at places [n, 3] (x, y, z). ``interblock``: False for each block by itself,
        clamped to the hull of its samples; "p2" for the weights of Ljung 2006."""
        p = np.asarray(p, np.float64)
        parts = [self._field(p[i : i + _CHUNK], interblock) for i in range(0, len(p), _CHUNK)]
        return np.concatenate(parts) if parts else np.zeros(0)

    def in_block(self, blocks: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Values [n] at ``p`` [n, 3] by the samples of ``blocks`` [n, 3] alone, clamped to their
        hull. What has weight 0 does not count, even if it is not finite."""
        number = self.number(blocks)
        out = self.means[number].copy()
        for level, samples in enumerate(self._samples):
            those = np.flatnonzero(self.levels[number] == level)
            if not len(those):
                continue
            s = self.grid.samples(level)
            place = (p[those] - self.grid.edge * blocks[those]) / (1 << level) - 0.5
            place = np.clip(place, 0.0, s - 1.0)
            lower = np.minimum(np.floor(place), s - 2).astype(np.int64)
            fraction = place - lower
            x, y, z = (lower + np.round(fraction).astype(np.int64)).T
            base = samples[self._slot[number[those]], z, y, x].astype(np.float64)  # has the largest weight
            total = np.zeros(len(those))
            for corner in _ACROSS:
                weight = np.where(corner, fraction, 1.0 - fraction).prod(axis=1)
                x, y, z = (lower + corner).T
                value = samples[self._slot[number[those]], z, y, x]
                with np.errstate(invalid="ignore"):
                    total += np.where(weight != 0.0, weight * (value - base), 0.0)
            out[those] = base + total
        return out

    def weights(self, p: np.ndarray, p2: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """(blocks int64 [n, 8, 3], weights [n, 8] that add up to 1) around places [n, 3].

        Block f lies across the nearest faces along the axes whose bits are set in f; beyond the
        volume the outermost ones stand in. ``p2``: the weights of Ljung 2006, as wide as the coarser block's
        spacing, and not bounded by the block's own hull.
        """
        own = self.block_at(p)
        inside = np.clip(p / self.grid.edge - own, 0.0, 1.0)
        upper = inside >= 0.5
        d = np.where(upper, 1.0 - inside, inside)
        beyond = np.clip(own + np.where(upper, 1, -1), 0, self._counts - 1)
        blocks = np.where(_ACROSS, beyond[:, None], own[:, None])
        delta = self._delta[self.number(blocks)]
        weights = np.ones(delta.shape)
        for f in range(8):
            for axis in range(3):
                # Along the edge between blocks `near` and `far`; the one beyond the face has weight
                # e on it.
                near, far = f & ~(1 << axis), f | (1 << axis)
                e = _edge_weight(delta[:, near], delta[:, far], d[:, axis], p2)
                weights[:, f] *= e if f == far else 1.0 - e
        if not p2:
            u = np.clip((delta[:, :1] - d) / delta[:, :1], 0.0, 1.0).max(axis=1)
            weights[:, 1:] = np.minimum(weights[:, 1:], u[:, None])
        return blocks, weights / weights.sum(axis=1, keepdims=True)

    def _field(self, p: np.ndarray, interblock: bool | str) -> np.ndarray:
        own = self.block_at(p)
        if not interblock:
            return self.in_block(own, p)
        blocks, weights = self.weights(p, interblock == "p2")
        # What is dropped is not blended: it shows nothing.
        dropped = self.levels[self.number(own)] == DROPPED
        weights[dropped] = np.eye(8)[0]
        base = self.in_block(own, p)
        value = base.copy()
        for f in range(1, 8):
            those = np.flatnonzero(weights[:, f] > 0.0)
            other = self.in_block(blocks[those, f], p[those])
            with np.errstate(invalid="ignore"):
                value[those] += weights[those, f] * (other - base[those])
        return value


@dataclass
class BlockPicture:
    """``rgba`` float64 [..., 4], premultiplied, linear. ``samples`` int [...]: places on each ray
    that a value was taken at.

    ``margin`` [...]: how near, in steps, a ray came to taking other samples, or others of these: by
    a place next to a face of a block, where that decides, or by a number of steps next to a whole
    one. Rounding may decide otherwise there.
    ``overshoot`` [...]: how far, in steps, a segment goes beyond the block that it begins in, at
    most.
    """

    rgba: np.ndarray
    samples: np.ndarray
    margin: np.ndarray
    overshoot: np.ndarray


@dataclass
class _Rays:
    """n rays: places origin + t step, t from 0 to ``length``."""

    origin: np.ndarray
    step: np.ndarray
    length: np.ndarray
    margin: np.ndarray = field(init=False)
    overshoot: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.margin = np.full(len(self.length), np.inf)
        self.overshoot = np.zeros(len(self.length))


def render_blocks_twin(
    resolved,
    blocks: BlockField,
    *,
    stepping: str | None = None,
    interblock: bool | str | None = None,
    most_steps: np.ndarray | None = None,
) -> BlockPicture:
    """The picture of ``resolved`` through ``blocks``, without empty space being leapt over.

    ``stepping`` and ``interblock`` instead of the scene's. ``most_steps`` [blocks]: the most steps
    at once of stepping "bounded". A post-classified segment has the value in its middle; of a
    preintegrated one the chord between its ends is integrated exactly, shifted so that its mean is
    that of the parabola through them and the sample before.
    """
    settings, integration = resolved.multiresolution, resolved.integration
    stepping = stepping or settings.stepping
    interblock = settings.interblock if interblock is None else interblock
    rays = resolved.camera.world_rays(resolved.image.width, resolved.image.height)
    shape = rays[0].shape[:-1]
    origin, direction = (np.reshape(part, (-1, 3)) for part in rays)
    grid = resolved.volume.grid
    kept = kept_stretches(grid, (), origin, direction)
    hit = np.flatnonzero(np.isfinite(kept.enter[:, 0]))
    enter, leave = kept.enter[hit, 0], kept.leave[hit, 0]
    to_index, unit = grid.world_to_index(), integration.step * grid.smallest_edge
    thin = np.array([n == 1 for n in grid.size])
    start = origin[hit] + enter[:, None] * direction[hit]
    # An axis of one voxel is a slab, held from the voxel's centre on.
    place = start @ to_index[:3, :3].T + to_index[:3, 3] + np.where(thin, 1.0, 0.5)
    state = _Rays(place, unit * direction[hit] @ to_index[:3, :3].T, (leave - enter) / unit)
    function = MovedFunction(resolved.transfer_function)
    upper = np.maximum(np.array(grid.size), 2) - 0.5
    march = _March(blocks, function, unit, upper, stepping, interblock, most_steps)
    preintegrated = integration.classification == "preintegrated"
    if stepping == "limited" and not preintegrated:
        march.beyond = 1.0
    shown, taken = march.by_chords(state) if preintegrated else march.by_middles(state)

    def whole(found: np.ndarray, none: float) -> np.ndarray:
        out = np.full((len(origin), *found.shape[1:]), none, found.dtype)
        out[hit] = found
        return out.reshape(*shape, *found.shape[1:])

    return BlockPicture(
        whole(shown, 0.0), whole(taken, 0), whole(state.margin, np.inf), whole(state.overshoot, 0.0)
    )


class _March:
    def __init__(self, blocks, function, unit, upper, stepping, interblock, most_steps) -> None:
        self.blocks, self.function, self.unit = blocks, function, unit
        self.upper, self.interblock = upper, interblock
        self.stepping = stepping
        self.beyond = 0.0  # steps that may be taken into the next block
        self.most = most_steps if stepping == "bounded" else blocks.sample_edge

    def by_middles(self, state: _Rays) -> tuple[np.ndarray, np.ndarray]:
        """(rgba [n, 4], samples [n]): values in the middle of segments."""
        rgba, taken, t = self._nothing(state)
        while len(n := np.flatnonzero(t < state.length)):
            far = np.minimum(t[n] + self._steps(state, n, t[n]), state.length[n])
            value = self._value(state, n, 0.5 * (t[n] + far))
            color, depth = of_value(self.function, value, (far - t[n]) * self.unit)
            depth = np.where(np.isfinite(value), depth, 0.0)
            _composite(rgba, n, np.where(np.isfinite(value)[:, None], color, 0.0), depth)
            taken[n] += 1
            t[n] = far
        return rgba, taken

    def by_chords(self, state: _Rays) -> tuple[np.ndarray, np.ndarray]:
        """The same by values at the ends of segments."""
        rgba, taken, t = self._nothing(state)
        value = self._value(state, np.arange(len(t)), t)
        # The sample before, and how long the segment from there was.
        before, last = np.full(len(t), np.nan), np.ones(len(t))
        taken += 1
        while len(n := np.flatnonzero(t < state.length)):
            far = np.minimum(t[n] + self._steps(state, n, t[n]), state.length[n])
            length, back = far - t[n], self._value(state, n, far)
            front, end = shifted_chord(before[n], value[n], back, last[n], length)
            color, depth = of_chord(self.function, front, end, length * self.unit)
            _composite(rgba, n, color, depth)
            taken[n] += 1
            before[n], value[n], last[n], t[n] = value[n], back, length, far
        return rgba, taken

    def _nothing(self, state: _Rays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        n = len(state.length)
        return np.zeros((n, 4)), np.zeros(n, int), np.zeros(n)

    def _place(self, state: _Rays, n: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.clip(state.origin[n] + t[:, None] * state.step[n], 0.5, self.upper)

    def _value(self, state: _Rays, n: np.ndarray, t: np.ndarray) -> np.ndarray:
        p = self._place(state, n, t)
        if not self.interblock or (self.blocks.levels == DROPPED).any():
            state.margin[n] = np.minimum(state.margin[n], self._to_faces(state, n, p))
        return self.blocks(p, self.interblock)

    def _to_faces(self, state: _Rays, n: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Steps from ``p`` to the planes of blocks' faces."""
        edge, step = self.blocks.grid.edge, np.abs(state.step[n])
        still = step < 1e-12
        steps = np.abs(p - edge * np.rint(p / edge)) / np.where(still, 1.0, step)
        return np.where(still, np.inf, steps).min(axis=1)

    def _steps(self, state: _Rays, n: np.ndarray, t: np.ndarray) -> np.ndarray:
        """How far the rays ``n`` go from t."""
        if self.stepping == "full":
            return np.ones(len(n))
        p, step = self._place(state, n, t), state.step[n]
        block = self.blocks.block_at(p)
        taken = self.most[self.blocks.number(block)].astype(np.float64)
        face = self.blocks.grid.edge * (block + (step > 0))
        still = np.abs(step) < 1e-12
        leaves = (face - state.origin[n]) / np.where(still, 1.0, step)
        left = np.maximum(np.where(still, np.inf, leaves).min(axis=1) - t, 0.0)
        margin = self._to_faces(state, n, p)
        if self.stepping != "naive":
            beyond = self.beyond
            near = np.rint(left)
            decides = (near > 1.0 - beyond) & (near <= taken - beyond)
            margin = np.where(decides, np.minimum(margin, np.abs(left - near)), margin)
            taken = np.maximum(np.minimum(beyond + np.floor(left), taken), 1.0)
        state.margin[n] = np.minimum(state.margin[n], margin)
        far = np.minimum(t + taken, state.length[n])
        state.overshoot[n] = np.maximum(state.overshoot[n], far - t - left)
        return taken


def shifted_chord(
    before: np.ndarray, front: np.ndarray, back: np.ndarray, a: np.ndarray, b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The ends of a segment of length ``b`` behind one of length ``a``, shifted by -s'' b^2 / 12,
    s'' that of the parabola through the three values; both stay within these. NaN as ``before``:
    the chord as it is."""
    curvature = 2.0 * ((back - front) / b - (front - before) / a) / (a + b)
    shift = -curvature * b**2 / 12.0
    low = np.minimum(np.minimum(before, front), back)
    high = np.maximum(np.maximum(before, front), back)
    good = np.isfinite(shift)
    with np.errstate(invalid="ignore"):
        ends = [np.where(good, np.clip(v + shift, low, high), v) for v in (front, back)]
    return ends[0], ends[1]


def _composite(rgba: np.ndarray, n: np.ndarray, color: np.ndarray, depth: np.ndarray) -> None:
    weight = (1.0 - rgba[n, 3]) * -np.expm1(-depth)
    rgba[n, :3] += weight[:, None] * color
    rgba[n, 3] += weight
