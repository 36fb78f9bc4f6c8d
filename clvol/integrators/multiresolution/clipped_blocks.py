"""What clips leave of blocks: which of them lie wholly in what is removed, and how much of the others is kept.

A block is its box of voxels with a margin around it, since values and gradients beside its faces are made of its
samples, too. Boxes are bounded along the world's axes, so a block of an oblique grid may be kept although nothing of it
is seen, but is never removed although something is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clvol.integrators.multiresolution.view_weight import BlockAxes, block_axes
from clvol.scene.clip import Clip, MeshClip
from clvol.store.geometry import BlockGrid
from clvol.volume.grid import Grid

MARGIN = 2.0  # voxels: a gradient's reach, and half a voxel of what is blended between blocks
_POINTS = (np.arange(4) + 0.5) / 4  # of an axis of a block, where is looked how much of it is kept
_PIECE = 1 << 12  # blocks that are looked at together


def removed_blocks(clips: Sequence[Clip], grid: Grid, blocks: BlockGrid) -> np.ndarray:
    """bool [n]: blocks of which the clips keep nothing, nor of what is within 2 voxels of them."""
    removed = np.zeros(blocks.counts, bool)
    for clip in clips:
        if isinstance(clip, MeshClip):  # of a mesh the box around it is known to hold what it keeps
            if clip.keep == "outside":
                continue
            low, high = (corner.tolist() for corner in clip.mesh.bounds)
            if not all(a < b for a, b in zip(low, high)):
                continue
            clip = Clip(type="box", lower=low, upper=high)
        axes = block_axes(np.asarray(_centre(clip), np.float64), grid, blocks)
        for z in range(blocks.counts[0]):
            layer = slice(z, z + 1)
            found = _outside(clip, grid, axes, layer) if clip.keep == "inside" else _inside(clip, grid, axes, layer)
            removed[layer] |= found
    return removed.ravel()


def kept_shares(clips: Sequence[Clip], grid: Grid, blocks: BlockGrid, wanted: np.ndarray) -> np.ndarray:
    """float32 [n]: the share of each block that the clips keep, of 64 points; 1 of those that are not ``wanted``
    (bool [n])."""
    shares = np.ones(blocks.count, np.float32)
    z, y, x = np.meshgrid(_POINTS, _POINTS, _POINTS, indexing="ij")
    offsets = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    to_world = grid.index_to_world()
    numbers = np.flatnonzero(wanted)
    for first in range(0, len(numbers), _PIECE):
        piece = numbers[first : first + _PIECE]
        low = blocks.places(piece)[:, ::-1] * float(blocks.edge)
        size = np.minimum(np.asarray(blocks.shape[::-1]) - low, blocks.edge)
        index = (low[:, None] + size[:, None] * offsets - 0.5).reshape(-1, 3)
        kept = _kept(clips, index @ to_world[:3, :3].T + to_world[:3, 3])
        shares[piece] = kept.reshape(len(piece), -1).mean(axis=1)
    return shares


def _centre(clip: Clip) -> Sequence[float]:
    found = {"plane": clip.point, "box": clip.lower, "sphere": clip.center}[clip.type]
    assert found is not None
    return found


def _outside(clip: Clip, grid: Grid, axes: BlockAxes, z: slice) -> np.ndarray:
    """bool [1, by, bx]: blocks without a point in the convex set of ``clip``."""
    if clip.type == "plane":
        normal = _direction(clip)
        return axes.along(normal, z) + axes.reach(normal, z, MARGIN) < 0
    low, high = _ranges(axes, z)
    if clip.type == "box":
        size = (np.asarray(clip.upper) - np.asarray(clip.lower)) / grid.smallest_edge
        return np.logical_or.reduce([(b < 0) | (a > s) for a, b, s in zip(low, high, size)])
    nearest = sum(np.maximum(np.maximum(a, -b), 0.0) ** 2 for a, b in zip(low, high))
    return np.asarray(nearest > _radius(clip, grid) ** 2)


def _inside(clip: Clip, grid: Grid, axes: BlockAxes, z: slice) -> np.ndarray:
    """bool [1, by, bx]: blocks that lie within the convex set of ``clip``."""
    low, high = _ranges(axes, z)
    if clip.type == "box":
        size = (np.asarray(clip.upper) - np.asarray(clip.lower)) / grid.smallest_edge
        return np.logical_and.reduce([(a > 0) & (b < s) for a, b, s in zip(low, high, size)])
    farthest = sum(np.maximum(np.abs(a), np.abs(b)) ** 2 for a, b in zip(low, high))
    return np.asarray(farthest < _radius(clip, grid) ** 2)


def _ranges(axes: BlockAxes, z: slice) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Where the blocks begin and end along the world's axes, from the point of ``axes``."""
    low, high = [], []
    for axis in np.eye(3):
        middle, reach = axes.along(axis, z), axes.reach(axis, z, MARGIN)
        low.append(middle - reach)
        high.append(middle + reach)
    return low, high


def _direction(clip: Clip) -> np.ndarray:
    normal = np.asarray(clip.normal, np.float64)
    return normal / np.abs(normal).max()


def _radius(clip: Clip, grid: Grid) -> float:
    assert clip.radius is not None
    return min(clip.radius / grid.smallest_edge, 1e150)


def _kept(clips: Sequence[Clip], at: np.ndarray) -> np.ndarray:
    """bool [k]: world points ``at`` [k, 3] that the clips keep."""
    kept = np.ones(len(at), bool)
    for clip in clips:
        if isinstance(clip, MeshClip):
            continue
        if clip.type == "box":
            inside = np.all((at >= np.asarray(clip.lower)) & (at <= np.asarray(clip.upper)), axis=1)
        elif clip.type == "plane":
            inside = (at - np.asarray(clip.point)) @ _direction(clip) >= 0
        else:
            with np.errstate(over="ignore"):
                inside = ((at - np.asarray(clip.center)) ** 2).sum(axis=1) <= np.float64(clip.radius) ** 2
        kept &= inside if clip.keep == "inside" else ~inside
    return kept
