"""Zarr folders that are not clvol stores: finding the array that is the image, and its axes.

These are OME-Zarr images (0.1 to 0.5), arrays whose dimensions have names (``dimension_names`` in Zarr v3,
``_ARRAY_DIMENSIONS`` as written by xarray), and arrays without either, which are [z, y, x].
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.options import Displayed, Key, ReadOptions, named_axes
from clvol.readers.remote import Place
from clvol.readers.zarr_blosc import check_blosc
from clvol.store.arrays import open_array, system_words
from clvol.store.format import CODES_OF
from clvol.volume.array_axes import AXES, Axis, Placed, place_axes
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.units import one_unit

_LARGEST_METADATA = 64 << 20
_EVEN = 1e-3  # tolerance of coordinates, as a share of a step


@dataclass(frozen=True, eq=False)
class Image:
    """``array`` is a tensorstore array [z, y, x]; ``labels``: OME-Zarr's metadata say that it holds labels."""

    array: Any
    grid: Grid
    name: str | None
    frame: str
    unit: str | None
    labels: bool = False


def find_image(path: Place, options: ReadOptions) -> Image:
    """The image in a Zarr folder; of a multiscale image, the finest level."""
    where = str(path)
    node = read_node(path, where)
    if CODES_OF in node.attributes:
        what = "a level of a clvol store, which holds codes of blocks and no samples"
        raise VolumeError(where, what, "the folder of the store")
    if node.is_array:
        return _plain(path, path, node, options)
    attributes = node.attributes.get("ome", node.attributes)
    multiscales = attributes.get("multiscales")
    if isinstance(multiscales, list) and multiscales:
        names = [_text(one, "name") for one in multiscales]
        chosen = options.choose("series", where, names) if len(names) > 1 else 0
        return _multiscale(path, attributes, multiscales[chosen], options)
    if "plate" in attributes:
        raise VolumeError(where, "a plate of many images", "one of them, such as the folder A/1/0")
    return _member(path, options)


# ---- nodes ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Node:
    """``dimensions`` are the names of an array's axes, or None."""

    is_array: bool
    attributes: dict
    dimensions: list[str | None] | None = None


def read_node(path: Place, where: str) -> Node:
    """The metadata of a group or an array, of Zarr v3 or v2."""
    try:
        if (path / "zarr.json").exists():
            root = _json(path / "zarr.json")
            attributes = root.get("attributes") or {}
            names = root.get("dimension_names")
            is_array = root["node_type"] == "array"
        else:
            is_array = (path / ".zarray").exists()
            attributes = _json(path / ".zattrs") if (path / ".zattrs").exists() else {}
            names = None
        names = names or attributes.get("_ARRAY_DIMENSIONS")
        if isinstance(attributes.get("ome", {}), dict):
            return Node(is_array, attributes, list(names) if is_array and names else None)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        pass
    raise VolumeError(where, "damaged Zarr metadata", "a Zarr array or an OME-Zarr image")


def _json(path: Place) -> dict:
    if path.stat().st_size > _LARGEST_METADATA:
        raise ValueError("too long")
    return json.loads(path.read_text(encoding="utf-8"))


def _text(table: Any, key: str) -> str | None:
    value = table.get(key) if isinstance(table, dict) else None
    return str(value) if value else None


def _is_node(path: Place) -> bool:
    return any((path / name).is_file() for name in ("zarr.json", ".zarray", ".zgroup"))


def _member(path: Place, options: ReadOptions) -> Image:
    """The image or array in a group that is not an image itself: bioformats2raw numbers its images, xarray stores
    coordinates beside the array.
    """
    where = str(path)
    found: dict[str, Node] = {}
    children = sorted((child for child in path.iterdir() if child.is_dir() and _is_node(child)), key=str)
    for child in children:
        node = read_node(child, where)
        is_image = bool(node.attributes.get("ome", node.attributes).get("multiscales"))
        if is_image or node.is_array and _array(child, where).rank >= 2:
            found[child.name] = node
    if not found:
        raise VolumeError(
            where, "a Zarr group without multiscales", "an OME-Zarr image or one array"
        )
    names = list(found)
    numbered = all(name.isdecimal() for name in names)
    numbers = [int(name) for name in names] if numbered else None
    shown = None if numbered else [f'"{name}"' for name in names]
    if numbered:
        shown = [_image_name(found[name]) for name in names]
    chosen = options.choose("series", where, names, numbers=numbers, shown=shown)
    node = found[names[chosen]]
    if node.is_array:
        return _plain(path, path / names[chosen], node, options)
    return find_image(path / names[chosen], options)


