"""What a store needs of an encoder. Encoders use OpenCL, and are therefore in ``clvol.encoding``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from clvol.store.codecs.coded_blocks import Codebooks, CodedBlocks, RateTarget
from clvol.store.voxel_source import VoxelSource

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Training:
    """What an encoder has learnt of a volume: with it and a block's samples alone, its bytes are determined.

    ``policy`` (JSON): how codes are chosen, such as the Lagrangian multiplier or the bound.
    """

    codebooks: Codebooks
    policy: dict[str, Any] = field(default_factory=dict)


class BlockEncoder(Protocol):
    training: Training

    def encode(self, samples: np.ndarray) -> CodedBlocks:
        """The bytes of blocks of ``samples`` [k, s, s, s] of the volume's type (float64 already as float32)."""
        ...


class Trainer(Protocol):
    def train(
        self,
        source: VoxelSource,
        value_range: tuple[float, float],
        codec: str,
        target: RateTarget,
        seed: int = 0,
        progress: Progress | None = None,
    ) -> Training:
        """Learns codebooks and policy from a part of ``source``, in memory that does not grow with it. The same
        source, target and seed give the same training on every device."""
        ...

    def encoder(self, training: Training) -> BlockEncoder: ...
