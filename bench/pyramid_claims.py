"""What Kraus et al. (2007) claim without figures, and lit scenes; parts of the suite "pyramid".

The third power: adaptive sampling in three dimensions is said to gain the third power of what it
gains along rays. So the samples of a picture are counted with levels along rays alone, across them
alone, and both, at the same map of distances.

Synthesis: data synthesised by B-splines are said to avoid bilinear artefacts, and the blur of
synthesised colours. So pictures whose rays are sampled on a coarse grid of pixels alone are made in
numpy in four ways, beside one in which all are.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.effect_scenes import LIGHT
from bench.effects import ratio_of
from bench.multiresolution_parts import Bench
from bench.multiresolution_scenes import BlockScene
from bench.pyramid_parts import caster, picture, turns
from bench.pyramid_scenes import by_pyramid, by_rays, ray_spacing
from bench.report import say
from clvol.accuracy.metrics import rmse
from clvol.integrators.pyramid.march import SliceMarch

WAYS = ("along", "across", "both")
RMSE_GOAL = 2e-3  # of a lit picture
# (step, epsilon, levels), each of which was the fastest within the goal at some state of the kernels
LIT_SETTINGS = ((1.0, 0.02, 4), (1.25, 0.025, 4), (1.25, 0.015, 4), (1.5, 0.012, 5), (1.0, 0.01, 3))
LIT_STEPS, FINE_LIT_STEP = (1.0, 2.0, 2.2, 2.5), 0.125


class LimitedMarch(SliceMarch):
    """``march`` with its levels ``along`` rays or ``across`` them alone."""

    def __init__(self, march: SliceMarch, way: str) -> None:
        self.__dict__.update(vars(march))
        self.way = way

    def begin(self, caster: Any, camera: Any, width: int, height: int) -> None:
        super().begin(caster, camera, width, height)
        levels = self.plan.levels
        if self.way == "along":
            self.plan = replace(self.plan, oversampling=-levels)
        if self.way == "across":
            self.plan = replace(self.plan, levels=0, oversampling=levels)


def power(bench: Bench, scene: BlockScene, epsilon: float) -> dict[str, Any]:
    """Samples of data by the oracle "error" with ``epsilon``, slices as far apart as rays: how many times
    ``fewer`` than without levels."""
    voxels = bench.volume(scene)
    step = {"step": ray_spacing(by_rays(scene, voxels, bench.size))}
    least = caster(bench, by_pyramid(scene, voxels, bench.size, step, oracle="minimum"))
    full = picture(least)
    made = caster(bench, by_pyramid(scene, voxels, bench.size, step, epsilon=epsilon), least.volume)
    counts, errors = {}, {}
    for way in WAYS:
        limited = copy.copy(made)
        limited.march = LimitedMarch(made.march, way)
        frame = picture(limited)
        counts[way], errors[way] = frame.samples, rmse(frame.rgba, full.rgba)
    fewer = {way: full.samples / max(counts[way], 1) for way in WAYS}
    exponent = math.log(fewer["both"]) / math.log(fewer["along"]) if fewer["along"] > 1.0 else math.nan
    say(f"{scene.name}, epsilon {epsilon:g}: " + ", ".join(f"{way} {fewer[way]:.2f}" for way in WAYS)
        + f" times fewer samples, exponent {exponent:.2f}")
    return {"scene": scene.name, "epsilon": epsilon, **step, "samples": {"minimum": full.samples, **counts},
            "fewer": fewer, "exponent": exponent, "rmse": errors}  # fmt: skip


def light(bench: Bench, scene: BlockScene) -> dict[str, Any]:
    """A lit scene by both methods: seconds and error beside short steps of the ray caster, and how many times as fast
    the fastest of the pyramid within the goal is as that of the ray caster."""
    voxels = bench.volume(scene)

    def asked(method: str, step: float, **pyramid: Any) -> Any:
        table = {"classification": "preintegrated", "method": method, "step": step}
        tables = {"integration": table, "light": [LIGHT], **({"pyramid": pyramid} if pyramid else {})}
        return scene.plain(voxels, bench.size, tables).resolve()

    rays = caster(bench, asked("raycast", 1.0))
    fine = asked("raycast", FINE_LIT_STEP)
    fine = replace(fine, integration=fine.integration.model_copy(update={"early_termination": 0.0}))
    exact = picture(rays.for_scene(fine)).rgba
    casters = {("raycast", step): rays.for_scene(asked("raycast", step)) for step in LIT_STEPS}
    for step, epsilon, levels in LIT_SETTINGS:
        adaptive = asked("pyramid", step, epsilon=epsilon, levels=levels)
        casters["pyramid", step, epsilon, levels] = caster(bench, adaptive, rays.volume)
    frames = {key: picture(made) for key, made in casters.items()}
    times = bench.times(turns(casters))
    rows = [
        {"method": key[0], "settings": key[1:], "time": times[key], "rmse": rmse(frame.rgba, exact),
         "samples": frame.samples, "gradients": frame.counters["gradients"], "key": key}
        for key, frame in frames.items()
    ]  # fmt: skip
    best = {
        method: min(
            (row for row in rows if row["method"] == method and row["rmse"] <= RMSE_GOAL),
            key=lambda row: row["time"]["median"], default=None,
        )
        for method in ("raycast", "pyramid")
    }  # fmt: skip
    faster = None
    if best["raycast"] and best["pyramid"]:
        faster = ratio_of(times[best["raycast"]["key"]], times[best["pyramid"]["key"]])
        say(f"{scene.name}, lit, RMSE {RMSE_GOAL:g}: {faster['ratio']:.2f} times as fast as the ray caster")
    return {"scene": scene.name, "rows": [{k: v for k, v in row.items() if k != "key"} for row in rows],
            "faster": faster}  # fmt: skip


# How pixels are synthesised: numpy, parallel rays along z

MOST_KINKS = 99.0
LEVEL_NAMES = ("data, B-splines", "data, bilinear", "colours, B-splines", "colours, bilinear")


def synthesis(bench: Bench, scene: BlockScene, levels: Sequence[int], edge: int = 128) -> list[dict[str, Any]]:
    """Pictures of ``edge`` by ``edge`` rays along z through every slice of voxels, of which only each 2^level-th along
    both axes is sampled, beside all of them: error, sharpness and kinks. A step a voxel, in float64."""
    volume = bench.volume(scene)
    function = scene.plain(volume, 16).resolve().transfer_function
    side = min(edge, *volume.grid.size[:2])
    side -= side % (1 << max(levels))
    every = _picture(volume.data, function, side, 0, LEVEL_NAMES[0])
    rows = []
    for level in levels:
        made = {name: _picture(volume.data, function, side, level, name) for name in LEVEL_NAMES}
        found = {
            name: {
                "rmse": rmse(shown, every), "sharpness": _slopes(shown) / _slopes(every),
                "kinks": _kinks(shown, level),
            }
            for name, shown in made.items()
        }  # fmt: skip
        rows.append({"scene": scene.name, "level": level, "ways": found})
        say(f"{scene.name}, level {level}: " + ", ".join(f"{name} {way['rmse']:.2e}" for name, way in found.items()))
    return rows


def _slopes(rgba: np.ndarray) -> float:
    """The mean difference of neighbouring pixels: less where a picture is blurred."""
    return float(np.abs(np.diff(rgba, axis=1)).mean() + np.abs(np.diff(rgba, axis=0)).mean())


def _kinks(rgba: np.ndarray, level: int) -> float:
    """Second differences along rows where bilinear pieces meet, over those elsewhere, MOST_KINKS at most: 1 where
    nothing shows the grid."""
    bends = np.abs(np.diff(rgba, 2, axis=1)).mean(axis=(0, 2))
    size = 1 << level
    place = (np.arange(len(bends)) + 1) % size
    meets = (place == size // 2 - 1) | (place == size // 2)
    if meets.all():
        return 1.0
    return float(min(bends[meets].mean() / max(bends[~meets].mean(), 1e-30), MOST_KINKS))


def _picture(data: np.ndarray, function: Any, side: int, level: int, way: str) -> np.ndarray:
    """float64 [side, side, 4], premultiplied: slices of voxels in the middle of ``data``, front to back."""
    top, left = ((n - side) // 2 for n in data.shape[1:])
    colors = way.startswith("colours")
    grow = _subdivided if way.endswith("B-splines") else _bilinear
    rgba = np.zeros((side, side, 4))
    if colors:  # each sampled ray by itself
        rgba = np.zeros((*_coarse(np.zeros((side, side)), level).shape, 4))
    for layer in data:
        samples = _coarse(layer[top : top + side, left : left + side].astype(np.float64), level)
        values = samples if colors or level == 0 else grow(samples, level)
        opacity = function.opacity(values.ravel()).reshape(values.shape)
        weight = (1.0 - rgba[..., 3]) * opacity
        rgba[..., :3] += weight[..., None] * function.color(values.ravel()).reshape(*values.shape, 3)
        rgba[..., 3] += weight
    if colors and level:
        rgba = np.stack([grow(rgba[..., c], level) for c in range(4)], axis=-1)
    return rgba


def _coarse(values: np.ndarray, level: int) -> np.ndarray:
    """The samples of a level, one more all around: linear in the middle of 2^level pixels."""
    if level == 0:
        return values
    n, size = values.shape[0], 1 << level
    at = np.clip((np.arange(-1, n // size + 1) + 0.5) * size - 0.5, 0, n - 1)
    low = np.minimum(at.astype(int), n - 2)
    share = at - low
    rows = values[low] + share[:, None] * (values[low + 1] - values[low])
    return rows[:, low] + share * (rows[:, low + 1] - rows[:, low])


def _subdivided(values: np.ndarray, level: int) -> np.ndarray:
    """``level`` times by the weights 9/16, 3/16, 3/16, 1/16 (Kraus et al. 2007, figs. 5 to 7); each time one pixel is
    left all around, which goes at last."""
    for _ in range(level):
        for axis in (0, 1):
            a = np.moveaxis(values, axis, 0)
            fine = np.empty((2 * a.shape[0] - 2, *a.shape[1:]))
            fine[0::2], fine[1::2] = 0.75 * a[:-1] + 0.25 * a[1:], 0.25 * a[:-1] + 0.75 * a[1:]
            values = np.moveaxis(fine, 0, axis)
    return values[1:-1, 1:-1]


def _bilinear(values: np.ndarray, level: int) -> np.ndarray:
    """From the four samples around, whatever the level."""
    n, size = values.shape[0] - 2, 1 << level
    at = (np.arange(n * size) + 0.5) / size - 0.5 + 1.0
    low = at.astype(int)
    share = at - low
    rows = values[low] + share[:, None] * (values[low + 1] - values[low])
    return rows[:, low] + share * (rows[:, low + 1] - rows[:, low])
