"""Scenes with shadows, and what of their lights arrives at places in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clvol import TransferFunction
from clvol.device.arguments import EFFECT_ARGUMENTS, counts_argument, scene_arguments
from clvol.device.effect_state import COUNTERS
from clvol.integrators.raycast.caster import Raycaster
from clvol.opencl.arguments import reads, value, writes
from helpers.twin_scenes import ramp, scene

_SOURCE = str(Path(__file__).with_name("light_at.cl"))
SIDE = 15.0  # of the block
BLOCK = ramp(axis=0).astype(np.float32)  # of one opacity, but with a gradient: it can be lit
DIFFUSE = {"ambient": 0.0, "diffuse": 1.0, "specular": 0.0}
RAYS = {"method": "rays", "bound": 0.0}
SLANTED = {"type": "directional", "direction": [-0.6, -0.8, 0.0]}
DOWN = {"type": "directional", "direction": [0.0, -1.0, 0.0]}

BALL = TransferFunction([0, 4, 6, 30], [0.4, 0.2, 0, 0], [[1.0, 0.5, 0.2]] * 4)


def shadowed(array, function=None, light=SLANTED, shadow=RAYS, **tables):
    lights = light if isinstance(light, list) else [light]
    return scene(array, function, light=lights, shadow=shadow, **tables)


def arriving(caster: Raycaster, places, weight=1.0, light=0):
    """float [n, 3]: the share of ``light`` at index places [n, 3]; and the counters."""
    context, lanes = caster.context, caster.switches["LANES"]
    places = np.asarray(places, np.float32)
    n = -(-len(places) // lanes) * lanes
    given = np.zeros((4, n), np.float32)
    given[:3, : len(places)] = places.T
    given[3, : len(places)] = weight
    shares, counts = context.empty(np.float32, (3, n)), context.empty(np.uint32, (n // lanes, 8))
    view = caster.volume_view()
    kernel = context.kernel(
        _SOURCE, "light_at",
        scene_arguments(caster.switches["VOXEL_BITS"]) + EFFECT_ARGUMENTS + counts_argument(len(COUNTERS))
        + (reads("places", np.float32, 4, "n"), value("n", np.int32), value("light", np.int32),
           writes("shares", np.float32, 3, "n")),
        {**caster.switches, "WITH_DEPTH": 0},
    )  # fmt: skip
    kernel(
        context.queue, (n // lanes,), (1,), sizes={"tiles": n // lanes}, view=context.upload(view), counts=counts,
        places=context.upload(given), n=n, light=light, shares=shares,
        **caster._scene_arrays(), **caster.effects.arrays,
    )  # fmt: skip
    found = context.read(shares)[:, : len(places)].T.astype(np.float64)
    return found, dict(zip(COUNTERS, context.read(counts).sum(axis=0)))


def share(context, resolved, places, light=0, **how):
    """[n]: the first channel of ``arriving`` in a scene."""
    return arriving(Raycaster(context, resolved, **how), places, light=light)[0][:, 0]


def inside(n, low=0.0, high=SIDE, seed=3):
    return np.random.default_rng(seed).uniform(low, high, (n, 3))


def ball(n=24, centre=(11.0, 12.0, 9.0)) -> np.ndarray:
    """The distance from ``centre`` (x, y, z)."""
    z, y, x = np.mgrid[:n, :n, :n]
    return np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2).astype(
        np.float32
    )
