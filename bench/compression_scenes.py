"""What compression is measured on: volumes with the scenes of the bench, what codecs are asked for, and the goals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from bench.scenes import CHEST, SCENES, BenchScene

Target = dict[str, float]  # as ``RateTarget`` takes it


@dataclass(frozen=True)
class CodedScene:
    """``rates``: bits per voxel that "rvq" is asked for. ``goal``: (bits per voxel at most, PSNR at least) or None;
    ``held``: bits per voxel that have been enough for that PSNR, and are to stay so."""

    scene: BenchScene
    rates: tuple[float, ...]
    goal: tuple[float, float] | None = None
    held: float = 0.0

    @property
    def name(self) -> str:
        return self.scene.name.split("-")[0]


def _scene(name: str) -> BenchScene:
    return next(scene for scene in SCENES if scene.name == name)


ENGINE = CodedScene(_scene("engine-smooth"), (0.25, 0.45, 0.8, 1.5), (0.45, 44.5), 0.315)
HEPTANE = CodedScene(_scene("heptane"), (0.09, 0.18, 0.35, 0.7), (0.18, 47.0), 0.1555)
CHEST_CODED = CodedScene(CHEST, (0.5, 1.0, 1.5, 2.0), (1.0, 40.0), 0.22)
ANEURISM = CodedScene(_scene("aneurism"), (0.06, 0.12, 0.2, 0.4))
CODED_SCENES = (ENGINE, HEPTANE, CHEST_CODED, ANEURISM)

FIXED = ("vq", "vq-mean", "hvq")  # of a rate that is their own
BOUNDS = (0.04, 0.02, 0.01)  # largest errors, as shares of the range
ZFP_RATES = (0.5, 1.0, 2.0, 4.0)  # bits per voxel
ZFP_TOLERANCES = (2.0, 1.0, 1 / 2, 1 / 4, 1 / 8)  # of the range; its errors are far smaller
SZ3_BOUNDS = (0.08, 0.04, 0.02, 0.01, 0.005)


@dataclass(frozen=True)
class Ask:
    """What a codec is asked for. ``curve``: the codec and its kind of target, which is a curve of the chart."""

    codec: str
    kind: str = "own rate"
    value: float | None = None

    @property
    def curve(self) -> str:
        return self.codec if self.kind == "own rate" else f"{self.codec}, {self.kind}"

    @property
    def is_peer(self) -> bool:
        return self.codec in ("zfp", "sz3")

    @property
    def target(self) -> Target:
        """Of a codec of clvol."""
        key = {"rate": "bits_per_voxel", "psnr": "psnr", "bound": "max_voxel_error"}.get(self.kind)
        return {} if key is None or self.value is None else {key: self.value}


def asks(scene: CodedScene, quick: bool = False) -> Iterator[Ask]:
    """All that is asked for on ``scene``; with ``quick``, of each curve the middle one."""
    goal = () if scene.goal is None else (scene.goal[1],)
    curves = (
        *(("rvq", kind, values) for kind, values in (("rate", scene.rates), ("bound", BOUNDS), ("psnr", goal))),
        *((codec, "own rate", (None,)) for codec in FIXED),
        ("zfp", "rate", ZFP_RATES), ("zfp", "accuracy", ZFP_TOLERANCES), ("sz3", "bound", SZ3_BOUNDS),
    )  # fmt: skip
    for codec, kind, values in curves:
        for value in values[len(values) // 2 :][:1] if quick else values:
            yield Ask(codec, kind, value)
