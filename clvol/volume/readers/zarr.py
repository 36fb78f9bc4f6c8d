"""Zarr folders: stores of clvol's, any OME-Zarr (0.4, 0.5) image, or a plain array; read by
tensorstore when asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.lazy import LazyVolume
from clvol.volume.readers.options import ReadOptions
from clvol.volume.volume import Volume, check_type

if TYPE_CHECKING:
    from clvol.store.zarr_store import StoredBlocks

_MARKS = ("zarr.json", ".zgroup", ".zarray")
_SPACE = ("z", "y", "x")


def is_zarr(path: Path) -> bool:
    """Whether the folder is a Zarr array or group, or a store whose making was interrupted."""
    from clvol.store.zarr_store import is_unfinished

    return any((path / name).exists() for name in _MARKS) or is_unfinished(path)


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a Zarr folder; nothing but metadata is read before somebody asks for voxels.

    Of a multiscale image the finest level. Axes that are not space (time, channel) must have length
    1; an image without z is one slice. Scale and translation of OME-Zarr become spacing and origin.
    """
    from clvol.store.zarr_store import is_store, open_store

    if is_store(path):
        return StoredVolume(open_store(path), options.memory_cap)
    array, grid, name, frame = _image(path)
    return ZarrVolume(array, grid, name, frame, str(path), options.memory_cap)


class StoredVolume(LazyVolume):
    """A store of clvol's: range and counts are known without reading voxels. ``blocks_source``: its
    blocks."""

    def __init__(self, source: StoredBlocks, memory_cap: int | None = None) -> None:
        self.blocks_source = source
        super().__init__(
            source.dtype, source.grid, source.name, source.facts.frame, str(source.path), memory_cap
        )
        self.axis = source.facts.axis

    @property
    def grid(self) -> Grid:
        """Also that of ``blocks_source``."""
        return self.blocks_source.grid

    @grid.setter
    def grid(self, grid: Grid) -> None:
        self.blocks_source.grid = grid

    @property
    def stored_range(self) -> tuple[float, float]:
        return self.blocks_source.value_range

    @property
    def nan_count(self) -> int:
        return self.blocks_source.nan_count

    @property
    def inf_count(self) -> int:
        return self.blocks_source.inf_count

    def _turned(self) -> Volume:
        from clvol.store.turned import TurnedBlocks

        other = StoredVolume(TurnedBlocks(self.blocks_source), self._memory_cap)
        other.path, other.format = self.path, self.format
        return other

    def _load(self) -> np.ndarray:
        return self.blocks_source.volume_level(0)

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        return self.blocks_source.box(z0, z1, y0, y1, x0, x1)


class ZarrVolume(LazyVolume):
    """Somebody else's Zarr array [z, y, x]. Chunks that are not there count as the fill value, as
    Zarr has it."""

    def __init__(
        self,
        array: Any,
        grid: Grid,
        name: str | None,
        frame: str,
        where: str,
        memory_cap: int | None,
    ) -> None:
        self._array = array
        dtype = check_type(np.dtype(array.dtype.numpy_dtype), where)
        super().__init__(dtype, grid, name, frame, where, memory_cap)

    def _load(self) -> np.ndarray:
        nz, ny, nx = self.shape
        return self.box(0, nz, 0, ny, 0, nx)

    def box(self, z0: int, z1: int, y0: int, y1: int, x0: int, x1: int) -> np.ndarray:
        from clvol.store.arrays import what_failed

        try:
            voxels = self._array[z0:z1, y0:y1, x0:x1].read().result()
        except ValueError as error:
            raise VolumeError(
                self._where, f"a chunk {what_failed(error)}", "undamaged chunks"
            ) from None
        voxels = np.ascontiguousarray(voxels)
        return voxels.view(np.uint8) if voxels.dtype.kind == "b" else voxels


# ---- other people's ------------------------------------------------------------------------------


def _image(path: Path) -> tuple[Any, Grid, str | None, str]:
    """Array [z, y, x], grid, name and frame of the finest level."""
    where = str(path)
    attributes = _attributes(path, where)
    if attributes is None:
        array = _array(path, where)
        names = [None] * array.rank
        array = _without_length_one(array, names, where)[0]
        return array, Grid(tuple(array.shape)), _stem(path), "index"
    multiscales = attributes.get("ome", attributes).get("multiscales")
    if not multiscales and "bioformats2raw.layout" in attributes.get("ome", attributes):
        return _image(path / "0")
    if not isinstance(multiscales, list) or not multiscales:
        raise VolumeError(
            where, "a Zarr group without multiscales", "an OME-Zarr image or one array"
        )
    return _multiscale(path, where, multiscales[0])


