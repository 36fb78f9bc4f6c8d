"""The host side of ambient occlusion (cl/ambient_occlusion.h): how much of the light from all around arrives at the
points of a grid, and on average from where."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from clvol.device.arguments import Arguments, scene_arguments
from clvol.device.light_volume import TRANSPARENT, light_size
from clvol.errors import SceneError
from clvol.features.gradient_storage import DeviceLimits
from clvol.features.vocabulary import DARKENS
from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.ambient_occlusion import AmbientOcclusion
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.tiles import bands

_FLOATS = 4  # a point: the light's mean, and where it comes from
_LEAST = 1e-6  # clear points around one that count
_STEEPNESS = 4  # of the weight of points that are half in the open: their own light is that of the inside
_SECONDS_A_SAMPLE, _BAND_SECONDS = 1e-8, 0.5
_WORK_GROUP = 64
_ARGUMENTS = (
    reads("ways", np.float32, "directions", 4),
    value("directions", np.int32),
    value("reach", np.float32),
    value("near", np.float32),
    value("first", np.int32),
    writes("seen", np.float32, "points", _FLOATS),
    writes("clear", np.float32, "points"),
    writes("samples", np.uint32, "items"),
)


def occlusion_bytes(resolved: ResolvedScene) -> int:
    """Bytes that the grid of the ambient occlusion takes on the device; 0 without one."""
    if resolved.ambient_occlusion is None:
        return 0
    size = light_size(resolved.volume.grid, resolved.ambient_occlusion.resolution)
    return 4 * _FLOATS * int(np.prod(size, dtype=np.int64))


def occlusion_switch(resolved: ResolvedScene) -> dict[str, int]:
    """The switch of ambient occlusion; none for a scene without."""
    table = resolved.ambient_occlusion
    return {} if table is None else {"AMBIENT_OCCLUSION": DARKENS[table.darkens]}


def check_occlusion_fits(resolved: ResolvedScene, limits: DeviceLimits) -> None:
    """SceneError if the grid of the ambient occlusion does not fit on the device."""
    needed, room = occlusion_bytes(resolved), min(limits.buffer, limits.memory)
    if needed > room:
        got = f"got {_table(resolved).resolution}, which takes {needed} bytes"
        where = f"{resolved.origin}: ambient_occlusion.resolution"
        raise SceneError(where, got, f"at most {room} bytes, the limit of the device")


def occlusion_numbers(resolved: ResolvedScene, padded: tuple[int, int, int]) -> dict[str, Any]:
    """The members of ``Effects`` that ambient occlusion needs. ``padded``: lattice points of the volume."""
    table = _table(resolved)
    size = light_size(resolved.volume.grid, table.resolution)
    scale = (np.asarray(size) - 1.0) / (np.asarray(padded) - 1.0)
    return {"occlusion_grid": (*scale, table.intensity), "occlusion_size": (*size, 0)}


def sphere_directions(count: int) -> np.ndarray:
    """Unit vectors float64 [count, 3], evenly over the sphere: a spiral of equal areas over a half of it, each
    followed by its opposite, so that their sum is 0, in single precision too. ``count`` is even."""
    half = count // 2
    k = np.arange(half)
    z = (k + 0.5) / half
    around, angle = np.sqrt(1.0 - z**2), k * np.pi * (3.0 - np.sqrt(5.0))
    upper = np.stack([around * np.cos(angle), around * np.sin(angle), z], axis=1)
    return np.stack([upper, -upper], axis=1).reshape(-1, 3)


def near_length(resolved: ResolvedScene) -> float:
    """World length within which what surrounds a point of the grid says whether the point is in the open: half the
    diagonal of the grid's cells."""
    grid = resolved.volume.grid
    lower, upper = grid.index_bounds()
    size = np.asarray(light_size(grid, _table(resolved).resolution))
    return 0.5 * float(np.linalg.norm((upper - lower) * np.asarray(grid.spacing) / (size - 1.0)))


