"""Scenes by a seed: any volume, function, view, filter, classification and method, beside their exact integral.

    python tests/helpers/random_scenes.py 500        # so many, from seed 0; prints whose error does not shrink

``tests/hard_cases/test_random_scenes.py`` runs the first few.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol import Camera, Renderer, Scene, TransferFunction, Volume
from clvol.errors import ClvolWarning
from clvol.integrators.reference.picture import render_reference
from clvol.scene import ImageSettings, Integration
from clvol.scene.pyramid import Pyramid

STEPS = (1.0, 0.25, 1.0 / 16.0)
FINER = (1.0 / 64.0, 1.0 / 256.0)  # for peaks so narrow that a step of 1/16 leaps over them
FLOOR = 5e-5  # RMSE that single precision may leave of any scene
_TYPES = (np.uint8, np.uint8, np.int16, np.uint16, np.float32, np.float64)


@dataclass(frozen=True)
class RandomScene:
    seed: int
    tables: dict[str, Any]
    volume: Volume

    def at(self, step: float, **integration: Any) -> Scene:
        tables = {**self.tables, "integration": {**self.tables["integration"], **integration}}
        tables["integration"] = Integration(step=step, **tables["integration"])
        return Scene(volume=self.volume, **tables)

    def __str__(self) -> str:
        i, f = self.tables["integration"], self.tables["transfer_function"]
        return (
            f"seed {self.seed}: {self.volume.dtype} {self.volume.shape}, {i}, {f.values.size} points, "
            f"opacity up to {f.opacities.max():g} a length of {f.opacity_unit:g}"
        )


def random_scene(seed: int) -> RandomScene:
    rng = np.random.default_rng(seed)
    dtype = np.dtype(_TYPES[rng.integers(len(_TYPES))])
    array = _voxels(rng, dtype)
    spacing = tuple(10.0 ** rng.uniform(-0.3, 0.3, 3)) if rng.random() < 0.5 else (1.0, 1.0, 1.0)
    volume = Volume(array, spacing=spacing)
    method = str(rng.choice(["raycast", "raycast", "raycast", "cells", "multiresolution", "pyramid"]))
    integration: dict[str, Any] = {"early_termination": 0.0, "filter": "linear"}
    integration["classification"] = str(rng.choice(["pre", "post", "preintegrated", "preintegrated"]))
    if method == "raycast":
        integration["filter"] = str(rng.choice(["linear", "linear", "nearest", "cubic"]))
    elif integration["classification"] == "pre" or method == "pyramid":
        integration["classification"] = "preintegrated"
    if method == "cells":
        integration["quadrature"] = "cells"
    else:
        integration["method"] = method
    tables = {
        "camera": _camera(rng, volume),
        "image": ImageSettings(width=20, height=16),
        "transfer_function": _function(rng, array, volume),
        "integration": integration,
    }
    if method == "pyramid":
        tables["pyramid"] = Pyramid(oracle="minimum")
    if method == "multiresolution":
        integration.pop("filter")
    return RandomScene(seed, tables, volume)


def _voxels(rng: np.random.Generator, dtype: np.dtype) -> np.ndarray:
    shape = tuple(rng.integers(2, 20, 3))
    kind = rng.integers(4)
    if kind == 0:  # noise
        values = rng.random(shape)
    else:
        z, y, x = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
        a, b, c = rng.uniform(1, 7, 3)
        values = 0.5 + 0.5 * np.cos(a * x + rng.random()) * np.cos(b * y) * np.cos(c * z + rng.random())
        if kind == 1:  # plateaus
            values = np.round(values * rng.integers(1, 6)) / 5
        elif kind == 2:  # an object on constant ground
            values = np.where(values > 0.5, values, 0.0)
    if dtype.kind == "f":
        return (values * 10.0 ** rng.uniform(-3, 3)).astype(dtype)
    low, high = (-1024, 3071) if dtype == np.int16 else (0, 255 if dtype == np.uint8 else 4095)
    return np.round(low + values * (high - low)).astype(dtype)


def _function(rng: np.random.Generator, array: np.ndarray, volume: Volume) -> TransferFunction:
    low, high = float(array.min()), float(array.max())
    span = high - low or 1.0
    count = int(rng.choice([1, 2, 3, 5, 9, 14, 40]))
    values = np.sort(low + span * rng.uniform(-0.1, 1.1, count))
    if rng.random() < 0.5:  # on values that voxels have
        values = np.sort(rng.choice(array.ravel(), count).astype(np.float64))
    if rng.random() < 0.3 and count >= 3:  # a narrow peak
        centre = values[count // 2]
        values = np.sort(np.concatenate([values[:1], centre + span * np.array([-0.004, 0.0, 0.004]), values[-1:]]))
    opacities = rng.random(values.size) ** rng.choice([1, 4])
    kind = rng.integers(4)
    if kind == 0:
        opacities *= rng.integers(0, 2, values.size)
    elif kind == 1:
        opacities[rng.random(values.size) < 0.3] = 1.0
    keep = np.ones(values.size, bool)
    keep[2:] = values[2:] > values[:-2]  # two points at one value make a step; a third is too many
    unit = volume.grid.smallest_edge * 10.0 ** rng.uniform(-0.5, 1.5)
    return TransferFunction(values[keep], opacities[keep], rng.random((int(keep.sum()), 3)), unit)


def _camera(rng: np.random.Generator, volume: Volume) -> Camera:
    corners = volume.grid.world_corners()
    centre = corners.mean(axis=0)
    size = float(np.linalg.norm(np.ptp(corners, axis=0))) or 1.0
    direction = rng.normal(size=3)
    if rng.random() < 0.25:  # along an axis: samples fall on voxels
        direction = np.eye(3)[rng.integers(3)] * rng.choice([-1, 1]) + 1e-9
    direction /= np.linalg.norm(direction)
    keys: dict[str, Any] = {"target": tuple(centre), "up": tuple(rng.normal(size=3))}
    if rng.random() < 0.5:
        keys |= {"projection": "orthographic", "height": size * 1.1}
    keys["position"] = tuple(centre + direction * size * rng.uniform(1.2, 3.0))
    return Camera(**keys)


def errors(device, scene: RandomScene, steps: tuple[float, ...] = STEPS) -> tuple[float, ...]:
    """RMSE beside the exact integral at each of ``steps``, of all pixels but the worst: a ray that grazes a corner
    may see what lies behind it, or not, by rounding."""
    exact = render_reference(scene.at(1.0).resolve(), device)[0]
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClvolWarning)  # of some of them nothing shows
        for step in steps:
            with Renderer(scene.at(step), devices=[device]) as renderer:
                squares = np.mean((renderer.render().rgba - exact) ** 2, axis=-1).ravel()
                found.append(float(np.sqrt(np.mean(np.sort(squares)[:-1]))))
    return tuple(found)


def shrinks(found: tuple[float, ...]) -> bool:
    """Whether the error falls with the step, as with its square root at least (what rays do that enter something
    opaque at once), down to the floor."""
    if not all(np.isfinite(found)):
        return False
    return found[-1] <= FLOOR or found[-1] <= 0.5 * found[0] and found[-1] <= 1.2 * found[1]


def main(arguments: list[str]) -> int:
    from clvol.opencl.devices import open_device

    count = int(arguments[0]) if arguments else 100
    first = int(arguments[1]) if len(arguments) > 1 else 0
    device = open_device(arguments[2] if len(arguments) > 2 else None)
    bad = 0
    for seed in range(first, first + count):
        scene = random_scene(seed)
        found = errors(device, scene)
        if not shrinks(found):
            found += errors(device, scene, FINER)
        if not shrinks(found):
            bad += 1
            print(f"{scene}: " + " ".join(f"{e:.2e}" for e in found), flush=True)
    print(f"{bad} of {count} scenes have an error that does not shrink with the step")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
