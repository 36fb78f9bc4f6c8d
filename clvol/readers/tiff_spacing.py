"""The spacing of the voxels of a TIFF file and its unit: OME metadata, ImageJ metadata or plain tags."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from clvol.readers.options import Displayed, ReadOptions
from clvol.volume.units import one_unit

_TAG_UNITS = {2: "inch", 3: "cm"}
_NOT_MEASURED = 1.0 / 72  # inches: the default that programs write without a known resolution


@dataclass(frozen=True)
class Spacing:
    """``lengths`` along x, y, z in ``unit``, which is None if it is unknown."""

    lengths: tuple[float, float, float]
    unit: str | None


def spacing_of(file: Any, series: Any, slices: int, options: ReadOptions) -> Spacing:
    """The spacing of a tifffile series of ``slices`` slices. All axes are in the unit of x."""
    if file.is_ome:
        found = _ome(ome_image(file, series), slices, options)
        if found is not None:
            return found
    if file.is_imagej:
        return _imagej(file, slices, options)
    return _plain(file, series)


def ome_image(file: Any, series: Any) -> Any | None:
    """The OME element Image that belongs to the series; None if there is none."""
    images = [node for node in _xml(file.ome_metadata).iter() if _named(node, "Image")]
    index = next((k for k, other in enumerate(file.series) if other is series), 0)
    return images[index] if index < len(images) else None


def ome_channels(image: Any | None) -> list[str | None]:
    """The names of an OME image's channels."""
    nodes = [] if image is None else [node for node in image.iter() if _named(node, "Channel")]
    return [node.get("Name") or node.get("Fluor") for node in nodes]


def ome_colors(image: Any | None) -> list[Displayed]:
    """The colours of an OME image's channels (Color: red, green, blue and alpha as the bytes of a signed integer);
    white says nothing, since it is the default."""
    nodes = [] if image is None else [node for node in image.iter() if _named(node, "Channel")]
    found = []
    for node in nodes:
        try:
            packed = int(node.get("Color", "-1")) & 0xFFFFFFFF
        except ValueError:
            packed = 0xFFFFFFFF
        red, green, blue = (round((packed >> shift & 0xFF) / 255.0, 4) for shift in (24, 16, 8))
        plain = red == green == blue
        found.append(Displayed(None if plain else (red, green, blue)))
    return found


def _xml(text: str | None) -> Any:
    try:
        return ElementTree.fromstring(text or "<none/>")
    except ElementTree.ParseError:
        return ElementTree.Element("none")


def _named(node: Any, name: str) -> bool:
    return node.tag.rpartition("}")[2] == name


def _ome(image: Any | None, slices: int, options: ReadOptions) -> Spacing | None:
    """PhysicalSizeX, Y and Z, each with its unit, by default micrometres."""
    pixels = None if image is None else next((n for n in image.iter() if _named(n, "Pixels")), None)
    if pixels is None:
        return None
    sizes = [_length(pixels.get(f"PhysicalSize{axis}")) for axis in "XYZ"]
    units = [pixels.get(f"PhysicalSize{axis}Unit") or "µm" for axis in "XYZ"]
    if sizes[0] is None and sizes[1] is None and sizes[2] is None:
        return None
    return _together(sizes, units, slices, options, "PhysicalSize")


def _together(
    sizes: Sequence[float | None],
    units: Sequence[str | None],
    slices: int,
    options: ReadOptions,
    name: str,
) -> Spacing:
    """The spacing in one unit. Missing lengths are taken from another axis, with a warning."""
    known, length = next((k, size) for k, size in enumerate(sizes) if size is not None)
    for k, axis in enumerate("XYZ"):
        if sizes[k] is None and (k < 2 or slices > 1):
            options.warn(f"no {name}{axis}, so it is taken to be that along {'XYZ'[known]}")
    units = [units[known] if size is None else unit for size, unit in zip(sizes, units)]
    factors, unit, wrong = one_unit(units, [True, True, slices > 1])
    if wrong:
        options.warn(wrong)
    x, y, z = ((length if size is None else size) * factor for size, factor in zip(sizes, factors))
    return Spacing((x, y, z), unit)


def _imagej(file: Any, slices: int, options: ReadOptions) -> Spacing:
    """The spacing of ImageJ: ``unit`` (for y and z also ``yunit`` and ``zunit``) applies to the resolution and to
    ``spacing``; without it, the unit of the resolution tags does.
    """
    facts = file.imagej_metadata or {}
    tags = file.pages[0].tags
    sizes = [pixel_size(tags, name) for name in ("XResolution", "YResolution")]
    unit = str(facts.get("unit") or "").strip()
    if not unit:
        unit = _TAG_UNITS.get(_tag_unit(tags, 1), "")
        if unit == "inch" and sizes[0] and math.isclose(sizes[0], _NOT_MEASURED):
            sizes, unit = [None, None], ""
    depth = _length(facts.get("spacing"))
    units = [unit, *(str(facts.get(f"{axis}unit") or unit) for axis in "yz")]
    lengths = [sizes[0] or 1.0, sizes[1] or 1.0, 1.0 if depth is None else depth]
    return _together(lengths, units, slices, options, "spacing")


def _plain(file: Any, series: Any) -> Spacing:
    """The resolution tags, in mm where they have a unit. Slices are as far apart as columns, since plain TIFF cannot
    say more.
    """
    tags = series.keyframe.tags if series is not None else file.pages[0].tags
    x, y = (pixel_size(tags, name) for name in ("XResolution", "YResolution"))
    if x is None or y is None:
        return Spacing((1.0, 1.0, 1.0), None)
    unit = _TAG_UNITS.get(_tag_unit(tags, 2))
    scale = {"inch": 25.4, "cm": 10.0, None: 1.0}[unit]
    return Spacing((x * scale, y * scale, x * scale), "mm" if unit else None)


def _tag_unit(tags: Any, default: int) -> int:
    return int(tags["ResolutionUnit"].value) if "ResolutionUnit" in tags else default


def pixel_size(tags: Any, name: str) -> float | None:
    """Resolution units per pixel; None if the tag is missing or empty."""
    if name not in tags:
        return None
    pixels, units = tags[name].value
    return units / pixels if pixels > 0 and units > 0 else None


def _length(value: Any) -> float | None:
    """A positive, finite length, or None."""
    try:
        number = abs(float(value))
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) and number > 0 else None