def filled(seen: np.ndarray, clear: np.ndarray) -> np.ndarray:
    """``seen`` float32 [z, y, x, 4], in which points inside of matter take what the open points around them have.

    Between a point inside and one outside, light would be half of that outside, and boundaries would show the cells of
    the grid. ``clear`` [z, y, x], 0 to 1: the share of directions in which a point's own neighbourhood is transparent;
    half of them are at a plane boundary, which is open.
    """
    weight = (np.minimum(2.0 * clear, 1.0) ** _STEEPNESS)[..., None]
    sums = np.concatenate([seen * weight, weight], axis=-1)
    for axis in range(3):
        padded = np.pad(sums, [(1, 1) if k == axis else (0, 0) for k in range(4)])
        n = sums.shape[axis]
        before, own, after = (np.take(padded, np.arange(k, k + n), axis=axis) for k in range(3))
        sums = before + own + after
    total = sums[..., 4:]
    around = np.where(total > _LEAST, sums[..., :4] / np.maximum(total, _LEAST), seen)
    return (weight * seen + (1.0 - weight) * around).astype(np.float32)


def fill_occlusion_volume(
    context: DeviceContext,
    resolved: ResolvedScene,
    switches: Mapping[str, int],
    view: np.ndarray,
    numbers: np.ndarray,
    variant: Arguments,
    arrays: Mapping[str, DeviceArray],
) -> tuple[DeviceArray, int]:
    """The grid of the ambient occlusion, float32 [z, y, x, 4], and how many samples of the volume it took.

    ``switches``: the picture's. ``numbers``: its ``Effects``. ``variant``: the declared arguments that follow the
    scene's. ``arrays``: those of the scene and of the variant, by name.
    """
    table, grid = _table(resolved), resolved.volume.grid
    size = light_size(grid, table.resolution)
    points, lanes = int(np.prod(size)), switches["LANES"]
    items = -(-points // lanes)
    group = 1 if lanes > 1 else _WORK_GROUP
    own = numbers.copy()
    own["shadow_step"], own["shadow_depth"] = table.step, -np.log(TRANSPARENT)
    ways = np.zeros((table.directions, 4), np.float32)
    ways[:, :3] = sphere_directions(table.directions)
    seen = context.empty(np.float32, (points, _FLOATS))
    clear = context.empty(np.float32, (points,))
    counts = context.upload(np.zeros(items, np.uint32), writable=True)
    declared = scene_arguments(switches["VOXEL_BITS"]) + variant + _ARGUMENTS
    kernel = context.kernel("occlusion_volume.cl", "occlusion_volume", declared, switches)
    given = {**arrays, "view": context.upload(view), "effects": context.upload(own), "ways": context.upload(ways)}
    edge = grid.smallest_edge
    reach = _distance(table) / edge
    expected = points * table.directions * min(reach, sum(grid.size)) / table.step
    for first, count in bands(items, expected * _SECONDS_A_SAMPLE, _BAND_SECONDS):
        kernel(
            context.queue,
            (-(-count // group) * group,),
            (group,),
            sizes={"directions": table.directions, "points": points, "items": items},
            directions=table.directions,
            reach=min(reach, 1e12),
            near=near_length(resolved) / edge,
            first=first * lanes,
            seen=seen,
            clear=clear,
            samples=counts,
            **given,
        )
        context.finish()
    shape = size[::-1]
    found = filled(context.read(seen).reshape(*shape, _FLOATS), context.read(clear).reshape(shape))
    return context.upload(found), int(context.read(counts).sum(dtype=np.uint64))


def _table(resolved: ResolvedScene) -> AmbientOcclusion:
    if resolved.ambient_occlusion is None:
        raise ValueError("the scene has no [ambient_occlusion] table")
    return resolved.ambient_occlusion


def _distance(table: AmbientOcclusion) -> float:
    if table.distance is None:
        raise ValueError("an [ambient_occlusion] table that is not complete")
    return table.distance
