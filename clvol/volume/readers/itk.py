"""What the readers that use SimpleITK share: header, type and geometry without the voxels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.volume.grid import Grid
from clvol.volume.readers.quiet import quiet_native
from clvol.volume.volume import ACCEPTED


def read_information(path: Path | str, image_io: str) -> Any:
    """A SimpleITK ImageFileReader that has read the file's header and no voxel."""
    import SimpleITK

    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    reader = SimpleITK.ImageFileReader()
    reader.SetImageIO(image_io)
    reader.SetFileName(str(path))
    with quiet_native():
        reader.ReadImageInformation()
    return reader


def itk_type(reader: Any, where: str, accepted: tuple[str, ...] | None = None) -> np.dtype:
    """The numpy type of the reader's scalar pixels; VolumeError if it is none of ``accepted``.

    Without ``accepted``, the types that volumes may have.
    """
    import SimpleITK

    types = {
        SimpleITK.sitkUInt8: "uint8",
        SimpleITK.sitkInt8: "int8",
        SimpleITK.sitkUInt16: "uint16",
        SimpleITK.sitkInt16: "int16",
        SimpleITK.sitkFloat32: "float32",
        SimpleITK.sitkFloat64: "float64",
        SimpleITK.sitkUInt32: "uint32",
        SimpleITK.sitkInt32: "int32",
    }
    name = types.get(reader.GetPixelID())
    narrow = accepted or tuple(n for n in types.values() if n not in ("uint32", "int32"))
    if name not in narrow:
        text = SimpleITK.GetPixelIDValueAsString(reader.GetPixelID())
        raise VolumeError(where, f"voxels of type {text}", ACCEPTED)
    return np.dtype(name)


def itk_grid(reader: Any, shape: tuple[int, int, int]) -> Grid:
    """The grid of the reader's 3-D image; a negative spacing becomes a flip of the direction."""
    direction = np.array(reader.GetDirection(), dtype=np.float64).reshape(3, 3)
    return Grid.from_steps(shape, direction * np.array(reader.GetSpacing()), reader.GetOrigin())
