"""TIFF, BigTIFF, OME-TIFF and ImageJ stacks: .tif, .tiff, read by tifffile."""

from __future__ import annotations

import math
import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.options import Key, ReadOptions
from clvol.readers.quiet import errors_logged
from clvol.readers.stream_size import LOOKED_AT, j2k_size, jpeg_size
from clvol.readers.tiff_chain import check_chain
from clvol.readers.tiff_spacing import ome_channels, ome_colors, ome_image, spacing_of
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume, check_type

# tifffile's letters for axes: samples (colours) and wavelengths are channels, too.
_CHANNELS, _TIMES = "CSE", "T"
_CHOSEN: tuple[tuple[Key, str], ...] = (("channel", _CHANNELS), ("time", _TIMES))
_PLAIN_SLICES = "IQ"  # a sequence of pages, and an unnamed axis
_COLOURS = ("red", "green", "blue", "alpha")
_RGB, _PALETTE, _YCBCR = 2, 3, 6
# Compressions that are decoded into a buffer of the size in the page directory.
_BOUNDED = (1, 5, 8, 32773, 32946, 34925, 34926, 50000)
_JPEGS, _J2KS = (6, 7, 33007), (33003, 33004, 33005, 34712)
_REDUCED = 1  # NewSubfileType: a thumbnail or another resolution


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a TIFF file, page k at z index k; a single page is one slice.

    ``options`` select channels, times and separate images; images that are single pages of one size are the slices of
    one stack. Spacing comes from OME's PhysicalSize or from ImageJ's resolution and ``spacing``, in the unit of x.
    Otherwise it comes from the resolution tags (in mm where they have a unit), with pages as far apart as columns,
    since plain TIFF cannot say more; without them it is 1.
    """
    import tifffile

    check_chain(path, str(path))
    # tifffile only logs a broken chain of pages; the pages after the break would be missing.
    with errors_logged("tifffile") as errors, tifffile.TiffFile(path) as file:
        stack = _single_pages(file, options)
        if stack is None:
            names = [_series_name(series) for series in _full_size(file)]
            shown = [_series_shown(series) for series in _full_size(file)]
            chosen = _full_size(file)[options.choose("series", str(path), names, shown=shown)]
            data = _chosen(path, file, chosen, options)
        else:
            chosen = stack[0]
            data = _stacked(path, stack, options)
        spacing = spacing_of(file, chosen, data.shape[0], options)
        if errors:
            raise VolumeError(str(path), f"damaged: {errors[0]}", "an undamaged TIFF file")
        beside = _other_files(file, chosen)
    volume = Volume(data, spacing.lengths, frame="image", unit=spacing.unit)
    volume.files = beside
    return volume


def _other_files(file: Any, series: Any) -> tuple[str, ...]:
    """The other files that hold pages of an OME-TIFF."""
    if not series.is_multifile:
        return ()
    own = file.filehandle.path
    paths = {page.parent.filehandle.path for page in series.pages if page is not None}
    return tuple(sorted(paths - {own}))


def _full_size(file: Any) -> list[Any]:
    """The file's series without thumbnails, unless there are only thumbnails."""
    reduced = [bool(int(series.keyframe.subfiletype) & _REDUCED) for series in file.series]
    full = [series for series, small in zip(file.series, reduced) if not small]
    return full or list(file.series)


def _single_pages(file: Any, options: ReadOptions) -> list[Any] | None:
    """The series, if each is one page of scalars of the same size and type: a stack written page by page."""
    all_series = _full_size(file)
    first = all_series[0]
    if len(all_series) == 1 or options.series is not None:
        return None
    for series in all_series:
        alike = series.shape == first.shape and series.dtype == first.dtype
        if not alike or series.axes != "YX" or len(series.pages) != 1:
            return None
    # Images that OME names separately are not slices of one stack.
    names = {re.sub(r"\d+", "#", series.name or "") for series in all_series}
    return all_series if len(names) == 1 or not file.is_ome else None


def _series_name(series: Any) -> str | None:
    return series.name or None


def _series_shown(series: Any) -> str:
    name = f'"{series.name}" ' if series.name else ""
    return f"{name}({' x '.join(map(str, series.shape))}, {series.axes})"


# ---- the axes of a series ------------------------------------------------------------------------


