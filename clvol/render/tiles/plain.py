"""The plain ray caster's rays, a list of pixels at a time (cl/tile_rays.cl)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clvol.opencl.context import DeviceArray
from clvol.render.effects import ARGUMENTS as EFFECT_ARGUMENTS
from clvol.render.effects import COUNTERS
from clvol.render.raycast import (
    BAND_SECONDS,
    SCENE_ARGUMENTS,
    SECONDS_A_SAMPLE,
    Raycaster,
)
from clvol.render.tiles.geometry import TileGrid
from clvol.render.tiles.launch import launch_ray_lists
from clvol.render.tiles.work import RayWork
from clvol.render.view import ray_frame
from clvol.scene.camera import Camera
