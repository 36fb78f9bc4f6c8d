"""What a run was asked for."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

DEFAULT = "auto"  # the classification that a user gets
RESULTS = Path(__file__).resolve().parent / "results"


@dataclass(frozen=True)
class Options:
    """``quick``: small and short; its results go to a folder of their own and claim nothing."""

    quick: bool = False
    device: str | None = None
    sizes: tuple[int, ...] = (512, 1024)
    scenes: tuple[str, ...] = field(default=())
    frames: int = 9
    classification: str | None = None  # None: DEFAULT, in peers and shaded
    large: bool = False  # of multiresolution: the volume of 8 GiB, too

    @property
    def folder(self) -> Path:
        return RESULTS / "quick" if self.quick else RESULTS

    @property
    def references(self) -> Path:
        return RESULTS / "references"