def _chosen(path: Path, file: Any, series: Any, options: ReadOptions) -> np.ndarray:
    """The stack [z, y, x] of the selected channel and time."""
    axes, shape = series.axes, series.shape
    depth = _depth_axis(axes, shape)
    kept = [k for k in (depth, axes.find("Y"), axes.find("X")) if k is not None]
    others = [k for k in range(len(axes)) if k not in kept and shape[k] != 1]
    strange = [k for k in others if axes[k] not in _CHANNELS + _TIMES]
    if -1 in kept or strange or depth is None and axes.count("Q") > 1:
        raise VolumeError(
            str(path),
            f"axes {axes}, sizes {' '.join(map(str, shape))}",
            "a stack ZYX, and channels C, S or times T to choose from",
        )
    pick: list[Any] = [slice(None) if k in kept else 0 for k in range(len(axes))]
    for key, letters in _CHOSEN:
        mine = [k for k in others if axes[k] in letters]
        sizes = [shape[k] for k in mine]
        names = _names(file, series, [axes[k] for k in mine], sizes)
        if mine or getattr(options, key) is not None:
            shown = ome_colors(ome_image(file, series)) if key == "channel" and file.is_ome else []
            index = options.choose(key, str(path), names, displayed=shown if len(shown) == len(names) else ())
            for k, position in zip(mine, np.unravel_index(index, sizes or [1])):
                pick[k] = int(position)
    data = _picked(path, series, pick, options)
    left = [k for k in range(len(axes)) if k in kept]
    data = data.transpose([left.index(k) for k in kept])
    return data if depth is not None else data[None]


def _depth_axis(axes: str, shape: tuple[int, ...]) -> int | None:
    """The axis z, else the one unnamed axis of pages; None: a single slice."""
    if "Z" in axes:
        return axes.index("Z")
    plain = [k for k, letter in enumerate(axes) if letter in _PLAIN_SLICES and shape[k] != 1]
    return plain[0] if len(plain) == 1 else None


def _names(file: Any, series: Any, letters: list[str], sizes: list[int]) -> list[str | None]:
    """Names of the choices along axes of one kind, the last axis fastest."""
    count = math.prod(sizes)
    if letters == ["S"] and series.keyframe.photometric in (_RGB, _YCBCR):
        return list(_COLOURS[:count]) + [None] * (count - len(_COLOURS))
    if letters == ["C"] and file.is_ome:
        names = ome_channels(ome_image(file, series))
        if len(names) == count:
            return names
    return [None] * count


def single_page(file: Any) -> Any | None:
    """The only page of a file, if it is an image of scalars; else None."""
    pages = [page for page in file.pages if not int(page.subfiletype) & _REDUCED]
    if len(pages) != 1 or len(pages[0].shape) != 2 or pages[0].photometric == _PALETTE:
        return None
    return pages[0]


def read_page(path: Path, page: Any) -> np.ndarray:
    """The pixels [y, x] of a page; VolumeError if the file holds fewer."""
    _check_pages(path, [page], np.dtype(page.dtype).itemsize)
    return page.asarray(maxworkers=1)


# ---- pixels --------------------------------------------------------------------------------------


def _stacked(path: Path, stack: list[Any], options: ReadOptions) -> np.ndarray:
    """The single pages of several series, in order."""
    first = stack[0]
    data = _allocated(path, first, (len(stack), *first.shape), options)
    for k, series in enumerate(stack):
        _check_pages(path, [series.pages[0]], first.dtype.itemsize)
        data[k] = series.pages[0].asarray(maxworkers=1).reshape(first.shape)
    return data


def _picked(path: Path, series: Any, pick: list[Any], options: ReadOptions) -> np.ndarray:
    """``series[pick]``, reading only the pages that it needs."""
    shape = series.shape
    size = tuple(n for n, p in zip(shape, pick) if isinstance(p, slice))
    offset = series.dataoffset
    if offset is not None:  # all pages in one run
        data = _allocated(path, series, size, options)
        nbytes = math.prod(shape) * series.dtype.itemsize
        source = Path(series.keyframe.parent.filehandle.path)
        _check_end(path, source, offset + nbytes)
        stored = series.dtype.newbyteorder(series.keyframe.parent.byteorder)
        run = np.memmap(source, stored, "r", offset, shape)
        data[...] = run[tuple(pick)]
        return data
    leading = next(
        (k for k in range(len(shape)) if math.prod(shape[:k]) == len(series.pages)), None
    )
    if leading is None or math.prod(shape[leading:]) != math.prod(series.keyframe.shape):
        _allocated(path, series, shape, options)
        _check_pages(path, list(series.pages), series.dtype.itemsize)
        return series.asarray(maxworkers=1)[tuple(pick)]
    data = _allocated(path, series, size, options)
    order = np.arange(len(series.pages)).reshape(shape[:leading])[tuple(pick[:leading])]
    pages = [series.pages[int(k)] for k in order.reshape(-1)]
    _check_pages(path, pages, series.dtype.itemsize)
    rows = data.reshape(len(pages), *size[order.ndim :])
    for row, page in zip(rows, pages):
        row[...] = page.asarray(maxworkers=1).reshape(shape[leading:])[tuple(pick[leading:])]
    return data


