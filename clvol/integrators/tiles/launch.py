"""Casts the rays of a list of pixels with any packet renderer (cl/tile_rays.cl)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from clvol.device.arguments import Arguments, counts_argument
from clvol.integrators.tiles.work import RayWork
from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.schedule.tiles import bands

_BAND_SECONDS = 0.5
_PACKETS_AN_ITEM = 4  # packets of 16 rays: few enough to occupy all cores, since starting work-items costs nothing
_LIST_ARGUMENTS = (
    reads("rays", np.int32, "count"),
    value("count", np.int32),
    value("rays_an_item", np.int32),
    writes("image", np.float32, "width", "height", 4),
    writes("depths", np.float32),
    writes("changes", np.float32, "count"),
    writes("samples", np.uint32, "tiles"),
)


@dataclass(frozen=True, eq=False)
class PacketRenderer:
    """The kernel ``tile_rays`` of ``file``.

    ``arguments``: those of the scene (SCENE_PARAMETERS of cl/scene.h); ``arrays`` holds all of them except the view.
    ``seconds_a_ray``: a guess, used to divide the work into launches. ``counters``: how many numbers each work-item
    counts; 0: none.
    """

    file: str
    switches: Mapping[str, int]
    arguments: Arguments
    arrays: Mapping[str, DeviceArray]
    lanes: int = 1
    seconds_a_ray: float = 1e-6
    counters: int = 0


@dataclass(frozen=True, eq=False)
class CastRays:
    """``changes`` float32 [rays]: mean square over the channels of what each ray changed in the
    picture. ``samples``: samples of the volume. ``counts`` uint32 [work-items, COUNTERS]:
    the counts of effects, None without counters. ``samples_by_item`` uint32 [work-items], of ``rays_an_item`` rays
    each; without work-items where several devices have cast the rays."""

    changes: np.ndarray
    samples: int
    counts: np.ndarray | None
    samples_by_item: np.ndarray = field(default_factory=lambda: np.zeros(0, np.uint32))
    rays_an_item: int = 1


def cast_rays(
    context: DeviceContext,
    packets: PacketRenderer,
    view: np.ndarray,
    work: RayWork,
    image: DeviceArray,
    depths: DeviceArray,
    progress: Callable[[int], None] | None = None,
) -> CastRays:
    """Writes the rays of ``work`` into ``image`` [height, width, 4] and ``depths`` [height, width].

    ``view``: ``View`` [1] of the whole picture. ``progress(rays done)`` is called after each
    launch.
    """
    if not work.count:
        none = np.zeros((0, packets.counters), np.uint32) if packets.counters else None
        return CastRays(np.zeros(0, np.float32), 0, none)
    counting = counts_argument(packets.counters) if packets.counters else ()
    declared = packets.arguments + _LIST_ARGUMENTS + counting
    kernel = context.kernel(packets.file, "tile_rays", declared, packets.switches)
    rays_an_item = packets.lanes * _PACKETS_AN_ITEM if packets.lanes > 1 else 1
    items = -(-work.count // rays_an_item)
    arrays = dict(packets.arrays)
    width, height = (int(n) for n in view["image"][0])
    counts = None
    if packets.counters:
        counts = arrays["counts"] = context.empty(np.uint32, (items, packets.counters))
    changes = context.empty(np.float32, (work.count,))
    samples = context.empty(np.uint32, (items,))
    rays = context.upload(work.pixels)
    on_device = context.empty(view.dtype, (1,))
    expected = work.count * packets.seconds_a_ray
    for first, launched in bands(items, expected, _BAND_SECONDS):
        view["first_tile"] = first
        context.write(on_device, view)
        kernel(
            context.queue,
            (launched,),
            (1,) if packets.lanes > 1 else None,
            sizes={"tiles": items, "width": width, "height": height},
            view=on_device,
            rays=rays,
            count=work.count,
            rays_an_item=rays_an_item,
            image=image,
            depths=depths,
            changes=changes,
            samples=samples,
            **arrays,
        )
        context.finish()
        if progress is not None:
            progress(min((first + launched) * rays_an_item, work.count))
    by_item = context.read(samples)
    return CastRays(
        context.read(changes),
        int(by_item.sum(dtype=np.uint64)),
        None if counts is None else context.read(counts),
        by_item,
        rays_an_item,
    )