def _image_name(node: Node) -> str:
    multiscales = node.attributes.get("ome", node.attributes).get("multiscales")
    first = multiscales[0] if isinstance(multiscales, list) and multiscales else None
    name = _text(first, "name")
    return f'"{name}"' if name else ""


# ---- arrays --------------------------------------------------------------------------------------


def _array(path: Place, where: str) -> Any:
    driver = "zarr3" if (path / "zarr.json").exists() else "zarr"
    try:
        return open_array(path, driver=driver, whole=False)
    except ValueError as error:
        raise VolumeError(
            where, f"array {path.name!r}: {system_words(str(error))}", "a Zarr array"
        ) from None


def _checked(path: Place, where: str, options: ReadOptions) -> Any:
    """The array in a folder, after checking that its decoded chunks, which may be larger than it, fit into memory."""
    array = _array(path, where)
    chunk = array.chunk_layout.read_chunk.shape or array.shape
    nbytes = math.prod(int(n) for n in chunk) * array.dtype.numpy_dtype.itemsize
    try:
        check_memory(where, nbytes, options.memory_cap)
    except VolumeError as error:
        sizes = " x ".join(map(str, chunk))
        what = error.what.replace("the volume needs", f"a chunk of {sizes} needs")
        raise VolumeError(where, what, error.expected) from None
    check_blosc(path, where, nbytes, options.memory_cap)
    return array


def _plain(group: Place, path: Place, node: Node, options: ReadOptions) -> Image:
    """An array without OME metadata. Coordinates stored beside it, as xarray writes them, give its grid."""
    where = str(group)
    array = _checked(path, where, options)
    names = node.dimensions or [None] * array.rank
    if len(names) != array.rank:
        raise VolumeError(
            where, f"{len(names)} names for {array.rank} axes", "a name for each axis"
        )
    placed = place_axes(named_axes(names, options), array.shape, where)
    array = _picked(array, placed, [], where, options)
    scale, shift = [1.0] * 3, [0.0] * 3
    units: list[str | None] = [None] * 3
    if group != path:
        for i, k in enumerate(placed.space):
            name = None if k is None else names[k]
            if name and _is_node(group / name):
                scale[i], shift[i], units[i] = _coordinates(
                    group / name, name, array.shape[i], where, options
                )
    grid, unit = _grid(array.shape, scale, shift, units, options)
    known = any(units) or scale != [1.0] * 3
    return Image(array, grid, _stem(group), "image" if known else "index", unit)


def _coordinates(
    path: Place, name: str, count: int, where: str, options: ReadOptions
) -> tuple[float, float, str | None]:
    """Step, first position and unit of an axis's coordinates, if they are evenly spaced."""
    node = read_node(path, where)
    array = _checked(path, where, options)
    if not node.is_array or tuple(array.shape) != (count,) or count < 2:
        return 1.0, 0.0, None
    if array.dtype.numpy_dtype.kind not in "iuf":
        return 1.0, 0.0, None
    values = np.asarray(array.read().result(), np.float64)
    step = float(values[-1] - values[0]) / (count - 1)
    off = np.abs(values - (values[0] + step * np.arange(count))).max()
    if not np.isfinite(off) or step == 0.0 or off > _EVEN * abs(step):
        options.warn(f"coordinates along {name} are not evenly spaced and are not used")
        return 1.0, 0.0, None
    return step, float(values[0]), _text(node.attributes, "units")


def _picked(
    array: Any, placed: Placed, channels: list[tuple[str | None, Displayed]], where: str, options: ReadOptions
) -> Any:
    """``array`` as [z, y, x] of the selected channel and time."""
    pick: list[Any] = [slice(None) if k in placed.space else 0 for k in range(array.rank)]
    chosen: tuple[tuple[Key, int | None], ...] = (("channel", placed.channel), ("time", placed.time))
    for key, axis in chosen:
        if axis is None:
            continue
        count = array.shape[axis]
        said = channels if key == "channel" and len(channels) == count else [(None, Displayed())] * count
        names, displayed = zip(*said)
        pick[axis] = options.choose(key, where, names, displayed=displayed)
    array = array[tuple(pick)]
    left = sorted(k for k in placed.space if k is not None)
    array = array.transpose([left.index(k) for k in placed.space if k is not None])
    return array[None] if placed.space[0] is None else array


