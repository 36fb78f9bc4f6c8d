"""Shadows' host side: what of a light arrives at the points of a light volume (cl/shadow.h)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clvol.errors import SceneError
from clvol.features.gradient_storage import DeviceLimits
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.scene.shadow import Shadow
from clvol.schedule.tiles import bands
from clvol.volume import Grid

METHODS = {"rays": 1, "volume": 2}  # SHADOWS of cl/shadow.h
CONE_DIRECTIONS = 13
TRANSPARENT = 1e-3  # a march stops where less than that arrives
_SECONDS_A_SAMPLE, _BAND_SECONDS = 1e-8, 0.5
_WORK_GROUP = 64
_ARGUMENTS = (
    "in volume V1, in table float32, in warp float32, in distances uint8, in view V1, "
    "in effects V1, in items float32, in gradients uint32, in surface_distances uint8, in noise uint32, "
    "in factors float32, in fields float32, in cone float32, "
    "value light int32, value index int32, value first int32, out arrives float32, "
    "out samples uint32"
)


def casting_lights(resolved: ResolvedScene) -> list[int]:
    """Numbers of the lights that cast shadows, in the order of their light volumes. Headlights
    shine from the eye and cast none that it could see."""
    if resolved.shadow is None:
        return []
    lights = enumerate(resolved.lights)
    return [k for k, light in lights if light.casts_shadow and light.type != "headlight"]


def shadow_switches(resolved: ResolvedScene) -> dict[str, int]:
    shadow = resolved.shadow if casting_lights(resolved) else None
    return {
        "SHADOWS": 0 if shadow is None else METHODS[shadow.method],
        "SCATTERING": int(shadow is not None and _scatters(shadow)),
    }


def shadow_step(resolved: ResolvedScene) -> float:
    """Steps of the march to the lights, in smallest voxel edges."""
    step = resolved.shadow.step
    return resolved.integration.step if step is None else step


def light_size(grid: Grid, resolution: int) -> tuple[int, int, int]:
    """Points (x, y, z) of a light volume: ``resolution`` along the domain's longest axis, at its
    ends too, and as dense, at least 2, along the others."""
    lower, upper = grid.index_bounds()
    edges = (upper - lower) * grid.spacing
    counts = np.maximum(np.round(edges / edges.max() * (resolution - 1)).astype(int) + 1, 2)
    return tuple(int(n) for n in counts)


def light_volume_bytes(resolved: ResolvedScene) -> int:
    """Bytes that the light volumes of all lights take on the device; 0 where there are none."""
    lights = casting_lights(resolved)
    if not lights or not resolved.shadow.is_volume:
        return 0
    return 4 * len(lights) * _floats(resolved)


def check_fits(resolved: ResolvedScene, limits: DeviceLimits) -> None:
    """SceneError if the light volumes do not fit on the device."""
    needed, room = light_volume_bytes(resolved), min(limits.buffer, limits.memory)
    if needed > room:
        lights = len(casting_lights(resolved))
        resolution = resolved.shadow.resolution
        what = f"got {resolution}: light volumes of {lights} lights take {needed} bytes"
        where = f"{resolved.origin}: shadow.resolution"
        raise SceneError(where, what, f"at most {room} bytes, all that the device gives")


def shadow_numbers(resolved: ResolvedScene, padded: tuple[int, int, int]) -> dict[str, tuple]:
    """The fields of ``Effects`` that shadows need. ``padded``: lattice points of the volume."""
    shadow = resolved.shadow
    less = 1.0 - np.asarray(shadow.scatter_color, float)
    attenuated = less[less > 0] if _scatters(shadow) else np.ones(1)
    slowest = attenuated.min() if attenuated.size else 1.0
    numbers = {
        "shadow": (
            shadow.bound, shadow_step(resolved), shadow.scattering, -np.log(TRANSPARENT) / slowest
        )
    }  # fmt: skip
    if shadow.is_volume:
        size = light_size(resolved.volume.grid, shadow.resolution)
        scale = (np.asarray(size) - 1.0) / (np.asarray(padded) - 1.0)
        numbers["light_grid"] = (*scale, 0.0)
        numbers["light_size"] = (*size, len(casting_lights(resolved)))
    return numbers


def cone_directions(degrees: float, count: int = CONE_DIRECTIONS) -> np.ndarray:
    """Unit vectors [count, 3] about +z, evenly over the solid angle of a cone of this half angle: a
    spiral of equal areas."""
    k = np.arange(count)
    cosine = 1.0 - (k + 0.5) / count * (1.0 - np.cos(np.radians(degrees)))
    sine, angle = np.sqrt(1.0 - cosine**2), k * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], axis=1)


def fill_light_volume(
    context: DeviceContext,
    resolved: ResolvedScene,
    switches: Mapping[str, int],
    view: np.ndarray,
    arrays: Mapping[str, DeviceArray],
) -> tuple[DeviceArray, int]:
    """The light volumes of all lights that cast shadows, float32 [lights, z, y, x, channels], and
    how many reconstructions of the volume that took.

    ``switches``: the picture's. ``arrays``: those of the scene that the kernel takes by name.
    """
    lights = casting_lights(resolved)
    size = light_size(resolved.volume.grid, resolved.shadow.resolution)
    points, lanes = int(np.prod(size)), switches["LANES"]
    items = -(-points // lanes)
    group = 1 if lanes > 1 else _WORK_GROUP
    channels = _floats(resolved) // points
    arrives = context.empty(np.float32, (len(lights), *size[::-1], channels))
    counts = context.upload(np.zeros(items, np.uint32), writable=True)
    cone = np.zeros((1 + CONE_DIRECTIONS, 4), np.float32)
    cone[0] = (*(1.0 - np.asarray(resolved.shadow.scatter_color)), CONE_DIRECTIONS)
    cone[1:, :3] = cone_directions(resolved.shadow.cone_degrees)
    declared = {name.split()[1] for name in _ARGUMENTS.split(", ")}
    given = {name: array for name, array in arrays.items() if name in declared}
    kernel = context.kernel("light_volume.cl", "light_volume", _ARGUMENTS, switches)
    given |= {"view": context.upload(view), "cone": context.upload(cone)}
    rays = 1 + CONE_DIRECTIONS * switches["SCATTERING"]
    expected = points * rays * sum(resolved.volume.grid.size) / shadow_step(resolved)
    taken = 0
    for index, light in enumerate(lights):
        for first, count in bands(items, expected * _SECONDS_A_SAMPLE, _BAND_SECONDS):
            kernel(
                context.queue,
                (-(-count // group) * group,),
                (group,),
                light=light,
                index=index,
                first=first * lanes,
                arrives=arrives,
                samples=counts,
                **given,
            )
            context.finish()
        taken += int(context.read(counts).sum(dtype=np.uint64))
    return arrives, taken


def _scatters(shadow: Shadow) -> bool:
    return shadow.is_volume and shadow.scattering > 0


def _floats(resolved: ResolvedScene) -> int:
    """Of one light volume."""
    size = light_size(resolved.volume.grid, resolved.shadow.resolution)
    return int(np.prod(size, dtype=np.int64)) * (4 if _scatters(resolved.shadow) else 1)
