"""clvol's own codecs on a volume in memory, everything counted: blocks, the index of blocks, codebooks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.compression_scenes import Target


@dataclass(frozen=True, eq=False)
class Coded:
    nbytes: int
    seconds: float
    payload: Any


class Coder:
    def __init__(self, volume: Any, device: Any) -> None:
        self.volume, self.device = volume, device

    def encode(self, codec: str, target: Target) -> Coded:
        from clvol.errors import UsageError

        raise UsageError("codec", codec, "an encoder")

    def decode(self, coded: Coded) -> np.ndarray:
        raise NotImplementedError
