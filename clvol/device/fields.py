"""The fields of a scene as cl/fields.h reads them: their voxels, their position, and what their values mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from clvol.device.empty_space import visible_mask
from clvol.device.memory import ValueMap, value_map
from clvol.device.transfer_lookup import device_function
from clvol.device.voxel_colors import packed_colors
from clvol.errors import VolumeError
from clvol.features.vocabulary import FIELD_ROLES
from clvol.store.volume_blocks import VolumeBlocks
from clvol.transfer import TransferFunction
from clvol.transfer.lookup_nodes import LookupNodes, lookup_nodes, visible_cells
from clvol.transfer.pieces import has_opaque_point, piece_count, piece_table
from clvol.volume.voxel_layout import CELL_SHIFT, LARGEST_OFFSET, padded_size

if TYPE_CHECKING:
    from clvol.opencl.context import DeviceContext
    from clvol.scene.field import ResolvedField
    from clvol.scene.resolve import ResolvedScene
    from clvol.volume import Grid, Volume

_DENSITY_NODES = 4096
_ROUNDING = 4e-6  # of a linear interpolation in float32, as a share of the largest value
_MARGIN = 0.02  # voxels of the volume that a sample may be off its cell, generously
_FINEST_SHIFT = 1e-9  # voxels: anything below that is rounding of the affine maps
_FEWEST, _COARSEST = 2, 4  # samples per axis that a field is left, and the coarsest level of blocks
_CELLS_TOGETHER = 1 << 20  # of which boxes are looked at
T = TypeVar("T")


def field_switches(resolved: ResolvedScene) -> dict[str, int]:
    bits = 0
    for field in resolved.fields:
        bits |= FIELD_ROLES[field.role]
    return {"FIELDS": bits}


@dataclass(frozen=True)
class CellLayout:
    """Cells of ``edge`` lattice units of a volume, of which the first begins at ``first`` along each axis."""

    edge: int
    first: float = 0.0


LATTICE_CELLS = CellLayout(1 << CELL_SHIFT)


class SceneFields:
    """The fields of a scene: ``voxels`` is the buffer `fields`, and ``numbers`` of struct Effects are filled in.

    ``shown`` bool [z, y, x]: the ``cells`` of the volume in which a density can have opacity;
    ``kept``: those in which all masks may keep something. ``place(array)`` puts numbers into the buffer
    `factors` and returns their offset.
    """

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        cells: tuple[int, int, int],
        place: Callable[[np.ndarray], int],
        numbers: np.ndarray,
        layout: CellLayout = LATTICE_CELLS,
        levels: Sequence[int] | None = None,
    ) -> None:
        levels = levels or [0] * len(resolved.fields)
        _check_fits(context, field_bytes(resolved, levels))
        parts = [_Part(field, resolved.volume.grid, level) for field, level in zip(resolved.fields, levels)]
        numbers["field_count"] = len(parts)
        edge = resolved.volume.grid.smallest_edge
        begin = 0
        for k, part in enumerate(parts):
            row = numbers["fields"][k]
            for axis, name in enumerate("xyz"):
                row[name] = (*part.matrix[axis], part.shift[axis])
            row["size"][:3] = part.voxels.shape[::-1]
            row["lower"][:3], row["upper"][:3] = part.lower, part.upper
            row["role"], row["first_voxel"] = FIELD_ROLES[part.field.role], begin
            begin += part.voxels.size
            part.fill(row, place, edge)
        self.voxels = context.upload(np.concatenate([part.voxels.ravel() for part in parts]))
        self.shown, self.kept = np.zeros(cells[::-1], bool), np.ones(cells[::-1], bool)
        for part in parts:
            if part.field.role == "density":
                self.shown |= part.density_cells(cells, layout)
            elif part.field.role == "mask":
                self.kept &= part.mask_cells(cells, layout)


def kept_blocks(
    fields: Sequence[tuple[ResolvedField, int]], grid: Grid, counts: tuple[int, int, int], edge: int, margin: float
) -> np.ndarray:
    """bool [bz, by, bx]: blocks of ``edge`` voxels of ``grid`` of which, and of ``margin`` voxels around, all masks
    among ``fields``, with their levels, keep something. ``counts``: blocks (z, y, x)."""
    kept, layout = np.ones(counts, bool), CellLayout(edge, -0.5)
    for field, level in fields:
        if field.role == "mask":
            kept &= _Part(field, grid, level).mask_cells((counts[2], counts[1], counts[0]), layout, margin)
    return kept


def field_bytes(resolved: ResolvedScene, levels: Sequence[int] | None = None) -> int:
    """Bytes on the device for the voxels of all fields; ``levels``: of the fields (``field_levels``); None: all 0."""
    return sum(_bytes_at(field, level) for field, level in zip(resolved.fields, levels or [0] * len(resolved.fields)))


def field_levels(resolved: ResolvedScene, most_bytes: int) -> list[int]:
    """Levels at which the fields of a scene take at most ``most_bytes``, as far as that is possible: the largest one
    goes first. Labels and colours, of which there is no mean, and axes of few voxels stay as they are."""
    levels = [0] * len(resolved.fields)
    while field_bytes(resolved, levels) > most_bytes:
        sizes = [
            (_bytes_at(field, level), k)
            for k, (field, level) in enumerate(zip(resolved.fields, levels))
            if field.role in ("density", "mask") and min(field.volume.shape) >> (level + 1) >= _FEWEST
            and level < _COARSEST
        ]  # fmt: skip
        if not sizes:
            break
        levels[max(sizes)[1]] += 1
    return levels


def _bytes_at(field: ResolvedField, level: int) -> int:
    return 4 * math.prod(-(-n >> level) if level else n for n in padded_size(field.volume))


def _check_fits(context: DeviceContext, needed: int) -> None:
    largest = min(int(context.device.max_mem_alloc_size), 4 * LARGEST_OFFSET)
    if needed > largest:
        what = f"the voxels of all fields need {needed} bytes as float32 on {context.name}"
        raise VolumeError("fields", what, f"at most {largest} bytes in one buffer")


class _Part:
    """One field, of which a sample stands for 2^``level`` voxels along each axis. ``voxels`` float32 [z, y, x];
    ``matrix`` float64 [3, 3] and ``shift`` [3]: from lattice points of the volume to its own. ``lower`` and ``upper``
    [3]: where its domain ends."""

    def __init__(self, field: ResolvedField, grid: Grid, level: int = 0) -> None:
        self.field = field
        self.values = ValueMap() if field.role in ("label", "color") else value_map(field.volume)
        self.voxels = _voxels(field, self.values, level)
        matrix, shift = between_lattices(grid, field.volume.grid)
        size = float(1 << level)
        self.matrix, self.shift = matrix / size, (shift + 0.5) / size - 0.5 if level else shift
        last = np.asarray(padded_size(field.volume)) - 1.0
        self.lower, self.upper = ((at + 0.5) / size - 0.5 for at in (np.zeros(3), last))

    def fill(self, row: np.void, place: Callable[[np.ndarray], int], edge: float) -> None:
        """Fills in the members of the struct ``Field`` that depend on the role. ``edge``: world length of the volume's
        smallest edge."""
        field = self.field
        if field.role == "label":
            table = np.column_stack([_present(field.colors), _present(field.factors)])
            row["table"] = place(np.vstack([[0.0, 0.0, 0.0, 1.0], table]))
        elif field.role in ("color", "value"):
            row["table"] = 0
        elif field.role == "mask":
            row["threshold"] = float(self.values(_present(field.threshold)))
            row["side"] = 1.0 if field.keep == "above" else -1.0
        else:
            function, nodes = self._density
            table = piece_table(function, edge, origin=float(np.float32(nodes.first)))
            row["table"] = place(table.ravel())
            row["piece_columns"], row["piece_count"] = table.shape[1], piece_count(function)
            row["has_pole"], row["edge_units"] = has_opaque_point(function), edge / function.opacity_unit

    @property
    def _density(self) -> tuple[TransferFunction, LookupNodes]:
        volume = self.field.volume
        function = device_function(_present(self.field.function), self.values)
        low, high = (float(v) for v in self.values(volume.value_range))
        integer = volume.dtype.kind in "iu"
        return function, lookup_nodes(function, (low, high), _DENSITY_NODES, integer=integer)

    def density_cells(self, cells: tuple[int, int, int], layout: CellLayout) -> np.ndarray:
        function, nodes = self._density
        bounds = _Bounds(*self._bounds(cells, layout))
        visible = visible_cells(function, nodes.values)
        at_nodes = function.opacity(nodes.values) > 0
        return visible_mask(bounds, "linear", nodes, visible, at_nodes)

    def mask_cells(self, cells: tuple[int, int, int], layout: CellLayout, margin: float = 0.0) -> np.ndarray:
        low, high = self._bounds(cells, layout, margin)
        level = np.float32(self.values(_present(self.field.threshold)))  # as the kernel compares
        inside = low <= high
        return inside & (high >= level if self.field.keep == "above" else low <= level)

    def _bounds(
        self, cells: tuple[int, int, int], layout: CellLayout, margin: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray]:
        """float64 [z, y, x]: bounds of everything that is interpolated in each cell of the volume and ``margin``
        lattice units around it; low > high where nothing is interpolated."""
        low, high = np.empty(cells[::-1]), np.empty(cells[::-1])
        layers = max(_CELLS_TOGETHER // (cells[0] * cells[1]), 1)
        around = None
        for first in range(0, cells[2], layers):
            part = slice(first, first + layers)
            middle, reach = cell_boxes(cells, self.matrix, self.shift, layout, part, margin)
            around = around or BoundsAround(self.voxels, reach, self.lower, self.upper)
            low[part], high[part] = around(middle)
        rounding = np.where(low < high, _ROUNDING * np.maximum(np.abs(low), np.abs(high)), 0.0)
        return low - rounding, high + rounding


@dataclass(frozen=True)
class _Bounds:
    """Bounds that are known, as ``CellBounds``."""

    low: np.ndarray
    high: np.ndarray

    def bounds(self, apron: int) -> tuple[np.ndarray, np.ndarray]:
        return self.low, self.high


def _voxels(field: ResolvedField, values: ValueMap, level: int = 0) -> np.ndarray:
    """float32 [z, y, x] as cl/fields.h expects them; axes of one voxel are doubled."""
    data = field.volume.data if level == 0 else _coarser(field.volume, level)
    if field.role == "label":
        voxels = _label_codes(data, _present(field.labels))
    elif field.role == "color":
        voxels = packed_colors(_present(field.colors_of_voxels)).view(np.float32)
    else:
        voxels = (data if values == ValueMap() else values(data)).astype(np.float32)
        if data.dtype.kind == "f":
            voxels[~np.isfinite(voxels)] = np.nan
    for axis, n in enumerate(voxels.shape):
        voxels = np.repeat(voxels, 2, axis=axis) if n == 1 else voxels
    return np.ascontiguousarray(voxels)


def _coarser(volume: Volume, level: int) -> np.ndarray:
    """[z, y, x]: the samples of all blocks of ``volume`` at ``level``; of a store they are read from it."""
    source = getattr(volume, "blocks_source", None) or VolumeBlocks(volume)
    blocks = source.blocks
    side, (bz, by, bx) = blocks.samples(level), blocks.counts
    out = np.empty((bz * side, by * side, bx * side), source.dtype)
    for z in range(bz):
        numbers = np.arange(z * by * bx, (z + 1) * by * bx)
        layer = source.read(level, numbers).reshape(by, bx, side, side, side).transpose(2, 0, 3, 1, 4)
        out[z * side : (z + 1) * side] = layer.reshape(side, by * side, bx * side)
    return out[tuple(slice(-(-n >> level)) for n in volume.shape)]


def _present(value: T | None) -> T:
    """``value``, which a ``ResolvedField`` of the role at hand has."""
    if value is None:
        raise ValueError("a field lacks a value that its role reads")
    return value


def _label_codes(data: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """float32, in the shape of ``data``: the position of each voxel's label among ``labels`` (ascending), counted
    from 1, or 0 for other labels."""
    codes = np.empty(data.shape, np.float32)
    for z, voxels in enumerate(data):  # slice by slice: int64 takes eight bytes per voxel
        wanted = voxels.astype(np.float64)
        at = np.searchsorted(labels, wanted).clip(None, labels.size - 1)
        codes[z] = np.where(labels[at] == wanted, at + 1, 0)
    return codes


def between_lattices(volume: Grid, field: Grid) -> tuple[np.ndarray, np.ndarray]:
    """float64 matrix [3, 3] and shift [3]: from lattice points of ``volume`` to those of ``field``,
    through world space. An axis of one voxel runs from 0 to 1 in a lattice, from -1/2 to 1/2 in
    indices.

    The map is formed relative to the volume's first voxel, so that a far origin of both grids cancels first.
    """
    to_index = field.world_to_index()[:3, :3]
    matrix = to_index @ volume.index_to_world()[:3, :3]
    thin_volume, thin_field = (0.5 * (np.asarray(grid.size) == 1) for grid in (volume, field))
    shift = to_index @ np.subtract(volume.origin, field.origin)
    shift = shift - matrix @ thin_volume + thin_field
    matrix, shift = (np.where(np.abs(a) < _FINEST_SHIFT, 0.0, a) for a in (matrix, shift))
    return matrix, shift


def cell_boxes(
    cells: tuple[int, int, int], matrix: np.ndarray, shift: np.ndarray, layout: CellLayout = LATTICE_CELLS,
    z: slice = slice(None), margin: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Boxes in a field's lattice around the volume's cells: centres float64 [z, y, x, 3], and the half extents [3]
    that all of them share. ``z``: of these layers of cells. ``margin``: lattice units of the volume around cells."""
    axes = [layout.edge * (np.arange(n) + 0.5) + layout.first for n in cells]
    z_, y, x = np.meshgrid(axes[2][z], axes[1], axes[0], indexing="ij")
    middle = np.stack([x, y, z_], axis=-1) @ matrix.T + shift
    return middle, np.abs(matrix).sum(axis=1) * (0.5 * layout.edge + margin + _MARGIN) + _MARGIN