def _multiscale(path: Path, where: str, multiscale: dict) -> tuple[Any, Grid, str | None, str]:
    try:
        dataset = multiscale["datasets"][0]
        place = str(dataset["path"])
        axes = [
            axis["name"] if isinstance(axis, dict) else str(axis)
            for axis in multiscale.get("axes", ())
        ]
        kinds = [
            axis.get("type") if isinstance(axis, dict) else None
            for axis in multiscale.get("axes", ())
        ]
        scale, shift = _transformation([dataset, multiscale])
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise VolumeError(where, f"damaged multiscales ({error})", "OME-Zarr metadata") from None
    folder = path.joinpath(*(part for part in place.split("/") if part not in ("", ".", "..")))
    array = _array(folder, where)
    rank = array.rank
    names: list[str | None] = [
        n if k in (None, "space") and n not in ("t", "c") else None for n, k in zip(axes, kinds)
    ]
    if len(axes) != rank:
        if axes:
            raise VolumeError(
                where, f"{len(axes)} axes for an array of {rank}", "OME-Zarr metadata"
            )
        names = [None] * rank
    scale = np.ones(rank) if scale is None else scale
    shift = np.zeros(rank) if shift is None else shift
    if len(scale) != rank or len(shift) != rank:
        raise VolumeError(
            where, f"a transformation that is not of {rank} axes", "OME-Zarr metadata"
        )
    array, kept = _without_length_one(array, names, where)
    # kept: which axis of the file each of z, y, x is; None where there is no z
    steps = [1.0 if k is None else float(scale[k]) for k in kept][::-1]
    origin = [0.0 if k is None else float(shift[k]) for k in kept][::-1]
    name = multiscale.get("name")
    grid = Grid.from_steps(tuple(array.shape), np.diag(steps), origin)
    return array, grid, str(name) if name else _stem(path), "image"


def _transformation(parts: list[dict]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Scale and translation of all, the first applied first."""
    scale = shift = None
    for part in parts:
        for step in part.get("coordinateTransformations", ()):
            if step["type"] == "scale":
                factors = np.asarray(step["scale"], float)
                scale = factors if scale is None else scale * factors
                shift = None if shift is None else shift * factors
            elif step["type"] == "translation":
                moved = np.asarray(step["translation"], float)
                shift = moved if shift is None else shift + moved
            elif step["type"] != "identity":
                raise ValueError(f"transformation {step['type']!r}")
    return scale, shift


def _without_length_one(array: Any, names: list, where: str) -> tuple[Any, list[int | None]]:
    """``array`` as [z, y, x], and which of its axes those were. ``names``: of axes of space; None
    for others, or everywhere if nothing is known: then axes of length 1 are left out until three
    are left."""
    shape = list(array.shape)
    space = [k for k, name in enumerate(names) if name is not None]
    if not space:
        space = list(range(len(shape)))
        while len(space) > 3 and any(shape[k] == 1 for k in space):
            space.remove(next(k for k in space if shape[k] == 1))
        if len(space) != 3:
            raise VolumeError(where, f"an array of shape {shape}", "three axes [z, y, x]")
    others = [k for k in range(len(shape)) if k not in space]
    if len(space) not in (2, 3) or any(shape[k] != 1 for k in others):
        said = ", ".join(f"{name or 'other'} {n}" for name, n in zip(names, shape))
        raise VolumeError(where, f"axes of length {said}", "z, y, x, and other axes of length 1")
    by_name = {names[k]: k for k in space}
    if len(by_name) == len(space) and set(by_name) <= set(_SPACE):
        space = [by_name[name] for name in _SPACE if name in by_name]
    if any(shape[k] < 1 for k in space):
        raise VolumeError(where, f"empty array of shape {shape}", "at least one voxel")
    array = array[tuple(0 if k in others else slice(None) for k in range(len(shape)))]
    left = sorted(space)
    array = array.transpose([left.index(k) for k in space])
    if len(space) == 2:
        return array[None], [None, *space]
    return array, list(space)


def _attributes(path: Path, where: str) -> dict | None:
    """Attributes of a group; None for an array."""
    try:
        if (path / "zarr.json").exists():
            root = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
            attributes = root.get("attributes", {}) if root["node_type"] == "group" else None
        elif (path / ".zarray").exists():
            attributes = None
        elif (path / ".zattrs").exists():
            attributes = json.loads((path / ".zattrs").read_text(encoding="utf-8"))
        else:
            attributes = {}
        if (
            attributes is None
            or isinstance(attributes, dict)
            and isinstance(attributes.get("ome", {}), dict)
        ):
            return attributes
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise VolumeError(where, "damaged Zarr metadata", "a Zarr array or an OME-Zarr image")


def _array(path: Path, where: str) -> Any:
    from clvol.store.arrays import open_array, system_words

    driver = "zarr3" if (path / "zarr.json").exists() else "zarr"
    try:
        return open_array(path, driver=driver, whole=False)
    except ValueError as error:
        raise VolumeError(
            where, f"array {path.name!r}: {system_words(str(error))}", "a Zarr array"
        ) from None


def _stem(path: Path) -> str:
    name = path.resolve().name
    return name[: -len(".zarr")] if name.lower().endswith(".zarr") else name
