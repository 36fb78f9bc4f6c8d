"""The arguments of kernels that read a whole scene: ``SCENE_PARAMETERS`` of cl/scene.h, in its three variants.

A kernel's list is composed: ``scene_arguments(bits) + EFFECT_ARGUMENTS + its own + counts_argument(n)``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from clvol.opencl.arguments import RAW, Argument, reads, writes
from clvol.opencl.structs import BLOCKS, EFFECTS, view_dtype

Arguments = tuple[Argument, ...]

EFFECT_ARGUMENTS: Arguments = (
    reads("effects", EFFECTS),
    reads("items", np.float32),
    reads("gradients", np.uint32),
    reads("surface_distances", np.uint8),
    reads("constant_distances", np.uint8),
    reads("environment", np.float32),
    reads("light_volume", np.float32),
    reads("noise", np.uint32),
    reads("factors", np.float32),
    reads("fields", np.float32),
    reads("occlusion", np.float32),
)
"""The arguments that EFFECTS adds; a few bytes stand in for arrays that a scene does not need."""


def view_argument(voxel_bits: int) -> Argument:
    """The frame's ``View`` (cl/view.h)."""
    return reads("view", view_dtype(voxel_bits))


@lru_cache
def scene_arguments(voxel_bits: int) -> Arguments:
    """The arguments with which every variant begins."""
    return (
        reads("volume", RAW),
        reads("table", np.float32),
        reads("distances", np.uint8),
        view_argument(voxel_bits),
    )


def block_arguments(buffers: int, *, bounded: bool = False) -> Arguments:
    """The arguments that BLOCKS adds (cl/block_parameters.h), for samples in ``buffers`` buffers. ``bounded``: for the
    stepping "bounded"."""
    more = tuple(reads(f"samples{k}", RAW) for k in range(1, buffers))
    steps = (reads("steps", np.uint8),) if bounded else ()
    return (reads("index", np.int32), reads("corners", np.uint32), reads("blocks", BLOCKS), *more, *steps)


@lru_cache
def picture_arguments(*, depth: bool) -> Arguments:
    """The arrays that a picture is written to: pixels, and a number of samples per tile."""
    return (
        writes("image", np.float32, "width", "height", 4),
        writes("depths", np.float32, *(("width", "height") if depth else ())),
        writes("samples", np.uint32, "tiles"),
    )


def counts_argument(counters: int) -> Arguments:
    """``COUNTS_PARAMETER`` of cl/scene.h: the counts of ``counters`` counters per tile."""
    return (writes("counts", np.uint32, "tiles", counters),)