class BoundsAround:
    """Smallest and largest finite voxel of ``voxels`` [z, y, x] that interpolation within ``reach`` [3] of places uses,
    perhaps with a few more voxels."""

    def __init__(
        self, voxels: np.ndarray, reach: np.ndarray, lower: np.ndarray | None = None, upper: np.ndarray | None = None
    ) -> None:
        """``lower``, ``upper`` [3]: where the domain ends; None: with the outermost voxels."""
        from scipy import ndimage  # importing it takes a tenth of a second, which scenes without fields save

        self._upper, self._reach = np.array(voxels.shape[::-1]) - 1, reach
        self._from = np.zeros(3) if lower is None else lower
        self._to = self._upper if upper is None else upper
        # From the voxel before the lowest position to the one beyond the highest.
        count = np.minimum(np.ceil(2.0 * np.minimum(reach, 1e9)) + 2, self._upper + 1).astype(np.int64)
        size = tuple(int(n) for n in count[::-1])
        ahead = tuple(-(n // 2) for n in size)
        self._bounds = []
        for filter, outside in ((ndimage.minimum_filter, np.inf), (ndimage.maximum_filter, -np.inf)):
            filled = np.where(np.isnan(voxels), np.float32(outside), voxels)
            self._bounds.append(filter(filled, size=size, mode="constant", cval=outside, origin=ahead))

    def __call__(self, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """float64 [...], of places ``middle`` [..., 3] (x, y, z); low > high where there is none."""
        meets = np.all((middle + self._reach >= self._from) & (middle - self._reach <= self._to), axis=-1)
        first = np.clip(np.floor(middle - self._reach), 0, self._upper).astype(np.int64)
        places = tuple(first[..., axis] for axis in (2, 1, 0))
        low, high = (bound[places].astype(np.float64) for bound in self._bounds)
        return np.where(meets, low, np.inf), np.where(meets, high, -np.inf)


def bounds_around(
    voxels: np.ndarray, middle: np.ndarray, reach: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``BoundsAround`` of ``reach`` at ``middle``."""
    return BoundsAround(voxels, reach)(middle)
