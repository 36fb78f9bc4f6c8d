"""Training of an encoder on a source of voxels."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from clvol.encoding.block_encoder import CodeEncoder, ToWorking
from clvol.encoding.draws import DrawnBlocks, drawn, drawn_blocks
from clvol.encoding.fixed import trained_fixed
from clvol.encoding.kernels import EncoderKernels, levels_of
from clvol.encoding.policy import Goal, Policy, goal_of
from clvol.encoding.rate import LAST_STEP, StageCosts, excess, found_step, measure, multiplier, step_of
from clvol.encoding.stages import POOL, needing, pool_of, survey, trained_stages
from clvol.errors import UsageError
from clvol.opencl.context import DeviceContext
from clvol.store.codecs.coded_blocks import ENTRIES, MOST_STAGES, SHAPES, Codebooks, RateTarget
from clvol.store.codecs.decode import decode_blocks
from clvol.store.codecs.encoding import Progress, Training
from clvol.store.codecs.working_values import WorkingValues, working_values
from clvol.store.voxel_source import VoxelSource

DEFAULT_ERROR = 0.02  # of the range: the target of "rvq" where none is given
MOST_VOXELS = 1 << 27  # of which a training looks at all; of more it draws regions
_NEAR = 0.997  # of the error (0.01 dB) or the bits of the target: good enough
_OF_A_PART = 0.98  # of the error or the bits of the target
_SAMPLE = 1 << 22  # voxels on which a multiplier is searched for, before all are looked at


class CodeTrainer:
    """A ``Trainer`` whose search runs on ``context``. Its trainings are for level 0 in blocks of 16^3 voxels, and serve
    other blocks, too.

    ``beam``: sequences of codes that the search of "rvq" keeps per sub-block: 1, 2 or 4. It multiplies the time of the
    search. None: 2 where the target is a bound, which saves about a tenth of the bits there (4: about a sixth), else 1:
    under the other targets, 4 gain 0.1 to 0.3 dB.
    """

    def __init__(self, context: DeviceContext, beam: int | None = None) -> None:
        if beam not in (None, 1, 2, 4):
            raise ValueError(f"beam {beam}")
        self.kernels, self.beam = EncoderKernels(context), beam

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
        """Learns codebooks and policy from ``source``; see ``Trainer``. ``progress(done, total)`` counts steps.

        A PSNR beyond what codes reach becomes exact blocks. UsageError for fewer bits than constant blocks take."""
        if not all(math.isfinite(v) for v in value_range):
            value_range = (0.0, 0.0)  # no finite voxel: all blocks are raw or constant
        if codec == "rvq" and not target.to_json():
            target = RateTarget(max_voxel_error=DEFAULT_ERROR)
        run = _Run(self.kernels, source, value_range, codec, target, seed, progress, self.beam)
        return run.train()


class _Run:
    """One training."""

    def __init__(
        self, kernels: EncoderKernels, source: VoxelSource, value_range: tuple[float, float], codec: str,
        target: RateTarget, seed: int, progress: Progress | None, beam: int | None,
    ) -> None:  # fmt: skip
        self.kernels, self.source, self.codec, self.seed = kernels, source, codec, seed
        self.dtype = np.dtype(np.float32) if np.dtype(source.dtype).kind == "f" else np.dtype(source.dtype)
        self.values: WorkingValues = working_values(self.dtype, value_range)
        self.target = target
        self.goal: Goal = goal_of(target, self.values, value_range)
        self.total = int(np.prod(source.shape, dtype=np.int64))
        # Where a part of the volume stands for all, the target is met with something to spare.
        self.margin = 1.0 if self.total <= MOST_VOXELS else _OF_A_PART
        self.progress = progress
        self.beam = beam or (1 if self.goal.bound is None else 2)
        self.done, self.steps = 0, MOST_STAGES + 4
        self.to_working = ToWorking(self.values)
        self.levels = levels_of(self.books(0))

    def books(self, stages: int) -> Codebooks:
        side = SHAPES[self.codec][0]
        return Codebooks(
            self.codec, side, np.zeros((stages, ENTRIES, side**3), np.int8), np.zeros(stages, np.int32), self.values
        )

    def blocks(self, most: int | None = None) -> Iterator[DrawnBlocks]:
        """Those of the whole volume, or of about ``most`` voxels; of ``MOST_VOXELS`` at most."""
        return drawn_blocks(self.source, min(most or MOST_VOXELS, MOST_VOXELS), self.seed, self.dtype)

    def step(self, done: int) -> None:
        """``done`` of ``steps`` are done."""
        self.done = max(self.done, done)
        if self.progress is not None:
            self.progress(self.done, self.steps)

    def train(self) -> Training:
        about = {"target": self.target.to_json(), "seed": self.seed}
        if self.codec == "rvq":
            books, guess, facts = self._stages()
        else:
            entries, shifts, facts = trained_fixed(
                self.kernels, self.blocks(), self.to_working, self.codec, self.levels, self.seed, self.step
            )
            books, guess = replace(self.books(len(shifts)), entries=entries, shifts=shifts), 1 << 16
        self.step(MOST_STAGES + 2)
        policy = self._policy(books, guess)
        self.step(self.steps)
        return Training(replace(books, residual_step=policy.residual_step), policy.to_json() | about | facts)

    def _stages(self) -> tuple[Codebooks, int, dict]:
        """Codebooks of "rvq", a first guess at the multiplier, and facts for the policy."""
        found = survey(self.kernels, self.blocks(), self.to_working, self.levels)
        guess = 1 if self.goal.bound is not None else found.lagrangian(self.goal)
        self.step(1)
        if self.goal.bound == -1:  # no working value is close enough
            return self.books(0), guess, {}
        need = needing(found, self.goal, guess)
        # A few distinct residuals may be repeated by all sub-blocks, whatever the target.
        places = drawn(need, POOL, self.seed)
        pool = pool_of(self.kernels, self.blocks(), self.to_working, self.levels, places)
        stands_for = len(need) / max(1, len(places))
        costs = StageCosts(found, self.goal, 8 * self.dtype.itemsize, found.voxels / self.total)
        stages = trained_stages(
            self.kernels, pool, self.levels, self.goal, guess, self.seed, len(places) == len(need),
            lambda squares, largest: costs.add(squares, largest, stands_for), lambda stage: self.step(1 + stage),
        )  # fmt: skip
        chosen = costs.chosen()
        n = chosen.stages
        books = replace(self.books(n), entries=stages.entries[:n], shifts=stages.shifts[:n])
        facts = {} if stages.distinct is None else {"distinct_vectors": stages.distinct}
        return books, chosen.lagrangian, facts

    def _policy(self, books: Codebooks, guess: int) -> Policy:
        """The policy that meets the target, measured on all blocks that are drawn."""
        if self.goal.bound is not None:
            return Policy(bound=self.goal.bound, beam=self.beam)
        if not self.target.to_json():
            return Policy(raw=False)
        goal = self.goal

        def ratio(step: int, blocks: Iterable[DrawnBlocks]) -> float:
            policy = Policy(lagrangian=multiplier(step), beam=self.beam)
            encoder = CodeEncoder(self.kernels, Training(books, policy.to_json()))
            return excess(measure(encoder, blocks, decode_blocks), goal, books, self.total) / self.margin

        sample: list[DrawnBlocks] = list(self.blocks(_SAMPLE))
        falls = goal.squares is None
        step = found_step(lambda step: ratio(step, sample), step_of(guess), falls, _NEAR)
        if self.total > _SAMPLE:
            step = found_step(lambda step: ratio(step, self.blocks()), step, falls, _NEAR)
        if step in (0, LAST_STEP) and ratio(step, self.blocks()) > 1:
            return self._beyond(books)
        return Policy(lagrangian=multiplier(step), beam=self.beam)

    def _beyond(self, books: Codebooks) -> Policy:
        """Where no multiplier meets the target: an exact policy, or, of a rate, UsageError."""
        if self.goal.squares is not None:
            return Policy(bound=0, beam=self.beam)
        encoder = CodeEncoder(self.kernels, Training(books, Policy(lagrangian=multiplier(LAST_STEP)).to_json()))
        bits = measure(encoder, self.blocks(), decode_blocks).bits + 8 * books.nbytes / self.total
        least = math.ceil(bits / self.margin * 1000) / 1000
        what = f"got {self.target.bits_per_voxel:g}, less than constant blocks take"
        raise UsageError("bits_per_voxel", what, f"at least {least:g} for this volume")
