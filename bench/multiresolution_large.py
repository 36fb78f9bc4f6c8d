"""A volume of 2048^3 bytes (8 GiB): stored from a generator, and rendered, each in a process of its own.

``python -m bench.multiresolution_large STORE EDGE`` is the first of them. The second is ``clvol render``.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bench.report import say

EDGE, QUICK_EDGE = 2048, 256
MEMORY, SIZE = "256 MiB", 1024
MEMORY_GOAL = 2 * 2**30  # bytes of a process
_CHILD = Path(__file__).resolve().parent / "child.py"
_ROOT = Path(__file__).resolve().parent.parent
_SCENE = """version = 1
[volume]
file = {store}
[camera]
position = [{x}, {y}, {z}]
target = [{centre}, {centre}, {centre}]
up = [0.0, 1.0, 0.0]
fov_degrees = 30.0
[image]
width = {size}
height = {size}
[transfer_function]
opacity_unit = {unit}
color_space = "linear"
points = [
  {{ value = 112.0, opacity = 0.0, color = [0.05, 0.08, 0.25] }},
  {{ value = 132.0, opacity = 0.05, color = [0.06, 0.16, 0.5] }},
  {{ value = 150.0, opacity = 0.15, color = [0.5, 0.12, 0.05] }},
  {{ value = 172.0, opacity = 0.6, color = [1.0, 0.55, 0.15] }},
  {{ value = 210.0, opacity = 0.9, color = [1.0, 0.95, 0.8] }},
]
[integration]
method = "multiresolution"
classification = "post"
[multiresolution]
memory = "{memory}"
"""


class Turbulence:
    """A ball of turbulence, uint8 [edge, edge, edge]: plane waves of random directions, lengths from the whole
    edge to a few voxels, amplitudes as the root of the length, on a hill. Every voxel is a function of its
    place alone.

    cos(a + b) = cos a cos b - sin a sin b, with a of z and b of y and x: a box is a product of two thin
    matrices, which costs little more than writing it.
    """

    frame, name = "world", "turbulence"
    dtype = np.dtype(np.uint8)
    shortest, waves = 6.0, 10  # voxels; of each octave

    def __init__(self, edge: int) -> None:
        from clvol.volume.grid import Grid

        self.shape = (edge, edge, edge)
        self.grid = Grid(self.shape, (1.0, 1.0, 1.0))
        random = np.random.default_rng(7)
        octaves = int(np.log2(edge / self.shortest))
        lengths = edge / 1.6 / 2.0 ** (np.arange(octaves * self.waves) / self.waves)
        directions = random.normal(size=(len(lengths), 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._waves = 2 * np.pi * directions / lengths[:, None]  # radians a voxel, (x, y, z)
        self._phases = random.uniform(0.0, 2 * np.pi, len(lengths))
        self._amplitudes = 20.0 * (lengths / lengths[0]) ** 0.5

    @property
    def identity(self) -> dict:
        return {"field": self.name, "edge": self.shape[0]}

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        edge, rows = self.shape[0], 16
        centre = 0.5 * (edge - 1)
        z, y, x = (np.arange(a, b, dtype=np.float64) for a, b in ((z0, z1), (y0, y1), (x0, x1)))
        along = np.outer(z, self._waves[:, 2]) + self._phases
        hill = [((i - centre) / (0.47 * edge)) ** 2 for i in (z, y, x)]
        left = np.concatenate(
            [np.cos(along) * self._amplitudes, -np.sin(along) * self._amplitudes,
             168.0 - 130.0 * hill[0][:, None], np.ones((len(z), 1))], axis=1,
        ).astype(np.float32)  # fmt: skip
        cos_y, sin_y = _cos_and_sin(np.outer(self._waves[:, 1], y)[:, :, None])
        cos_x, sin_x = _cos_and_sin(np.outer(self._waves[:, 0], x)[:, None, :])
        out = np.empty((len(z), len(y), len(x)), np.uint8)
        for first in range(0, len(y), rows):
            part = slice(first, first + rows)
            c, s = cos_y[:, part], sin_y[:, part]
            slope = (-130.0 * (hill[1][part, None] + hill[2])).astype(np.float32)
            right = np.concatenate(
                [c * cos_x - s * sin_x, s * cos_x + c * sin_x, np.ones((1, *slope.shape), np.float32),
                 slope[None]]
            )  # fmt: skip
            values = left @ right.reshape(len(right), -1)
            np.clip(values, 0.0, 255.0, out=values)
            values += np.float32(0.5)
            out[:, part] = values.reshape(len(z), -1, len(x))
        return out


def _cos_and_sin(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.cos(angles).astype(np.float32), np.sin(angles).astype(np.float32)


def large(device: str | None, quick: bool, picture: Path) -> dict[str, Any] | None:
    """Stores and renders it in a temporary folder; the picture goes to ``picture``. None where
    something failed."""
    edge = QUICK_EDGE if quick else EDGE
    with tempfile.TemporaryDirectory(prefix="clvol-bench-") as folder:
        store, scene = Path(folder) / "large.zarr", Path(folder) / "large.toml"
        built = measured_child([sys.executable, "-m", "bench.multiresolution_large", str(store), str(edge)])
        if built is None:
            return None
        say(f"{edge}^3 stored: {built['seconds']:.0f} s, at most {built['peak_bytes'] / 1e6:.0f} MB")
        scene.write_text(_scene(store, edge, 96 if quick else SIZE), encoding="utf-8")
        stats = Path(folder) / "stats.json"
        chosen = ["--device", device] if device else []
        rendered = measured_child([
            sys.executable, "-m", "clvol", "render", str(scene), "-o", str(picture),
            "--stats", str(stats), *chosen,
        ])  # fmt: skip
        if rendered is None:
            return None
        size = sum(f.stat().st_size for f in Path(folder).rglob("*") if f.is_file())
        told = json.loads(stats.read_text(encoding="utf-8"))
    say(f"rendered: {rendered['seconds']:.1f} s, at most {rendered['peak_bytes'] / 1e6:.0f} MB")
    return {
        "edge": edge, "voxel_bytes": edge**3, "disk_bytes": size, "memory": MEMORY,
        "size": 96 if quick else SIZE, "built": built, "rendered": rendered,
        "stats": told, "picture": str(picture),
    }  # fmt: skip


def _scene(store: Path, edge: int, size: int) -> str:
    centre = 0.5 * (edge - 1)
    x, y, z = (centre + edge * share for share in (1.15, 0.75, 1.6))
    return _SCENE.format(store=json.dumps(str(store)), centre=centre, x=x, y=y, z=z, size=size,
                         unit=edge / 48, memory=MEMORY)  # fmt: skip


def measured_child(command: list[str]) -> dict[str, Any] | None:
    """Seconds and peak bytes of a command that succeeds."""
    paths = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-S", "-E", str(_CHILD), *command], capture_output=True, text=True,
        env=environment, cwd=_ROOT,
    )  # fmt: skip
    measured = json.loads(done.stdout.splitlines()[-1]) if done.returncode == 0 else None
    if measured is None or measured["status"] != 0:
        say(f"failed: {' '.join(command)}: {done.stderr.strip()[-500:]}")
        return None
    return measured


def main(arguments: list[str]) -> int:
    from clvol.store.build import build_store

    path, edge = arguments
    build_store(Turbulence(int(edge)), path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
