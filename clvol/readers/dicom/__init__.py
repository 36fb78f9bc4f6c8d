"""DICOM: the slices of one series in a folder, or one multi-frame file, read by pydicom.

``files`` finds the images of a folder, ``frames`` collects the properties of each slice, ``choice`` selects slices,
``order`` determines their positions, ``pixels`` reads their values.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from clvol.readers.dicom.choice import chosen_frames
from clvol.readers.dicom.files import find_images
from clvol.readers.dicom.order import in_order
from clvol.readers.dicom.pixels import read_frames
from clvol.readers.options import ReadOptions
from clvol.volume.grid import Grid
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume


def read(path: Path, options: ReadOptions) -> Volume:
    """The volume in a folder, or in one file; world coordinates are DICOM's (LPS, mm).

    Slices are ordered by position along their normal. The z axis runs from the first slice's position to the last
    one's, so a tilted gantry gives a sheared grid. Values are the stored numbers times each slice's rescale slope
    plus its intercept, regardless of display settings; their type is the smallest accepted one that holds all values
    exactly.

    ``options`` select one of several series, times or channels (echoes, b-values, kinds of image, segments). Reports,
    other objects that are not images, and localizers beside the slices are left out with a warning; rounded positions
    that are taken to be evenly spaced also cause one. VolumeError for colour, missing or doubled slices, and slices
    that differ in size or orientation.
    """
    frames = chosen_frames(path, find_images(path, options), options)
    frames, step = in_order(path, frames, options)
    first = frames[0]
    for text in first.lacks:
        options.warn(f"no {text}")
    shape = (len(frames), first.rows, first.columns)
    check_memory(str(path), math.prod(shape) * first.bits_allocated // 8, options.memory_cap)
    steps = np.stack([first.axes[0] * first.spacing[1], first.axes[1] * first.spacing[0], step], 1)
    grid = Grid.from_steps(shape, steps, np.asarray(first.position))
    data = read_frames(path, frames, options)
    return Volume(data, grid.spacing, grid.origin, grid.direction, frame="LPS", unit="mm")
