"""Volumes as blocks at random levels, for tests: on a device, as numpy's twin, as scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from reference.multiresolution import BlockField

from clvol import Scene, TransferFunction, Volume
from clvol.device.arguments import block_arguments, view_argument
from clvol.features import FILTERS
from clvol.integrators.multiresolution.blocked_volume import blocks_struct
from clvol.integrators.multiresolution.caster import BlockCaster
from clvol.integrators.multiresolution.device_blocks import DeviceBlocks
from clvol.integrators.multiresolution.sample_allocator import overhead_bytes
from clvol.opencl.arguments import RAW, reads, value, writes
from clvol.opencl.structs import view_dtype
from clvol.scene import ImageSettings, Integration
from clvol.scene.multiresolution import Multiresolution
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks

_SOURCE = Path(__file__).with_name("block_values.cl")
_ROOM = 2**20  # bytes for what is not samples, beside the overhead: spare bytes of buffers

# Steep between points, thin enough that what is behind shows.
SHOWN = TransferFunction(
    [0.0, 60.0, 140.0, 255.0],
    [0.0, 0.01, 0.05, 0.12],
    [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.9, 0.9]],
)


def noise(shape, dtype=np.uint8, seed=1, holes=0.0) -> Volume:
    """Every voxel random, over 0 to 255 (-100 to 100 of signed types); ``holes``: a share that is
    NaN."""
    rng = np.random.default_rng(seed)
    low, high = (-100, 101) if np.dtype(dtype).kind == "i" else (0, 256)
    data = rng.integers(low, high, shape).astype(dtype)
    if holes:
        data[rng.random(shape) < holes] = np.nan
    return Volume(data)


def random_levels(grid: BlockGrid, seed: int, dropped: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    levels = rng.integers(0, grid.levels, grid.count)
    return np.where(rng.random(grid.count) < dropped, DROPPED, levels).astype(np.uint8)


def means_of(source: VolumeBlocks) -> np.ndarray:
    return np.concatenate([part.mean[-1] for part in source.statistics()])


def resident(context, volume, levels, edge=16, largest_buffer=None) -> DeviceBlocks:
    """``volume`` on the device at ``levels``."""
    source = VolumeBlocks(volume, edge)
    grid = source.blocks
    size = volume.data.nbytes + grid.count * grid.edge**3 * source.dtype.itemsize
    memory = size + _ROOM + overhead_bytes(grid, 2**40)
    blocks = DeviceBlocks(context, source, memory, largest_buffer=largest_buffer)
    blocks.load(levels, means_of(source))
    return blocks


def twin_of(volume, levels, edge=16) -> BlockField:
    return BlockField.of(VolumeBlocks(volume, edge), levels)


def random_places(grid: BlockGrid, count: int, seed: int) -> np.ndarray:
    """float32 [count, 3] (x, y, z) within the volume's domain: random, on and beside faces, on
    planes through blocks' and samples' centres, and at the volume's hull. ``count``: a multiple of
    16."""
    rng = np.random.default_rng(seed)
    upper = np.maximum(grid.shape[::-1], 2) - 0.5
    p = 0.5 + rng.random((count, 3)) * (upper - 0.5)
    kind = rng.integers(0, 8, (count, 3))
    faces = grid.edge * np.rint(p / grid.edge)
    near = faces + rng.choice([-1e-4, -0.01, -0.3, 0.2, 0.02, 1e-4], p.shape)
    centres = grid.edge * (np.floor(p / grid.edge) + 0.5)
    p = np.select(
        [kind == 0, kind == 1, kind == 2, kind == 3, kind == 4],
        [faces, near, centres, np.floor(p) + 0.5, np.where(rng.random(p.shape) < 0.5, 0.5, upper)],
        p,
    )
    return np.clip(p, 0.5, upper).astype(np.float32)


def values_at(context, blocks: DeviceBlocks, p, interblock=True, lanes=16):
    """The kernels' values float32 [n] at places [n, 3], and their counters uint64 [2]."""
    grid = blocks.blocks
    view = np.zeros(1, view_dtype(blocks.switches["VOXEL_BITS"]))
    view["voxel_gain"] = blocks.value_map.gain
    more = {f"samples{k}": array for k, array in enumerate(blocks.samples) if k}
    kernel = context.kernel(
        str(_SOURCE), "block_values",
        (
            reads("volume", RAW), view_argument(blocks.switches["VOXEL_BITS"]), *block_arguments(len(blocks.samples)),
            reads("at", np.float32, 3, "n"), value("n", np.int32), value("interblock", np.int32),
            writes("values", np.float32, "n"), writes("counts", np.uint32, len(p) // lanes, 2),
        ),
        {**blocks.switches, "LANES": lanes, "FILTER": FILTERS["linear"]},
    )  # fmt: skip
    n = len(p)
    values, counts = context.empty(np.float32, (n,)), context.empty(np.uint32, (n // lanes, 2))
    kernel(
        context.queue, (n // lanes,), (1,), volume=blocks.samples[0], view=context.upload(view),
        index=blocks.index, corners=blocks.corners, blocks=context.upload(blocks_struct(grid)), **more,
        at=context.upload(np.ascontiguousarray(p.T, np.float32)), n=n, interblock=int(interblock),
        values=values, counts=counts,
    )  # fmt: skip
    return context.read(values), context.read(counts).sum(axis=0, dtype=np.uint64)


def block_scene(
    volume, function=SHOWN, *, width=24, height=20, camera=None, settings=None, **integration
):
    """A resolved scene of the method "multiresolution"; ``settings``: keys of [multiresolution]."""
    integration = {"early_termination": 0.0, "classification": "post", **integration}
    return Scene(
        volume=volume,
        transfer_function=function,
        camera=camera,
        image=ImageSettings(width=width, height=height),
        integration=Integration(method="multiresolution", **integration),
        multiresolution=Multiresolution(**(settings or {})),
    ).resolve()


def picture_of(caster: BlockCaster):
    """``FrameData`` of the caster's scene."""
    resolved = caster.resolved
    return caster.render(resolved.camera, resolved.image.width, resolved.image.height)


def block_picture(context, resolved, blocks: DeviceBlocks, **how):
    """``FrameData`` of what is resident in ``blocks``; ``how``: keys of ``BlockCaster``."""
    return picture_of(BlockCaster(context, resolved, blocks, **how))
