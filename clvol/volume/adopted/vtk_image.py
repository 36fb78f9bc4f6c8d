"""vtkImageData and its relatives in pyvista (ImageData): scalars at points, or of cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from clvol.volume.adopted.facts import Adopted, name_of, refused
from clvol.volume.grid import Grid


def adopt_vtk(value: Any) -> Adopted:
    """The active scalars of an image, or its only array. Voxels are points; of cell data, the centres of cells.

    The array is shared with the image.
    """
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if not all(hasattr(value, name) for name in ("GetPointData", "GetSpacing", "GetDirectionMatrix")):
        raise refused(f"a {name_of(value)}", "a vtkImageData; vtkResampleToImage makes one of another data set")
    points = np.array(value.GetDimensions())
    scalars, is_cells = _scalars(value)
    if scalars.GetNumberOfComponents() != 1:
        count = scalars.GetNumberOfComponents()
        raise refused(f"{count} components in {scalars.GetName()!r}", "one component per voxel")
    size = np.maximum(points - 1, 1) if is_cells else points
    array = vtk_to_numpy(scalars)
    if array.size != size.prod() or not array.size:
        raise refused(f"{array.size} values for {' x '.join(map(str, size))} voxels", "one value per voxel")
    matrix = value.GetDirectionMatrix()
    direction = np.array([[matrix.GetElement(i, j) for j in range(3)] for i in range(3)])
    steps = direction * np.array(value.GetSpacing())
    first = np.array(value.GetExtent()[::2], float) + (0.5 * (points > 1) if is_cells else 0.0)
    grid = Grid.from_steps(tuple(int(n) for n in size[::-1]), steps, np.array(value.GetOrigin()) + steps @ first)
    return Adopted(array.reshape(tuple(size[::-1])), grid, name=scalars.GetName())


def _scalars(value: Any) -> tuple[Any, bool]:
    """The array of scalars, and whether it belongs to cells."""
    both = ((value.GetPointData(), False), (value.GetCellData(), True))
    for data, is_cells in both:
        if data.GetScalars() is not None:
            return data.GetScalars(), is_cells
    found = [(data.GetArray(i), cells) for data, cells in both for i in range(data.GetNumberOfArrays())]
    if len(found) == 1 and found[0][0] is not None:
        return found[0]
    names = ", ".join(repr(array.GetName()) for array, _ in found if array is not None) or "none"
    raise refused(f"no active scalars (arrays: {names})", "x.GetPointData().SetActiveScalars(name)")