def _allocated(
    path: Path, series: Any, shape: tuple[int, ...], options: ReadOptions
) -> np.ndarray:
    """An array for the voxels, after checking that they, a page and a tile fit into memory."""
    if series.dtype is None:
        raise VolumeError(str(path), "voxels of an unknown type", "whole or real numbers")
    if series.keyframe.photometric == _PALETTE:
        raise VolumeError(str(path), "palette colours", "one scalar per voxel")
    dtype = check_type(np.dtype(series.dtype), str(path))
    page = series.keyframe
    tile = 0
    if page.is_tiled:
        tile = page.tilewidth * page.tilelength * page.tiledepth
        if page.planarconfig == 1:
            tile *= page.samplesperpixel
    decoded = max(math.prod(shape), math.prod(page.shape), tile)
    check_memory(str(path), decoded * dtype.itemsize, options.memory_cap)
    return np.empty(shape, dtype)


def _check_pages(path: Path, pages: list[Any], itemsize: int) -> None:
    """VolumeError unless the file holds every byte that the page directories promise, and streams hold no more."""
    for page in pages:
        if page is None:
            raise VolumeError(str(path), "a page is missing", "a whole stack")
        _check_compression(path, page)
        segments = list(zip(page.dataoffsets, page.databytecounts))
        stored = Path(page.parent.filehandle.path).stat().st_size
        end = max((offset + count for offset, count in segments), default=0)
        promised = sum(count for _, count in segments)
        needed = _stored_bytes(page, itemsize)
        # Segments may share bytes; a sparse one stands for zeros.
        if end > stored or page.keyframe.compression == 1 and promised < needed:
            raise VolumeError(
                str(path),
                f"voxel data cut off ({stored} bytes in the file)",
                f"{max(end, needed)} bytes as its pages promise",
            )


def _stored_bytes(page: Any, itemsize: int) -> int:
    """The bytes of an uncompressed page in the file. Rows begin at whole bytes."""
    keyframe = page.keyframe
    bits = keyframe.bitspersample
    if isinstance(bits, int) and bits % 8:
        row = -(-keyframe.imagewidth * keyframe.samplesperpixel * bits // 8)
        return row * keyframe.imagelength * keyframe.imagedepth
    return math.prod(page.shape) * itemsize


def _check_compression(path: Path, page: Any) -> None:
    """VolumeError for streams that state a size larger than the page: they would be decoded whole, then cropped."""
    compression = int(page.keyframe.compression)
    if compression in _BOUNDED:
        return
    size_of = jpeg_size if compression in _JPEGS else j2k_size if compression in _J2KS else None
    if size_of is None:
        name = getattr(page.keyframe.compression, "name", compression)
        expected = "no compression, or LZW, Deflate, PackBits, Zstandard, LZMA, JPEG or JPEG 2000"
        raise VolumeError(str(path), f"pages compressed as {name}", expected)
    keyframe = page.keyframe
    most = (keyframe.imagelength, keyframe.imagewidth)
    if keyframe.is_tiled:
        most = (keyframe.tilelength, keyframe.tilewidth)
    for offset, count in zip(page.dataoffsets, page.databytecounts):
        with page.parent.filehandle.lock or nullcontext():
            page.parent.filehandle.seek(offset)
            size = size_of(page.parent.filehandle.read(min(count, LOOKED_AT)))
        if count and (size is None or size[0] > most[0] or size[1] > most[1]):
            raise VolumeError(
                str(path), f"a stream of {size} pixels in a segment of {most}", "streams that fit"
            )


def _check_end(path: Path, source: Path, end: int) -> None:
    stored = source.stat().st_size
    if end > stored:
        raise VolumeError(
            str(path),
            f"voxel data cut off ({stored} bytes in the file)",
            f"{end} bytes as its pages promise",
        )
