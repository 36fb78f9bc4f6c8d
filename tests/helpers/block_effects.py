"""Scenes of blocks with effects, what the kernels make of them and what numpy's twin does."""

from __future__ import annotations

import numpy as np
from reference.block_medium import BlockMediumField
from reference.march import render_twin

from clvol import Camera, Scene, Volume
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.registry import check_scene
from helpers.block_scenes import SHOWN, noise, picture_of, resident, twin_of
from helpers.effect_scenes import LIGHTS, MATERIAL
from helpers.small_scenes import waves

SHAPE = (40, 33, 50)
CAMERA = Camera(position=(-55.0, -38.0, -61.0), target=(25.0, 16.0, 20.0), fov_degrees=28.0)
CLIPS = [
    {"type": "plane", "point": [10.0, 14.0, 18.0], "normal": [0.4, 0.5, 1.0]},
    {"type": "sphere", "center": [38.0, 18.0, 22.0], "radius": 9.0, "keep": "outside"},
    {"type": "box", "lower": [-5.0, -5.0, -5.0], "upper": [46.3, 30.1, 37.7]},
]
LIT = {"light": list(LIGHTS), "material": MATERIAL, "gradient": {"storage": "on-the-fly"}}
CUE = {"depth_cue": {"start": 60.0, "end": 130.0, "strength": 0.7, "color": [0.1, 0.3, 0.5]}}
SPOTS = [{"type": "spot", "position": [10.0, -60.0, -40.0], "direction": [0.2, 1.0, 0.8], "cone_degrees": 20.0 + k,
          "penumbra": 0.7, "intensity": 1.0 + k} for k in range(2)]  # fmt: skip
ALL = {"clip": CLIPS, **LIT, **CUE}
SURFACES = {
    "isosurface": [
        {"value": 150.0, "opacity": 0.6, "color": [0.8, 0.3, 0.2]},
        {"value": 90.0, "opacity": 0.3, "color": [0.2, 0.5, 0.9]},
    ],
    **ALL,
}


def scene(volume=None, classification="post", method="multiresolution", width=24, height=20, **tables):
    integration = {"method": method, "early_termination": 0.0, "classification": classification, "step": 0.83}
    given = {"camera": CAMERA, "transfer_function": SHOWN, **tables}
    integration |= given.pop("integration", {})
    return Scene(
        volume=noise(SHAPE) if volume is None else volume, integration=integration,
        image={"width": width, "height": height}, **given,
    ).resolve()  # fmt: skip


def rendered(context, resolved, levels, edge=16, largest_buffer=None, **how):
    check_scene(resolved)
    blocks = resident(context, resolved.volume, levels, edge, largest_buffer)
    return picture_of(BlockCaster(context, resolved, blocks, **how))


def twin(resolved, levels, edge=16):
    field = BlockMediumField(twin_of(resolved.volume, levels, edge), resolved.volume.grid)
    return render_twin(resolved, field=field)


def smooth() -> Volume:
    return Volume(waves(SHAPE, np.uint8))
