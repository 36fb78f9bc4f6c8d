"""Weights of blocks' errors in a view: the pixels that a block covers, the pixels per voxel, and the light
that reaches the eye.

Blocks are parallelepipeds in world space. Each of their measures is a sum of one term per axis,
so a picture's planes are tested against millions of blocks by adding
three short arrays. Lengths are in units of the smallest voxel edge, from the eye.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clvol.device.view import picture_height
from clvol.scene.camera import Camera
from clvol.store.geometry import BlockGrid
from clvol.volume import Grid

VISIBILITY_FLOOR = 1e-3
_MARGIN = 1.0  # voxels that interpolation reaches beyond a block
_LARGEST_SPACING = 1e6  # pixels per voxel, for voxels at the eye
_TRACED = 1 << 17  # at most this many blocks are traced; where there are more, several are traced as one
_OPAQUE = 50.0  # optical depth that lets nothing through
# Rays go to four corners of a cube a little smaller than the block, so that one of them passes the edge of an
# occluder.
_AIMS = 0.4 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])


@dataclass(frozen=True, eq=False)
class ViewWeights:
    """``pixels`` [n] float32: area that a block covers in the picture, at most the picture's own; 0
    outside the view. ``spacing`` [n] float32: upper bound of the pixels per longest voxel edge, at the nearest point
    of the block."""

    pixels: np.ndarray
    spacing: np.ndarray

    def with_least(self, share: float) -> ViewWeights:
        """The same, with areas of at least ``share`` of the largest."""
        return self if share == 0 else replace(self, pixels=np.maximum(self.pixels, share * self.pixels.max()))

    def apply(self, errors: np.ndarray, first: int = 0) -> np.ndarray:
        """Weights ``errors`` [levels, k] of the blocks from ``first`` on, in place; returns them.

        A pixel averages samples that are closer than a pixel, and so their errors, too: they
        are weighted by min(1, pixels between samples)^2.
        """
        part = slice(first, first + errors.shape[1])
        for level in range(len(errors)):
            seen = np.minimum(self.spacing[part] * np.float32(1 << level), np.float32(1.0))
            errors[level] *= self.pixels[part] * seen * seen
        return errors


@dataclass(frozen=True, eq=False)
class BlockAxes:
    """Where the blocks of a grid lie, seen from a point, in smallest voxel edges.

    ``start`` [3]: position of index (-0.5, -0.5, -0.5) relative to the point. ``steps`` [3, 3]: row k is the
    world vector of a voxel along x, y or z. ``centres``, ``halves``: centres of the blocks along x, y and
    z, in voxels from ``start``, and half their lengths."""

    start: np.ndarray
    steps: np.ndarray
    centres: tuple[np.ndarray, ...]
    halves: tuple[np.ndarray, ...]

    def along(self, vector: np.ndarray, z: slice) -> np.ndarray:
        """[bz, by, bx]: centres . ``vector``."""
        x, y, z_ = (c * float(s @ vector) for c, s in zip(self.centres, self.steps))
        return float(self.start @ vector) + (z_[z, None, None] + y[:, None] + x)

    def reach(self, vector: np.ndarray, z: slice, margin: float = 0.0) -> np.ndarray:
        """[bz, by, bx]: the extent of a block along ``vector`` from its centre, times
        |vector|."""
        x, y, z_ = ((h + margin) * abs(float(s @ vector)) for h, s in zip(self.halves, self.steps))
        return z_[z, None, None] + y[:, None] + x


def block_axes(point: np.ndarray, grid: Grid, blocks: BlockGrid) -> BlockAxes:
    """The blocks as seen from a world point [3]."""
    unit = grid.smallest_edge
    steps = (grid.direction * (np.asarray(grid.spacing) / unit)).T
    origin = (np.asarray(grid.origin, np.float64) - np.asarray(point, np.float64)) / unit
    centres, halves = [], []
    for n in blocks.shape[::-1]:
        low = np.arange(0.0, n, blocks.edge)
        high = np.minimum(low + blocks.edge, n)
        centres.append(0.5 * (low + high))
        halves.append(0.5 * (high - low))
    return BlockAxes(origin - 0.5 * steps.sum(axis=0), steps, tuple(centres), tuple(halves))


def view_weights(
    camera: Camera, grid: Grid, blocks: BlockGrid, width: int, height: int
) -> ViewWeights:
    """The weights for ``camera`` (complete) and a picture of ``width`` by ``height`` pixels, of ``blocks`` over
    ``grid``.

    A block counts as outside the view if it lies beyond one of the view's planes (including that of the eye), by
    more than the reach of a voxel. A block that may hold the eye covers the whole picture.
    """
    axes = block_axes(np.asarray(camera.position), grid, blocks)
    nz, ny, nx = blocks.counts
    pixels = np.empty(blocks.counts, np.float32)
    spacing = np.empty(blocks.counts, np.float32)
    for bz in range(nz):
        z = slice(bz, bz + 1)
        with np.errstate(over="ignore", divide="ignore", invalid="ignore", under="ignore"):
            area, apart = _areas(camera, grid, axes, z, width, height)
            area = np.where(_inside(camera, grid, axes, z, width / height), area, 0.0)
        pixels[z] = np.minimum(np.nan_to_num(area, nan=0.0), float(width * height))
        spacing[z] = np.minimum(np.nan_to_num(apart, nan=_LARGEST_SPACING), _LARGEST_SPACING)
    return ViewWeights(pixels.ravel(), spacing.ravel())


def _inside(camera: Camera, grid: Grid, axes: BlockAxes, z: slice, aspect: float) -> np.ndarray:
    """bool [bz, by, bx]: whether a block is not entirely beyond one of the view's planes."""
    forward, right, up = camera.basis()
    if camera.projection == "orthographic":
        half, slope = 0.5 * picture_height(camera) / grid.smallest_edge, 0.0
    else:
        half, slope = 0.0, np.tan(np.radians(camera.fov_degrees) / 2.0)
    planes = [(forward, 0.0)]
    for across, stretch in ((right, aspect), (up, 1.0)):
        for sign in (1.0, -1.0):
            planes.append((slope * stretch * forward + sign * across, half * stretch))
    inside = np.ones((1, 1, 1), bool)
    for normal, offset in planes:
        farthest = axes.along(normal, z) + axes.reach(normal, z, _MARGIN) + offset
        inside = inside & (farthest >= 0)
    return inside


