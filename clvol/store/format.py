"""The layout of a store on disk: names, shapes and metadata. Nothing is read or written here.

STORE/zarr.json      group: OME-Zarr 0.5 ``multiscales``, and what it cannot express under ``clvol``;
                     written last
STORE/0 ... STORE/4  arrays [z, y, x], level 0 at full resolution; a shard is a file, and covers
                     the same part of the volume at each level
STORE/blocks/NAME    arrays [level, bz, by, bx] of statistics, as in BlockStatistics
STORE/blocks/checksums  array [region, chunk]: binds chunks to positions (places.py); older stores have none
STORE.partial        an incomplete store: the same, with clvol-journal/

At level 0 a chunk holds one block; at coarser levels it holds (chunk / samples)^3 blocks.

A level that holds codes is an array [z, y, x and byte] of uint8: a chunk is a pack of blocks (packs.py), whose bytes
follow those of the pack before it along x. Such levels are not among OME-Zarr's ``multiscales``, since other readers
cannot decode them; the coarsest levels always hold samples.
STORE/codebooks      int8 [stage, code, sample], of codecs that have codebooks (stored_codes.py)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import UsageError, VolumeError
from clvol.store import packs
from clvol.store.codecs import COARSE, FEWEST_CODED, LABELS, Codec, find_codec, statistics_chain
from clvol.store.geometry import EDGES, BlockGrid
from clvol.store.source import QUANTILES
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.units import ome_name
from clvol.volume.volume import ACCEPTED_TYPES

VERSION = 1
ROOT = "zarr.json"
JOURNAL = "clvol-journal"
PARTIAL = ".partial"
CODES_OF = "clvol-codes"  # attribute of the arrays of levels that hold codes: the codec
_LONG = 1024  # voxels of the longest axis above which shards are larger, to limit the number of files
_LARGEST_SHARD = 1024
_STATISTICS_PIECE = 1 << 18  # levels times blocks in a chunk of statistics
_TABLE_PIECE = 1 << 16  # checksums in a chunk of their table


def partial_path(path: Path) -> Path:
    """The folder in which the store ``path`` is built."""
    return path.with_name(path.name + PARTIAL)


def default_shard(shape: tuple[int, int, int]) -> int:
    """Voxels per axis of a shard."""
    return 256 if max(shape) > _LONG else 128


@dataclass(frozen=True)
class StoreLayout:
    """The layout of a store.

    ``shard`` is in voxels per axis of level 0, a multiple of ``edge``. ``codecs`` has one codec per level, and
    ``parameters`` their parameters (JSON).
    """

    shape: tuple[int, int, int]
    dtype: np.dtype
    edge: int
    shard: int
    codecs: tuple[Codec, ...]
    parameters: tuple[dict, ...]

    @cached_property
    def blocks(self) -> BlockGrid:
        return BlockGrid(self.shape, self.edge)

    @property
    def regions(self) -> tuple[int, int, int]:
        """Shards (z, y, x) of each level."""
        nz, ny, nx = (-(-n // self.shard) for n in self.shape)
        return nz, ny, nx

    @property
    def coded(self) -> bool:
        """Whether some levels hold codes."""
        return any(codec.coded for codec in self.codecs)

    def chunk(self, level: int) -> int:
        """Samples per axis of a chunk."""
        if self.codecs[level].coded:
            return self.pack * self.blocks.samples(level)
        return math.gcd(self.edge, self.shard >> level)

    def chunk_blocks(self, level: int) -> int:
        """Blocks per axis of a chunk."""
        return self.chunk(level) // self.blocks.samples(level)

    def chunks(self, level: int) -> int:
        """Chunks per axis of a shard."""
        return self.shard // self.edge // self.chunk_blocks(level)

    @property
    def pack(self) -> int:
        """Blocks per axis of a pack of codes."""
        return packs.side(self.shard // self.edge)

    def capacity(self, level: int) -> int:
        """Bytes of a pack at a level that holds codes."""
        return packs.capacity(self.pack**3, self.blocks.samples(level) ** 3 * self.dtype.itemsize)

    def region(self, index: int, level: int = 0) -> tuple[slice, slice, slice]:
        """The samples [z, y, x] of shard ``index`` (C order) at ``level``."""
        place = np.unravel_index(index, self.regions)
        side = self.shard >> level
        ends = self.blocks.level_shape(level)
        z, y, x = (slice(int(p) * side, min((int(p) + 1) * side, n)) for p, n in zip(place, ends))
        return z, y, x

    def stored_region(self, index: int, level: int) -> tuple[slice, ...]:
        """Where shard ``index`` is in the array of ``level``."""
        if not self.codecs[level].coded:
            return self.region(index, level)
        first = np.array(np.unravel_index(index, self.regions)) * self.chunks(level)
        ends = -(-np.array(self.blocks.counts) // self.pack)
        return self.packs_region(level, first, np.minimum(first + self.chunks(level), ends))

    def packs_region(self, level: int, low: np.ndarray, high: np.ndarray) -> tuple[slice, slice, slice]:
        """Where the packs ``low`` <= (z, y, x) < ``high`` are in the array of ``level``."""
        (z0, y0, x0), (z1, y1, x1) = low.tolist(), high.tolist()
        return slice(z0, z1), slice(y0, y1), slice(x0 * self.capacity(level), x1 * self.capacity(level))

    def shard_file(self, index: int, level: int) -> str:
        """The path of a shard, relative to the store."""
        return "/".join(
            [str(level), "c", *(str(int(p)) for p in np.unravel_index(index, self.regions))]
        )

    def level_metadata(self, level: int) -> dict:
        """The zarr.json of a level."""
        codec = self.codecs[level]
        dtype = np.dtype(np.uint8) if codec.coded else self.dtype
        sharding = {
            "chunk_shape": [1, 1, self.capacity(level)] if codec.coded else [self.chunk(level)] * 3,
            "codecs": codec.chain(dtype),
            "index_codecs": [
                {"name": "bytes", "configuration": {"endian": "little"}},
                {"name": "crc32c"},
            ],
            "index_location": "end",
        }
        codecs = [{"name": "sharding_indexed", "configuration": sharding}]
        if not codec.coded:
            shape = self.blocks.level_shape(level)
            return _array(shape, [self.shard >> level] * 3, dtype, codecs, ["z", "y", "x"])
        z, y, x = (-(-n // self.pack) for n in self.blocks.counts)
        n, capacity = self.chunks(level), self.capacity(level)
        metadata = _array((z, y, x * capacity), (n, n, n * capacity), dtype, codecs, ["z", "y", "x and byte"])
        return metadata | {"attributes": {CODES_OF: codec.name}}

    # ---- statistics ----

    @property
    def statistics_rows(self) -> int:
        """Rows of blocks along z in a chunk of statistics; each region has a multiple of it."""
        rows = self.shard // self.edge
        _, y, x = self.blocks.counts
        while rows % 2 == 0 and rows * y * x * self.blocks.levels > _STATISTICS_PIECE:
            rows //= 2
        return rows

    @cached_property
    def statistics_types(self) -> dict[str, np.dtype]:
        """Names and types of the arrays of statistics. Nothing is lost except digits of means of integers beyond
        float32.
        """
        real = np.dtype(np.float64 if self.dtype == np.float64 else np.float32)
        return {
            "minimum": self.dtype, "maximum": self.dtype, "mean": real,
            "quantiles": real, "deviation": real,
            "reach_low": self.dtype, "reach_high": self.dtype, "holes": np.dtype(bool),
        }  # fmt: skip

    def statistics_shape(self, name: str, counts: tuple[int, int, int]) -> tuple[int, ...]:
        """The shape of the array ``name`` over ``counts`` blocks."""
        if name in ("reach_low", "reach_high", "holes"):
            return counts
        return (self.blocks.levels, *counts, *((QUANTILES,) if name == "quantiles" else ()))

    def statistics_metadata(self, name: str) -> dict:
        """The zarr.json of an array of statistics."""
        dtype = self.statistics_types[name]
        z, y, x = self.blocks.counts
        shape = self.statistics_shape(name, (z, y, x))
        chunk = self.statistics_shape(name, (self.statistics_rows, y, x))
        names = ["z", "y", "x"]
        if len(shape) > 3:
            names = ["level", *names, *(["quantile"] if name == "quantiles" else [])]
        return _array(shape, chunk, dtype, statistics_chain(dtype, self.coded), names)

    # ---- checksums by place ----

    @cached_property
    def table_chunks(self) -> int:
        """Number of chunks of all levels of a region."""
        return sum(self.chunks(k) ** 3 for k in range(self.blocks.levels))

    @property
    def table_rows(self) -> int:
        """Number of regions in a chunk of the table of checksums."""
        return min(max(_TABLE_PIECE // self.table_chunks, 1), math.prod(self.regions))

    def table_metadata(self) -> dict:
        """The zarr.json of the table of checksums."""
        dtype, shape = np.dtype(np.uint32), (math.prod(self.regions), self.table_chunks)
        chunk = (self.table_rows, self.table_chunks)
        return _array(shape, chunk, dtype, statistics_chain(dtype, self.coded), ["region", "chunk"])


def _array(shape: tuple, chunk: Any, dtype: np.dtype, codecs: list, names: list[str]) -> dict:
    # Every chunk exists, so the fill value is never read; NaN would make a missing one visible.
    fill: Any = {"f": "NaN", "b": False}.get(dtype.kind, 0)
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": list(shape),
        "data_type": dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(chunk)}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": fill,
        "codecs": codecs,
        "dimension_names": names,
    }


def codebooks_metadata(shape: tuple[int, ...]) -> dict:
    """The zarr.json of codebooks, int8 [stage, code, sample]."""
    dtype = np.dtype(np.int8)
    return _array(shape, shape, dtype, COARSE.chain(dtype), ["stage", "code", "sample"])


def check_layout(
    shape: tuple, dtype: np.dtype, edge: int, shard: int | None, codec: Codec
) -> StoreLayout:
    """The layout of a new store; UsageError for an impossible one."""
    if edge not in EDGES:
        raise UsageError("edge", f"got {edge!r}", "one of " + ", ".join(map(str, EDGES)))
    shard = max(default_shard(shape), edge) if shard is None else shard
    if not (edge <= shard <= _LARGEST_SHARD and shard % edge == 0):
        expected = f"a multiple of the edge {edge}, at most {_LARGEST_SHARD}"
        raise UsageError("shard", f"got {shard!r}", expected)
    codecs = tuple(
        codec if not codec.coded or edge >> level >= FEWEST_CODED else COARSE
        for level in range(edge.bit_length())
    )
    dtype = np.dtype(dtype)
    if codec.coded and not codec.lossless and dtype == np.float64:
        dtype = np.dtype(np.float32)
    return StoreLayout(tuple(shape), dtype, edge, shard, codecs, ({},) * len(codecs))


# ---- the root group ------------------------------------------------------------------------------


def root_metadata(
    layout: StoreLayout, grid: Grid, name: str | None, frame: str, facts: dict, writer: str
) -> dict:
    """The zarr.json of the group. ``facts``: value_range, nan_count, inf_count, slope, offset, unit, checksums and, of
    a store that holds codes, codes.
    """
    own = {
        "version": VERSION,
        "writer": writer,
        "name": name,
        "shape": list(layout.shape),
        "dtype": layout.dtype.name,
        "edge": layout.edge,
        "shard": layout.shard,
        "levels": layout.blocks.levels,
        "quantiles": QUANTILES,
        "codecs": [
            {"name": codec.name, "lossless": codec.lossless, "parameters": parameters}
            for codec, parameters in zip(layout.codecs, layout.parameters)
        ],
        "spacing": list(grid.spacing),
        "origin": list(grid.origin),
        "direction": grid.direction.tolist(),
        "frame": frame,
        **facts,
    }
    ome = {"version": "0.5", "multiscales": [_multiscale(layout, grid, name, facts.get("unit"))]}
    return {"zarr_format": 3, "node_type": "group", "attributes": {"ome": ome, "clvol": own}}


def _multiscale(layout: StoreLayout, grid: Grid, name: str | None, unit: str | None) -> dict:
    """OME-Zarr metadata. OME-Zarr has no rotations: on a rotated grid, positions are along the grid's own axes,
    relative to its first voxel.
    """
    spacing = np.asarray(grid.spacing[::-1])
    plain = np.array_equal(grid.direction, np.eye(3))
    origin = np.asarray(grid.origin[::-1]) if plain else np.zeros(3)
    datasets = []
    for level in range(layout.blocks.levels):
        if layout.codecs[level].coded:
            continue
        first = origin + (2**level - 1) / 2 * spacing  # centre of the first sample
        transformations = [
            {"type": "scale", "scale": (2**level * spacing).tolist()},
            {"type": "translation", "translation": first.tolist()},
        ]
        datasets.append({"path": str(level), "coordinateTransformations": transformations})
    axes = [{"name": axis, "type": "space"} for axis in "zyx"]
    if (said := ome_name(unit)) is not None:
        axes = [{**axis, "unit": said} for axis in axes]
    labels = layout.codecs[0].name == LABELS
    what = "most frequent labels" if labels else "means"
    method = {"description": f"{what} of the voxels of level 0", "method": "clvol.store.resolutions"}
    return {
        "name": name or "volume",
        "type": "mode" if labels else "mean",
        "metadata": method,
        "axes": axes,
        "datasets": datasets,
    }


@dataclass(frozen=True, eq=False)
class StoreFacts:
    """The contents of a store's root metadata."""

    layout: StoreLayout
    grid: Grid
    name: str | None
    frame: str
    value_range: tuple[float, float]
    nan_count: int
    inf_count: int
    axis: ValueAxis = ValueAxis()
    unit: str | None = None
    checksums: dict | None = None  # "table": of its parts, "statistics": of files, by array; None in older stores
    codes: Any = None  # JSON, as stored_codes.py says; None without codes


