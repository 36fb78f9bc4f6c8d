"""The host side of shadows: how much of each light arrives at the points of a light volume (cl/shadow.h), and what the
light of half-angle slices takes (cl/half_angle.h)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clvol.device.arguments import Arguments, scene_arguments
from clvol.errors import SceneError
from clvol.features.gradient_storage import DeviceLimits
from clvol.features.vocabulary import SHADOW_METHODS as METHODS
from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.scene.shadow import Shadow
from clvol.schedule.tiles import bands
from clvol.volume import Grid

CONE_DIRECTIONS = 13
OPAQUE_DEPTH = 1e15  # of cl/stretch.h
TRANSPARENT = 1e-3  # a march stops where a smaller share of the light is left
_SECONDS_A_SAMPLE, _BAND_SECONDS = 1e-8, 0.5
_WORK_GROUP = 64
_ARGUMENTS = (
    reads("cone", np.float32, 1 + CONE_DIRECTIONS, 4),
    value("light", np.int32),
    value("number", np.int32),
    value("first", np.int32),
    writes("arrives", np.float32, "lights", "points", "channels"),
    writes("samples", np.uint32, "items"),
)


def casting_lights(resolved: ResolvedScene) -> list[int]:
    """Indices of the lights that cast shadows, in the order of their light volumes. Headlights
    shine from the eye, which sees none of their shadows."""
    if resolved.shadow is None:
        return []
    lights = enumerate(resolved.lights)
    return [k for k, light in lights if light.casts_shadow and light.type != "headlight"]


def shadow_switches(resolved: ResolvedScene) -> dict[str, int]:
    """The switches (-D) of shadows."""
    shadow = resolved.shadow if casting_lights(resolved) else None
    return {
        "SHADOWS": 0 if shadow is None else METHODS[shadow_method(resolved)],
        "SCATTERING": int(shadow is not None and _scatters(shadow)),
    }


def by_slices(resolved: ResolvedScene) -> bool:
    """Whether the scene is rendered by half-angle slices."""
    return resolved.integration.draws_slices and resolved.slicing.is_half_angle


def shadow_method(resolved: ResolvedScene) -> str:
    """That of [shadow], or "half-angle" where slices are swept by the light."""
    return "half-angle" if by_slices(resolved) else _shadow_of(resolved).method


def slab_count(extent: float, spacing: float) -> int:
    """Half-angle slabs, ``spacing`` apart, in ``extent``; never so many that they cannot be counted."""
    return max(1, int(np.ceil(min(extent / spacing - 1e-6, 1e9))))


def shadow_step(resolved: ResolvedScene) -> float:
    """Step of the march towards the lights, in smallest voxel edges."""
    step = _shadow_of(resolved).step
    return resolved.integration.step if step is None else step


def light_size(grid: Grid, resolution: int) -> tuple[int, int, int]:
    """Points (x, y, z) of a light volume: ``resolution`` along the domain's longest axis, its ends included, and
    equally dense, but at least 2, along the others."""
    lower, upper = grid.index_bounds()
    edges = (upper - lower) * grid.spacing
    counts = np.maximum(np.round(edges / edges.max() * (resolution - 1)).astype(int) + 1, 2)
    x, y, z = (int(n) for n in counts)
    return x, y, z


def light_volume_bytes(resolved: ResolvedScene) -> int:
    """Bytes that the light volumes of all lights take on the device; 0 where there are none."""
    lights = casting_lights(resolved)
    if not lights or shadow_method(resolved) == "rays":
        return 0
    if by_slices(resolved):
        return _slice_bytes(resolved)
    return 4 * len(lights) * _floats(resolved)


def _slice_bytes(resolved: ResolvedScene) -> int:
    """Bytes that the light of half-angle slices takes at most, from whatever side the volume is seen."""
    grid, shadow = resolved.volume.grid, _shadow_of(resolved)
    lower, upper = grid.index_bounds()
    diagonal = float(np.linalg.norm((upper - lower) * grid.spacing)) / grid.smallest_edge
    slabs = resolved.slicing.slices or slab_count(diagonal, resolved.integration.step * np.sqrt(0.5))
    return 4 * (shadow.resolution**2 + 16) * (slabs + 2) * (4 if _scatters(shadow) else 1)


def check_fits(resolved: ResolvedScene, limits: DeviceLimits) -> None:
    """SceneError if the light volumes do not fit on the device."""
    needed, room = light_volume_bytes(resolved), min(limits.buffer, limits.memory)
    if needed > room:
        lights = len(casting_lights(resolved))
        resolution = _shadow_of(resolved).resolution
        taken = f"light volumes of {lights} lights take"
        if by_slices(resolved):
            taken = "the light of half-angle slices takes"
        what = f"got {resolution}: {taken} {needed} bytes"
        where = f"{resolved.origin}: shadow.resolution"
        raise SceneError(where, what, f"at most {room} bytes, the limit of the device")


def shadow_numbers(resolved: ResolvedScene, padded: tuple[int, int, int]) -> dict[str, Any]:
    """The members of ``Effects`` that shadows need. ``padded``: lattice points of the volume."""
    shadow = _shadow_of(resolved)
    less = 1.0 - np.asarray(shadow.scatter_color, float)
    attenuated = less[less > 0] if _scatters(shadow) else np.ones(1)
    slowest = attenuated.min() if attenuated.size else 1.0
    numbers: dict[str, Any] = {
        "shadow_bound": shadow.bound,
        "shadow_step": shadow_step(resolved),
        # Noise may leave nothing that attenuates.
        "shadow_depth": OPAQUE_DEPTH if resolved.attenuation_noise else -np.log(TRANSPARENT) / slowest,
        "scattering": shadow.scattering,
    }
    if shadow_method(resolved) == "volume":
        size = light_size(resolved.volume.grid, shadow.resolution)
        scale = (np.asarray(size) - 1.0) / (np.asarray(padded) - 1.0)
        numbers["light_grid"] = (*scale, 0.0)
        numbers["light_size"] = (*size, 0)
    return numbers


def cone_directions(degrees: float, count: int = CONE_DIRECTIONS) -> np.ndarray:
    """Unit vectors [count, 3] about +z, spread evenly over the solid angle of a cone of this half angle, on a
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
    variant: Arguments,
    arrays: Mapping[str, DeviceArray],
) -> tuple[DeviceArray, int]:
    """The light volumes of all lights that cast shadows, float32 [lights, z, y, x, channels], and
    how many samples of the volume that took.

    ``switches``: the picture's. ``variant``: the declared arguments that follow the scene's. ``arrays``: those of the
    scene and of the variant, by name.
    """
    lights, shadow = casting_lights(resolved), _shadow_of(resolved)
    size = light_size(resolved.volume.grid, shadow.resolution)
    points, lanes = int(np.prod(size)), switches["LANES"]
    items = -(-points // lanes)
    group = 1 if lanes > 1 else _WORK_GROUP
    channels = _floats(resolved) // points
    arrives = context.empty(np.float32, (len(lights), *size[::-1], channels))
    counts = context.upload(np.zeros(items, np.uint32), writable=True)
    cone = np.zeros((1 + CONE_DIRECTIONS, 4), np.float32)
    cone[0] = (*(1.0 - np.asarray(shadow.scatter_color)), CONE_DIRECTIONS)
    cone[1:, :3] = cone_directions(shadow.cone_degrees)
    declared = scene_arguments(switches["VOXEL_BITS"]) + variant + _ARGUMENTS
    kernel = context.kernel("light_volume.cl", "light_volume", declared, switches)
    given = {**arrays, "view": context.upload(view), "cone": context.upload(cone)}
    sizes = {"lights": len(lights), "points": points, "channels": channels, "items": items}
    rays = 1 + CONE_DIRECTIONS * switches["SCATTERING"]
    expected = points * rays * sum(resolved.volume.grid.size) / shadow_step(resolved)
    taken = 0
    for number, light in enumerate(lights):
        for first, count in bands(items, expected * _SECONDS_A_SAMPLE, _BAND_SECONDS):
            kernel(
                context.queue,
                (-(-count // group) * group,),
                (group,),
                sizes=sizes,
                light=light,
                number=number,
                first=first * lanes,
                arrives=arrives,
                samples=counts,
                **given,
            )
            context.finish()
        taken += int(context.read(counts).sum(dtype=np.uint64))
    return arrives, taken


def _shadow_of(resolved: ResolvedScene) -> Shadow:
    """The [shadow] table of a scene with shadows."""
    if resolved.shadow is None:
        raise ValueError("the scene has no [shadow] table")
    return resolved.shadow


def _scatters(shadow: Shadow) -> bool:
    return shadow.is_volume and shadow.scattering > 0


def _floats(resolved: ResolvedScene) -> int:
    """Number of floats in one light volume."""
    shadow = _shadow_of(resolved)
    size = light_size(resolved.volume.grid, shadow.resolution)
    return int(np.prod(size, dtype=np.int64)) * (4 if _scatters(shadow) else 1)
