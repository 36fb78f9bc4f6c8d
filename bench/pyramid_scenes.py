"""What the method "pyramid" is measured on, after Kraus, Strengert, Klein and Ertl ("Adaptive
sampling in three dimensions for volume rendering on GPUs", APVIS 2007): the aneurism as it is
and at 512^3 as theirs, a CT angiography in place of their abdomen; and scenes of the rest of the
bench.

All are pre-integrated, as the method needs it, whatever suits them best elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.multiresolution_scenes import CHEST_BLOCKS, FEMALE, BlockScene, placed_as_in_bench

if TYPE_CHECKING:
    from clvol.scene.resolve import ResolvedScene
    from clvol.volume import Volume

ANEURISM, ENGINE, HEPTANE = map(placed_as_in_bench, ("aneurism", "engine-smooth", "heptane"))
PYRAMID_SCENES = (ANEURISM, ENGINE, HEPTANE, FEMALE, CHEST_BLOCKS)
LEVELS = 3  # as in the paper
_LONGEST_STEP = 1e6  # that a scene may state


def by_rays(scene: BlockScene, volume: Volume, size: int, **integration: Any) -> ResolvedScene:
    """``size`` by ``size`` pixels of ``volume`` by the plain ray caster."""
    integration = {"classification": "preintegrated", **integration}
    return scene.plain(volume, size, {"integration": integration}).resolve()


def by_pyramid(
    scene: BlockScene, volume: Volume, size: int, integration: Mapping[str, Any] | None = None,
    **settings: Any,
) -> ResolvedScene:
    """The same by the method "pyramid"; ``settings`` of the table [pyramid]."""
    asked = {"classification": "preintegrated", "method": "pyramid", **(integration or {})}
    tables = {"integration": asked, "pyramid": {"levels": LEVELS, **settings}}
    return scene.plain(volume, size, tables).resolve()


def ray_spacing(resolved: ResolvedScene) -> float:
    """How far neighbouring rays of a perspective view are apart in the middle of the volume, in
    smallest voxel edges: the step with which slices lie as far apart, as in the paper."""
    from clvol.device.view import ray_frame

    camera, grid, image = resolved.camera, resolved.volume.grid, resolved.image
    lens = ray_frame(camera, grid, image.width, image.height).lens[0]
    away = np.linalg.norm(grid.world_corners().mean(axis=0) - np.asarray(camera.position))
    return float(np.clip(lens * away / grid.smallest_edge, 1e-6, _LONGEST_STEP))


def resampled(volume: Volume, edge: int) -> Volume:
    """``volume`` (two voxels an axis at least) with ``edge`` voxels along every axis, between the
    same outermost voxel centres: linear between voxels, rounded to their type. A layer at a time,
    so that little memory is taken."""
    from clvol import Volume

    data, grid = volume.data, volume.grid
    (k, fz), (j, fy), (i, fx) = (_between(n, edge) for n in data.shape)
    found = np.empty((edge, edge, edge), data.dtype)
    for z in range(edge):
        layer = _mixed(data[k[z]], data[k[z] + 1], fz[z])
        layer = _mixed(layer[j], layer[j + 1], fy[:, None])
        found[z] = np.rint(_mixed(layer[:, i], layer[:, i + 1], fx))
    spacing = [s * (n - 1) / (edge - 1) for n, s in zip(grid.size, grid.spacing)]
    return Volume(found, tuple(spacing), grid.origin, grid.direction, volume.name)


def _between(voxels: int, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Of ``samples`` even places from the first to the last of ``voxels``: the voxel at or below,
    and how far on it is to the next."""
    places = np.linspace(0.0, voxels - 1.0, samples)
    below = np.minimum(places.astype(np.int64), voxels - 2)
    return below, (places - below).astype(np.float32)


def _mixed(one: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
    return one * (1 - share) + other * share