def _areas(
    camera: Camera, grid: Grid, axes: BlockAxes, z: slice, width: int, height: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels covered [bz, by, bx], and pixels per longest voxel edge."""
    forward, right, up = camera.basis()
    longest = max(grid.spacing) / grid.smallest_edge
    hx, hy, hz = axes.halves
    hz = hz[z, None, None]
    x, y, z_ = axes.steps
    # For each of the three pairs of faces: the normal of one voxel's face, and the number of voxels in the
    # face.
    faces = [(np.cross(y, z_), 4 * hz * hy[:, None]), (np.cross(x, z_), 4 * hz * hx),
             (np.cross(x, y), 4 * hy[:, None] * hx)]  # fmt: skip
    if camera.projection == "orthographic":
        pixel = picture_height(camera) / grid.smallest_edge / height
        area = sum(abs(float(normal @ forward)) * count for normal, count in faces) / pixel**2
        area = np.broadcast_to(area, axes.along(forward, z).shape)
        return area, np.full(area.shape, longest / pixel)
    pixel = 2.0 * np.tan(np.radians(camera.fov_degrees) / 2.0) / height  # at distance 1
    depth = axes.along(forward, z)
    offsets = depth, axes.along(right, z), axes.along(up, z)
    distance = np.sqrt(sum(part * part for part in offsets))
    radius = float(np.sqrt(((2 * max(h.max() for h in axes.halves) * axes.steps) ** 2).sum())) / 2
    # The area seen along the line to the eye, p, is sum |normal . p| / |p|; on the screen it is
    # larger by 1 / (depth^2 cos), cos = depth / |p|: |p| cancels.
    seen = sum(np.abs(axes.along(normal, z)) * count for normal, count in faces)
    area = seen / (pixel**2 * np.maximum(depth, radius) ** 3)
    area = np.where(distance <= radius, float(width * height), area)
    nearest = np.maximum(depth - axes.reach(forward, z), 0.0)
    return area, longest / (pixel * nearest)


def visibility(
    camera: Camera, grid: Grid, blocks: BlockGrid, transmittances: np.ndarray
) -> np.ndarray:
    """float32 [n]: light that reaches the eye from each block, at least ``VISIBILITY_FLOOR``.

    ``transmittances`` [n]: along a path of a block's edge times the smallest voxel edge,
    through each block. The rays from the eye to four places in the block go through the lattice in
    steps of one block, reading the nearest block; the clearest ray counts, and the block itself does not.
    Where there are many blocks, several are traced as one, by the mean of their transmittances, which is not less than
    the transmittance of their mean optical depth.
    """
    factor = 1
    while np.prod([-(-n // factor) for n in blocks.counts]) > _TRACED:
        factor *= 2
    lattice = _means(np.asarray(transmittances).reshape(blocks.counts), factor)
    with np.errstate(divide="ignore"):
        depths = np.minimum(-np.log(lattice), _OPAQUE)
    best = np.full(depths.size, np.inf)
    centres = np.stack(np.unravel_index(np.arange(depths.size), depths.shape)[::-1], axis=-1) + 0.5
    side = factor * blocks.edge
    for aim in _AIMS:
        found = _depth_before(camera, grid, depths, centres + aim, side)
        best = np.minimum(best, found * factor)
    seen = np.maximum(np.exp(-best), VISIBILITY_FLOOR).astype(np.float32).reshape(depths.shape)
    for axis, n in enumerate(blocks.counts):
        seen = np.repeat(seen, factor, axis=axis).take(np.arange(n), axis=axis)
    return seen.ravel()


def _means(values: np.ndarray, factor: int) -> np.ndarray:
    """Means over cubes of ``factor`` blocks per edge, with fewer blocks at the upper faces."""
    out, counts = values.astype(np.float64), np.ones(values.shape)
    for axis in range(3):
        starts = np.arange(0, values.shape[axis], factor)
        out = np.add.reduceat(out, starts, axis=axis)
        counts = np.add.reduceat(counts, starts, axis=axis)
    return out / counts


def _depth_before(
    camera: Camera, grid: Grid, depths: np.ndarray, ends: np.ndarray, side: int
) -> np.ndarray:
    """[n]: sum of ``depths`` [z, y, x] from the eye to ``ends`` [n, 3] (x, y, z), all in units of
    ``side`` voxels; each is weighted by the length of the ray in it, relative to ``side`` smallest voxel
    edges."""
    counts = np.array(depths.shape[::-1], np.float64)
    to_index = grid.world_to_index()
    eye = (to_index[:3] @ np.append(np.asarray(camera.position, np.float64), 1.0) + 0.5) / side
    starts = np.broadcast_to(eye, ends.shape)
    steps_world = (grid.direction * (np.asarray(grid.spacing) / grid.smallest_edge)).T
    if camera.projection == "orthographic":
        forward = camera.basis()[0]
        before = np.maximum((ends - eye) @ (steps_world @ forward), 0.0)
        starts = ends - before[:, None] * (to_index[:3, :3] @ (grid.smallest_edge * forward))
    starts = _clipped(starts, ends, counts)
    delta = ends - starts
    lengths = np.linalg.norm(delta @ steps_world, axis=1)
    steps = np.maximum(np.ceil(np.abs(delta).max(axis=1)).astype(np.int64), 1)
    order = np.argsort(-steps, kind="stable")  # so that rays that are not finished come first
    starts, delta, lengths, steps = starts[order], delta[order], lengths[order], steps[order]
    strides = np.array([1, depths.shape[2], depths.shape[1] * depths.shape[2]])
    flat, sums = depths.ravel(), np.zeros(len(ends))
    own = np.floor(ends[order]).astype(np.int64) @ strides
    for step in range(int(steps[0])):
        active = int(np.searchsorted(-steps, -step, side="left"))
        t = ((step + 0.5) / steps[:active])[:, None]
        places = np.floor(starts[:active] + t * delta[:active])
        np.clip(places, 0, counts - 1, out=places)
        places = places.astype(np.int64) @ strides
        sums[:active] += np.where(places == own[:active], 0.0, flat[places])
    out = np.empty(len(ends))
    out[order] = sums * lengths / steps
    return out


def _clipped(starts: np.ndarray, ends: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """``starts`` moved towards ``ends``, which are inside, to where the lattice 0 ... ``counts``
    begins."""
    delta = ends - starts
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(
            starts < 0.0, -starts / delta, np.where(starts > counts, (counts - starts) / delta, 0.0)
        )
    return starts + np.clip(t.max(axis=1), 0.0, 1.0)[:, None] * delta
