"""Rate against distortion: every codec on the same voxels, what it takes, and what becomes of voxels and pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from bench.compression_codecs import Coder
from bench.compression_errors import bits_per_voxel, voxel_error
from bench.compression_peers import PeerError, Peers
from bench.compression_scenes import Ask, CodedScene, asks
from bench.report import say

QUICK_EDGE = 48  # voxels per axis of what a quick run takes of a volume
_KINDS = {"rate": "rate", "accuracy": "tolerance", "bound": "bound"}  # what compression_child.py calls them


@dataclass
class Tried:
    """What came of an ``Ask``."""

    ask: Ask
    bytes: int
    encode_seconds: float
    decode_seconds: float
    voxels: np.ndarray
    training_seconds: float = 0.0


class Subject:
    """A volume and its picture, all codecs at hand. ``picture`` [size, size, 4] is that of the voxels themselves."""

    def __init__(self, scene: CodedScene, device: Any, size: int, peers: Peers | None, quick: bool) -> None:
        self.scene, self.device, self.size, self.peers = scene, device, size, peers
        self.volume = scene.scene.load()
        if quick:
            self.volume = middle(self.volume, QUICK_EDGE)
        self.coder = Coder(self.volume, device)
        if peers is not None:
            peers.load(self.volume.data)
        self.picture = self.rendered(self.volume.data)

    @property
    def span(self) -> float:
        low, high = self.volume.value_range
        return float(high - low)

    def rendered(self, voxels: np.ndarray) -> np.ndarray:
        from clvol import Renderer, Volume

        grid = self.volume.grid
        volume = Volume(voxels, spacing=grid.spacing, name=self.volume.name)
        asked = self.scene.scene.scene(volume, self.size, classification=self.scene.scene.classification)
        with Renderer(asked, [self.device]) as renderer:
            return renderer.render(depth=False).rgba

    def tried(self, ask: Ask) -> Tried:
        """PeerError or ClvolError where the codec fails."""
        if not ask.is_peer:
            coded = self.coder.encode(ask.codec, ask.target)
            start = perf_counter()
            voxels = self.coder.decode(coded)
            return Tried(ask, coded.nbytes, coded.seconds, perf_counter() - start, voxels, coded.training_seconds)
        assert self.peers is not None
        encoded = self.peers.encode(ask.codec, *self.peer_ask(ask))
        voxels, seconds = self.peers.decode(encoded)
        self.peers.forget()
        return Tried(ask, encoded.bytes, encoded.seconds, seconds, voxels)


    def peer_ask(self, ask: Ask) -> tuple[str, float]:
        """The kind of target and its value as compression_child.py takes them: errors in the voxels' unit."""
        assert ask.value is not None
        return _KINDS[ask.kind], ask.value if ask.kind == "rate" else ask.value * self.span


def middle(volume: Any, edge: int) -> Any:
    """At most ``edge`` voxels per axis around the middle of ``volume``."""
    from clvol import Volume

    box = tuple(slice((n - min(n, edge)) // 2, (n + min(n, edge)) // 2) for n in volume.data.shape)
    return Volume(np.ascontiguousarray(volume.data[box]), spacing=volume.grid.spacing, name=volume.name)


def rates(subject: Subject, quick: bool, failed: list[str], pictures: Path) -> list[dict[str, Any]]:
    """A row for every ``Ask`` that can be met. The rendered pictures are kept in the folder ``pictures``."""
    from clvol.errors import ClvolError

    pictures.mkdir(parents=True, exist_ok=True)
    np.save(pictures / f"{subject.scene.name}.npy", subject.picture)
    rows = []
    for ask in asks(subject.scene, quick):
        if ask.is_peer and (subject.peers is None or ask.codec not in subject.peers.codecs):
            continue
        start = perf_counter()
        try:
            tried = subject.tried(ask)
        except (ClvolError, PeerError) as error:
            say(f"{subject.scene.name}, {ask.curve}: {error}")
            failed.append(f"{subject.scene.name}, {ask.curve}: {error}")
            continue
        row = rate_row(subject, tried, pictures)
        rows.append(row)
        say(f"{subject.scene.name}, {ask.curve}{'' if ask.value is None else f' {ask.value:.4g}'}:"
            f" {row['bits']:.3f} bits per voxel, {psnr_text(row)}, largest error {row['largest']:.1%},"
            f" CIEDE2000 {row['delta_e']:.2f}   ({perf_counter() - start:.1f} s)")  # fmt: skip
    return rows


def psnr_text(row: dict[str, Any]) -> str:
    return "exact" if row["psnr"] is None else f"{row['psnr']:.1f} dB"


def rate_row(subject: Subject, tried: Tried, pictures: Path) -> dict[str, Any]:
    """"psnr" is None where all voxels are exact."""
    from clvol.accuracy.metrics import delta_e

    ask, volume = tried.ask, subject.volume
    error = voxel_error(tried.voxels, volume.data, volume.value_range)
    shown = subject.rendered(tried.voxels)
    apart = delta_e(shown, subject.picture)
    name = picture_name(subject.scene.name, ask.curve, ask.value)
    np.save(pictures / name, shown)
    return {
        "volume": subject.scene.name, "codec": ask.codec, "kind": ask.kind, "curve": ask.curve, "asked": ask.value,
        "bytes": tried.bytes, "bits": bits_per_voxel(tried.bytes, volume.data.size),
        "psnr": error.psnr if math.isfinite(error.psnr) else None, "largest": error.largest,
        "delta_e": float(apart.mean()),
        "delta_e_largest": float(apart.max()), "encode_seconds": tried.encode_seconds,
        "decode_seconds": tried.decode_seconds, "training_seconds": tried.training_seconds, "picture": name,
    }  # fmt: skip


def picture_name(volume: str, curve: str, asked: float | None) -> str:
    told = f"{volume}-{curve}" + ("" if asked is None else f"-{asked:.4g}")
    return told.replace(", ", "-").replace(" ", "-") + ".npy"
