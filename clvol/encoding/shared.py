"""Encoders on several devices, which share the blocks."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from clvol.encoding.block_encoder import joined
from clvol.errors import DeviceError, RenderError
from clvol.schedule.crew import Team, left_out
from clvol.store.codecs.coded_blocks import CodedBlocks, RateTarget
from clvol.store.codecs.encoding import BlockEncoder, Progress, Trainer, Training
from clvol.store.voxel_source import VoxelSource

_SPEED, _LAUNCH = 2e7, 2e-3  # voxels per second and seconds per package, as a first guess
_LEAST = 1 << 16  # voxels of a package
_OF_BYTE = 8.0  # voxels whose search costs as much as what leads to a byte of codes


class SharedTrainer:
    """A ``Trainer`` whose encoders share blocks among ``trainers``, one per device (``names``). It trains on the first
    one that works."""

    def __init__(self, trainers: Sequence[Trainer], names: Sequence[str]) -> None:
        self._trainers, self._names = list(trainers), list(names)
        self._teams: list[Team] = []

    def close(self) -> None:
        for team in self._teams:
            team.close()

    def train(
        self, source: VoxelSource, value_range: tuple[float, float], codec: str, target: RateTarget, seed: int = 0,
        progress: Progress | None = None,
    ) -> Training:  # fmt: skip
        """As ``Trainer.train``. A device that fails is left out, with a warning; the last one's error is raised."""
        while True:
            try:
                return self._trainers[0].train(source, value_range, codec, target, seed, progress)
            except (DeviceError, RenderError, MemoryError) as error:
                if len(self._trainers) == 1:
                    raise
                warnings.warn(left_out(self._names[0], str(error), self._names[1:]), stacklevel=2)
                del self._trainers[0], self._names[0]

    def encoder(self, training: Training) -> BlockEncoder:
        encoders = [trainer.encoder(training) for trainer in self._trainers]
        if len(encoders) == 1:
            return encoders[0]
        self._teams.append(Team(self._names, _SPEED, _LAUNCH))
        return SharedEncoder(encoders, self._teams[-1])


class SharedEncoder:
    """A ``BlockEncoder`` whose blocks ``encoders``, one per device of ``team``, share. The bytes of a block do not
    depend on where it is encoded."""

    def __init__(self, encoders: Sequence[BlockEncoder], team: Team) -> None:
        self.training = encoders[0].training
        self._encoders, self._team = list(encoders), team

    def encode(self, samples: np.ndarray) -> CodedBlocks:
        samples = np.asarray(samples)
        count = len(samples)
        if not count:
            return self._encoders[0].encode(samples)
        group = max(1, _LEAST // samples[0].size)
        items = -(-count // group)
        found: dict[int, CodedBlocks] = {}

        def take(numbers: np.ndarray, coded: list[CodedBlocks]) -> None:
            found.update(zip(numbers.tolist(), coded))

        hands = [_BlocksOnDevice(encoder, samples, group) for encoder in self._encoders]
        self._team.run(hands, np.full(items, group * samples[0].size * 2.0), take)
        return joined([found[item] for item in range(items)])


class _BlocksOnDevice:
    """A ``Hand`` whose items are groups of blocks."""

    def __init__(self, encoder: BlockEncoder, samples: np.ndarray, group: int) -> None:
        self._encoder, self._samples, self._group = encoder, samples, group

    def begin(self) -> None:
        pass

    def work(self, items: np.ndarray) -> tuple[np.ndarray, list[CodedBlocks]]:
        count = len(self._samples)
        numbers = [np.arange(k * self._group, min((k + 1) * self._group, count)) for k in items.tolist()]
        coded = self._encoder.encode(self._samples[np.concatenate(numbers)])
        ends = np.cumsum([len(own) for own in numbers])
        parts = [_part(coded, int(end) - len(own), int(end)) for end, own in zip(ends, numbers)]
        voxels = self._samples[0].size
        costs = [len(own) * voxels + _OF_BYTE * len(part.data) for own, part in zip(numbers, parts)]
        return np.array(costs, np.float64), parts


def _part(coded: CodedBlocks, first: int, last: int) -> CodedBlocks:
    """Blocks ``first`` to ``last`` - 1 of ``coded``, whose bytes follow one another."""
    start, size = coded.start[first:last], coded.size[first:last]
    return CodedBlocks(coded.data[start[0] : start[-1] + size[-1]], start - start[0], size)