def parse_root(root: Any, where: str) -> StoreFacts:
    """The contents of ``root``, the zarr.json of a group; VolumeError unless it is a store that this version reads."""
    attributes = root.get("attributes") if isinstance(root, dict) else None
    own = attributes.get("clvol") if isinstance(attributes, dict) else None
    if not isinstance(own, dict):
        raise VolumeError(where, "not a clvol store", "a folder that clvol store has written")
    version = own.get("version")
    if version != VERSION:
        newer = isinstance(version, int) and version > VERSION
        what = (
            f"stored by a newer clvol (version {version})"
            if newer
            else f"store version {version!r}"
        )
        raise VolumeError(where, what, f"version {VERSION}")
    try:
        return _facts(own, where)
    except VolumeError as error:  # an impossible grid, or an unknown codec
        what = (
            error.what
            if error.where == where
            else f"damaged zarr.json ({error.where} {error.what})"
        )
        raise VolumeError(where, what, error.expected) from None
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        detail = f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)[:100]
        raise VolumeError(
            where, f"damaged zarr.json ({detail})", "metadata that clvol store has written"
        ) from None


def _facts(own: dict, where: str) -> StoreFacts:
    edge, shard = own["edge"], own["shard"]
    if edge not in EDGES:
        raise ValueError(f"edge {edge}")
    if not (isinstance(shard, int) and edge <= shard <= _LARGEST_SHARD and shard % edge == 0):
        raise ValueError(f"shard {shard}")
    if own["levels"] != edge.bit_length() or len(own["codecs"]) != own["levels"]:
        raise ValueError(f"{own['levels']} levels for blocks of {edge}")
    if own["quantiles"] != QUANTILES:
        raise ValueError(f"{own['quantiles']} quantiles")
    if own["dtype"] not in ACCEPTED_TYPES:
        raise ValueError(f"dtype {own['dtype']}")
    grid = Grid(tuple(own["shape"]), own["spacing"], own["origin"], np.asarray(own["direction"]))
    codecs = tuple(find_codec(str(entry["name"]), where) for entry in own["codecs"])
    if any(codec.coded and edge >> level < FEWEST_CODED for level, codec in enumerate(codecs)):
        raise ValueError("codes of blocks below 4^3")
    parameters = tuple(dict(entry.get("parameters", {})) for entry in own["codecs"])
    low, high = (float(value) for value in own["value_range"])
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise ValueError("value_range")
    layout = StoreLayout(grid.shape, np.dtype(own["dtype"]), edge, shard, codecs, parameters)
    name = None if own["name"] is None else str(own["name"])
    counts = int(own["nan_count"]), int(own["inf_count"])
    axis = ValueAxis(own.get("slope", 1.0), own.get("offset", 0.0))
    unit = None if own.get("unit") is None else str(own["unit"])
    checksums = _checksums(own["checksums"], layout) if "checksums" in own else None
    if layout.coded != ("codes" in own):
        raise ValueError("codes")
    return StoreFacts(
        layout, grid, name, str(own["frame"]), (low, high), *counts, axis, unit, checksums, own.get("codes")
    )


def _checksums(own: dict, layout: StoreLayout) -> dict:
    known = {"table": own["table"], **{name: own["statistics"][name] for name in layout.statistics_types}}
    for name, found in known.items():
        if not isinstance(found, list):
            raise ValueError(f"checksums of {name}")
    return {"table": own["table"], "statistics": own["statistics"]}
