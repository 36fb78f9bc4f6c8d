"""VTK's image data (.vti), through vtk (extra "vtk")."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from clvol.errors import VolumeError
from clvol.readers.extras import library
from clvol.readers.options import ReadOptions
from clvol.volume.memory import check_memory
from clvol.volume.volume import Volume

EXTRA = "vtk"


def read(path: Path, options: ReadOptions) -> Volume:
    """The array of an image: its scalars, or the only one; ``series`` names one of several, at points or of cells."""
    xml = library("vtkmodules.vtkIOXML", EXTRA, path)
    reader, failures = xml.vtkXMLImageDataReader(), []
    reader.AddObserver("ErrorEvent", lambda *_: failures.append(True))  # in place of printing
    reader.SetFileName(str(path))
    if not reader.CanReadFile(str(path)):
        raise VolumeError(str(path), "no image data of VTK in XML", "a .vti file with ImageData")
    reader.UpdateInformation()
    check_memory(str(path), path.stat().st_size, options.memory_cap)
    reader.Update()
    image = reader.GetOutput()
    if failures or image.GetNumberOfPoints() < 1:
        raise VolumeError(str(path), "damaged", "an undamaged .vti file")
    both = image.GetPointData(), image.GetCellData()
    arrays = [(data, i) for data in both for i in range(data.GetNumberOfArrays())]
    names = [data.GetArrayName(i) for data, i in arrays]
    if not names:
        raise VolumeError(str(path), "no array", "an array of scalars")
    data, i = arrays[_chosen(image, names, path, options)]
    other = image.GetCellData() if data is image.GetPointData() else image.GetPointData()
    other.SetActiveScalars(None)
    data.SetActiveScalars(data.GetArrayName(i))
    return Volume(image)


def _chosen(image: Any, names: list[str], path: Path, options: ReadOptions) -> int:
    active = image.GetPointData().GetScalars() or image.GetCellData().GetScalars()
    if options.series is None and active is not None and active.GetName() in names:
        options.consulted.add("series")
        return names.index(active.GetName())
    return options.choose("series", str(path), names)
