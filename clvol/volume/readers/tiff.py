"""TIFF stacks: .tif, .tiff, one page a slice, read by tifffile."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.memory import check_memory
from clvol.volume.readers.options import ReadOptions
from clvol.volume.readers.quiet import errors_logged
from clvol.volume.volume import Volume, check_type

# tifffile's letters for an axis of slices: depth, a plain sequence of pages, unknown.
_SLICE_AXES = ("ZYX", "IYX", "QYX", "YX")


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a TIFF file, page k at z index k, a single page as one slice.

    Spacing: OME's PhysicalSize; an ImageJ stack's resolution and ``spacing``; both in the file's
    unit. Else the resolution tags (in mm where they have a unit), with pages as far apart as
    columns, since plain TIFF cannot say; else 1. Compressions other than deflate need the package
    imagecodecs.
    """
    import tifffile

    # A chain of pages that breaks off is only logged; the pages after it would be cropped.
    with errors_logged("tifffile") as errors, tifffile.TiffFile(path) as file:
        if len(file.series) != 1:
            shapes = ", ".join(str(series.shape) for series in file.series[:4])
            raise VolumeError(
                str(path), f"{len(file.series)} images of different kinds ({shapes})", "one stack"
            )
        series = file.series[0]
        axes = series.axes
        if axes not in _SLICE_AXES:
            raise VolumeError(
                str(path),
                f"axes {axes}, sizes {' '.join(map(str, series.shape))}",
                "a stack ZYX of scalars (S or C: colour channels, T: time)",
            )
        shape = series.shape if len(series.shape) == 3 else (1, *series.shape)
        dtype = check_type(np.dtype(series.dtype), str(path))
        nbytes = math.prod(shape) * dtype.itemsize
        check_memory(str(path), nbytes, options.memory_cap)
        _check_segments(path, series, nbytes)
        data = series.asarray(maxworkers=1).reshape(shape)
        spacing = _spacing(file)
        if errors:
            raise VolumeError(str(path), f"damaged: {errors[0]}", "an undamaged TIFF file")
    return Volume(data, spacing, frame="image")


def _check_segments(path: Path, series: Any, nbytes: int) -> None:
    """Every byte that the page directories promise must be in the file."""
    stored = path.stat().st_size
    if series.dataoffset is not None:  # all pages in one run
        end, promised = series.dataoffset + nbytes, nbytes
    else:
        end = promised = 0
        for page in series.pages:
            if page is None:
                raise VolumeError(str(path), "a page is missing", "a whole stack")
            segments = list(zip(page.dataoffsets, page.databytecounts))
            end = max([end, *(offset + count for offset, count in segments)])
            promised += sum(count for _, count in segments)
        if series.keyframe.compression != 1:
            promised = nbytes
    if end > stored or promised < nbytes:
        raise VolumeError(
            str(path),
            f"voxel data cut off ({stored} bytes in the file)",
            f"{max(end, nbytes)} bytes as its pages promise",
        )


def _spacing(file: Any) -> tuple[float, float, float]:
    page = file.pages[0]
    ome = _ome_spacing(file.ome_metadata) if file.is_ome else None
    if ome is not None:
        return ome
    tags = page.tags
    pixels = [_pixel_size(tags, name) for name in ("XResolution", "YResolution")]
    if file.is_imagej:
        depth = float((file.imagej_metadata or {}).get("spacing", 1.0))
        return pixels[0] or 1.0, pixels[1] or 1.0, depth
    if None in pixels:
        return 1.0, 1.0, 1.0
    unit = tags["ResolutionUnit"].value if "ResolutionUnit" in tags else 2
    scale = {2: 25.4, 3: 10.0}.get(int(unit), 1.0)
    return pixels[0] * scale, pixels[1] * scale, pixels[0] * scale


def _pixel_size(tags: Any, name: str) -> float | None:
    """Resolution units per pixel, or None where the tag is missing or says nothing."""
    if name not in tags:
        return None
    pixels, units = tags[name].value
    return units / pixels if pixels > 0 and units > 0 else None


def _ome_spacing(text: str | None) -> tuple[float, float, float] | None:
    """PhysicalSizeX, Y, Z of the first image in the file's unit; None if there is no X."""
    from xml.etree import ElementTree

    pixels = next(
        (node for node in ElementTree.fromstring(text or "<x/>").iter() if _is_pixels(node)), None
    )
    if pixels is None or "PhysicalSizeX" not in pixels.attrib:
        return None
    x, y, z = (float(pixels.get(f"PhysicalSize{axis}", "1")) for axis in "XYZ")
    return x, y, z


def _is_pixels(node: Any) -> bool:
    return node.tag.rpartition("}")[2] == "Pixels"