def _grid(
    shape: tuple[int, ...],
    scale: list[float],
    shift: list[float],
    units: list[str | None],
    options: ReadOptions,
) -> tuple[Grid, str | None]:
    """The grid and its unit; ``scale``, ``shift`` and ``units`` are along z, y, x."""
    factors, unit, wrong = one_unit(units[::-1], [n > 1 for n in shape[::-1]])
    if wrong:
        options.warn(wrong)
    steps = np.array(scale[::-1]) * factors
    origin = np.array(shift[::-1]) * factors
    return Grid.from_steps(tuple(shape), np.diag(steps), origin.tolist()), unit


# ---- OME-Zarr ------------------------------------------------------------------------------------


def _multiscale(path: Place, attributes: dict, multiscale: dict, options: ReadOptions) -> Image:
    where = str(path)
    try:
        dataset = multiscale["datasets"][0]
        place = str(dataset["path"])
        axes = [_axis(axis) for axis in multiscale.get("axes") or ()]
        scale, shift = _transformation([dataset, multiscale])
        channels = _channels(attributes)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise VolumeError(where, f"damaged multiscales ({error})", "OME-Zarr metadata") from None
    folder = path.joinpath(*(part for part in place.split("/") if part not in ("", ".", "..")))
    array = _checked(folder, where, options)
    rank = array.rank
    if not axes:  # before version 0.3 all images had five axes
        axes = [Axis(name) for name in (AXES if rank == len(AXES) else [None] * rank)]
    if len(axes) != rank:
        raise VolumeError(where, f"{len(axes)} axes for an array of {rank}", "OME-Zarr metadata")
    scale = np.ones(rank) if scale is None else scale
    shift = np.zeros(rank) if shift is None else shift
    if scale.shape != (rank,) or shift.shape != (rank,):
        raise VolumeError(
            where, f"a transformation that is not of {rank} axes", "OME-Zarr metadata"
        )
    placed = place_axes(axes, array.shape, where)
    array = _picked(array, placed, channels, where, options)
    grid, unit = _grid(
        array.shape,
        [1.0 if k is None else float(scale[k]) for k in placed.space],
        [0.0 if k is None else float(shift[k]) for k in placed.space],
        [None if k is None else axes[k].unit for k in placed.space],
        options,
    )
    labels = "image-label" in attributes
    return Image(array, grid, _text(multiscale, "name") or _stem(path), "image", unit, labels)


def _axis(said: Any) -> Axis:
    if not isinstance(said, dict):
        return Axis(str(said))
    return Axis(str(said["name"]), _text(said, "type"), _text(said, "unit"))


def _channels(attributes: dict) -> list[tuple[str | None, Displayed]]:
    """Label of each channel, and how it is displayed."""
    omero = attributes.get("omero")
    channels = omero.get("channels") if isinstance(omero, dict) else None
    return [(_text(one, "label"), _displayed(one)) for one in channels] if isinstance(channels, list) else []


def _displayed(said: Any) -> Displayed:
    """Colour ("RRGGBB") and window (start, end) of a channel in "omero"."""
    said = said if isinstance(said, dict) else {}
    color, window = str(said.get("color") or ""), said.get("window")
    channels, ends = None, None
    if re.fullmatch("[0-9a-fA-F]{6}", color):
        red, green, blue = (round(int(color[k : k + 2], 16) / 255.0, 4) for k in (0, 2, 4))
        channels = red, green, blue
    if isinstance(window, dict):
        low, high = window.get("start"), window.get("end")
        if isinstance(low, (int, float)) and isinstance(high, (int, float)) and -1e30 < low < high < 1e30:
            ends = float(low), float(high)
    return Displayed(channels, ends)


def _transformation(parts: list[dict]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Scale and translation of all transformations, applied in order."""
    scale = shift = None
    for part in parts:
        for step in part.get("coordinateTransformations") or ():
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


def _stem(path: Place) -> str:
    name = path.resolve().name
    return name[: -len(".zarr")] if name.lower().endswith(".zarr") else name
