"""What cl/empty_space.cl computes, in numpy: a program takes longer to load, or to compile, than to do the work of a
small volume."""

from __future__ import annotations

import sys

import numpy as np

from clvol.opencl.context import DeviceContext
from clvol.volume.voxel_layout import cell_count

_MOST_VOXELS, _MOST_CELLS, _MOST_CELLS_OF_OCTANTS = 2**24, 2**18, 2**14


def done_on_host(context: DeviceContext, voxels: int) -> bool:
    """Whether what follows from a volume of so many voxels is computed on the host: its memory is the device's."""
    return context.is_cpu and voxels <= _MOST_VOXELS and sys.byteorder == "little"


def distances_on_host(context: DeviceContext, cells: int) -> bool:
    """The same, of a map of so many cells."""
    return context.is_cpu and cells <= _MOST_CELLS


def octants_on_host(context: DeviceContext, cells: int) -> bool:
    """The same, of a map with those of the octants."""
    return context.is_cpu and cells <= _MOST_CELLS_OF_OCTANTS


def pair_rows(data: np.ndarray, pairs: np.ndarray) -> None:
    """As the kernel of this name: ``data`` of one byte [z, y, x] to ``pairs`` uint8 [n, 2], whose last elements, beyond
    the volume's, become 0."""
    nz, ny, nx = data.shape
    data = data.view(np.uint8)
    words = pairs.view(np.uint16).ravel()
    words[nz * (ny - 1) * nx :] = 0
    for plane, out in zip(data, words[: nz * (ny - 1) * nx].reshape(nz, ny - 1, nx)):
        np.left_shift(plane[1:], 8, out=out, dtype=np.uint16)
        np.bitwise_or(out, plane[:-1], out=out)


def min_max_cells(data: np.ndarray, shift: int, apron: int) -> np.ndarray:
    """As the kernel of this name: [z, y, x, 2], of the type of ``data`` [z, y, x]."""
    low = high = data
    if data.dtype.kind == "f" and not (finite := np.isfinite(data)).all():
        low, high = np.where(finite, data, np.inf), np.where(finite, data, -np.inf)
    for axis in range(3):
        low = _extremes(low, axis, shift, apron, np.minimum)
        high = _extremes(high, axis, shift, apron, np.maximum)
    any_value = low <= high
    found = np.where(any_value, low, 1), np.where(any_value, high, 0)
    return np.stack(found, axis=-1).astype(data.dtype, copy=False)


def _extremes(array: np.ndarray, axis: int, shift: int, apron: int, over: np.ufunc) -> np.ndarray:
    """``over`` (np.minimum, for example) of the lattice points of each cell along ``axis``."""
    n, edge = array.shape[axis], 1 << shift
    starts = np.arange(cell_count(n, shift)) * edge
    found: np.ndarray | None = None
    for offset in range(-apron, edge + apron + 1):
        if 0 <= offset and starts[-1] + offset < n:
            part = array[(slice(None),) * axis + (slice(offset, starts[-1] + offset + 1, edge),)]
        else:
            part = array.take(np.clip(starts + offset, 0, n - 1), axis=axis)
        found = part.copy() if found is None else over(found, part, out=found)
    assert found is not None
    return found


def cell_distances(mask: np.ndarray) -> np.ndarray:
    """uint8 [z, y, x]: distances in cells (maximum norm, at most 255) to the nearest cell of ``mask``."""
    distances = np.full(mask.shape, 255, np.uint8)
    reached = mask.copy()
    distances[reached] = 0
    for distance in range(1, 255):
        if reached.all() or not reached.any():
            break
        before = reached
        for axis in range(3):
            grown = reached.copy()
            ahead, behind = [slice(None)] * 3, [slice(None)] * 3
            ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
            grown[tuple(ahead)] |= reached[tuple(behind)]
            grown[tuple(behind)] |= reached[tuple(ahead)]
            reached = grown
        np.copyto(distances, distance, where=reached & ~before)
    return distances


def octant_distances(mask: np.ndarray) -> np.ndarray:
    """uint8 [8, z, y, x]: distances in cells (maximum norm, at most 255) to the nearest cell of ``mask`` ahead: of the
    same or larger x in maps whose number has bit 0, y bit 1, z bit 2, and of the same or smaller otherwise."""
    start = np.where(mask, 0, 255).astype(np.uint8)
    found = np.empty((2, 2, 2, *mask.shape), np.uint8)
    for x in range(2):
        along_x = _distances_ahead(start, 2, bool(x))
        for y in range(2):
            along_y = _distances_ahead(along_x, 1, bool(y))
            for z in range(2):
                found[z, y, x] = _distances_ahead(along_y, 0, bool(z))
    return found.reshape(8, *mask.shape)


def _distances_ahead(distances: np.ndarray, axis: int, larger: bool) -> np.ndarray:
    """min over k >= 0 of max(k, distances[place + k]) along ``axis``, or [place - k] if not ``larger``."""
    found = distances.copy()
    ahead, behind = [slice(None)] * 3, [slice(None)] * 3
    for k in range(1, min(distances.shape[axis], 255)):
        ahead[axis], behind[axis] = slice(k, None), slice(None, -k)
        to, source = (behind, ahead) if larger else (ahead, behind)
        np.minimum(found[tuple(to)], np.maximum(distances[tuple(source)], np.uint8(k)), out=found[tuple(to)])
    return found
