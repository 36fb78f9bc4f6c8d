"""A folder of TIFF slices, one image per file, in the natural order of file names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.options import ReadOptions
from clvol.readers.quiet import errors_logged
from clvol.readers.recognise import slice_files
from clvol.readers.slice_names import one_stack, warn_of_gaps
from clvol.readers.tiff import read as read_file
from clvol.readers.tiff import read_page, single_page
from clvol.readers.tiff_chain import check_chain
from clvol.readers.tiff_spacing import Spacing, spacing_of
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume, check_type

_NAMED = 3  # files that a message names


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume whose slices are the folder's TIFF files, the first one at z index 0.

    Files whose names differ in more than numbers belong to separate stacks, selected by ``options.series``; names may
    also count channels or times. The spacing is found as for a single TIFF file. VolumeError for slices of several
    sizes or types; missing numbers cause a warning.
    """
    files = one_stack(path, slice_files(path), options)
    if len(files) == 1:
        return read_file(files[0], options)
    facts = [_facts(path, file) for file in files]
    for what, values in (
        ("pixels", [fact.shape for fact in facts]),
        ("type", [fact.dtype.name for fact in facts]),
    ):
        _check_alike(path, files, values, what)
    warn_of_gaps(files, options)
    shape = (len(files), *facts[0].shape)
    dtype = check_type(facts[0].dtype, str(path))
    nbytes = int(np.prod(shape, dtype=object)) * dtype.itemsize
    check_memory(str(path), max(nbytes, facts[0].decoded), options.memory_cap)
    data = np.empty(shape, dtype)
    for plane, file in zip(data, files):
        plane[...] = _pixels(path, file).reshape(plane.shape)
    spacing = _spacing(path, files[0], options)
    return Volume(data, spacing.lengths, frame="image", unit=spacing.unit)


@dataclass(frozen=True)
class _Facts:
    shape: tuple[int, int]
    dtype: np.dtype
    decoded: int


def _facts(path: Path, file: Path) -> _Facts:
    with _opened(path, file) as tiff:
        page = single_page(tiff)
        if page is None:
            pages = len(tiff.pages)
            what = f"{file.name} holds {pages} images" if pages > 1 else f"{file.name} is in colour"
            raise VolumeError(str(path), what, "files of one slice of scalars each")
        tile = page.tilewidth * page.tilelength * page.tiledepth if page.is_tiled else 0
        decoded = max(page.size, tile) * page.dtype.itemsize
        return _Facts((page.imagelength, page.imagewidth), np.dtype(page.dtype), decoded)


def _pixels(path: Path, file: Path) -> np.ndarray:
    with _opened(path, file) as tiff:
        return read_page(file, single_page(tiff))


@contextmanager
def _opened(path: Path, file: Path) -> Iterator[Any]:
    """The file opened by tifffile. Errors name the file."""
    import tifffile

    try:
        check_chain(file, f"{file.name} in {path}")
        with errors_logged("tifffile"), tifffile.TiffFile(file) as tiff:
            yield tiff
    except (VolumeError, MemoryError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise VolumeError(
            str(path), f"{file.name} cannot be read ({reason})", "undamaged slices"
        ) from error


def _spacing(path: Path, file: Path, options: ReadOptions) -> Spacing:
    with _opened(path, file) as tiff:
        return spacing_of(tiff, tiff.series[0] if tiff.series else None, 2, options)


def _check_alike(path: Path, files: list[Path], values: Sequence[Hashable], what: str) -> None:
    """VolumeError that names the files that differ from the majority."""
    counts = Counter(values)
    usual, number = counts.most_common(1)[0]
    if number == len(files):
        return
    odd = [k for k, value in enumerate(values) if value != usual]
    shown = [f"{files[k].name} ({_show(values[k])})" for k in odd[:_NAMED]]
    more = f" and {len(odd) - _NAMED} more files" if len(odd) > _NAMED else ""
    raise VolumeError(
        str(path),
        f"{', '.join(shown)}{more} beside {number} slices of {what} {_show(usual)}",
        f"slices of one {'size' if what == 'pixels' else what}",
    )


def _show(value: Hashable) -> str:
    return " x ".join(map(str, reversed(value))) if isinstance(value, tuple) else str(value)
