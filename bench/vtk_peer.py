"""VTK's CPU ray caster on one of our scenes: vtkFixedPointVolumeRayCastMapper.

It is set up to do just what the scene says: fixed sample distance, one ray a pixel, linear
interpolation, no shading, nothing adjusted to a frame rate.

There are two pictures of it, both linear and premultiplied: the rays' own, 15 bits a channel as the
mapper keeps it, and the window's, 8 bits a channel, into which OpenGL draws the first as a texture.
In the window, edges are softer: the texture is interpolated, up to half a pixel beside its place.
"""

from __future__ import annotations

import ctypes
import re
import time
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clvol.scene.resolve import ResolvedScene


def vtk_version() -> str | None:
    """None where vtk is not installed."""
    try:
        from vtkmodules.vtkCommonCore import vtkVersion
    except ImportError:
        return None
    return vtkVersion.GetVTKVersion()


class VtkPeer:
    """The scene in an off-screen window; ``threads`` is what the mapper may use."""

    def __init__(self, resolved: ResolvedScene, threads: int) -> None:
        import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (registers the OpenGL window)
        import vtkmodules.vtkRenderingVolumeOpenGL2  # noqa: F401  (draws the mapper's picture)
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonCore import vtkLogger
        from vtkmodules.vtkCommonDataModel import vtkImageData, vtkPiecewiseFunction
        from vtkmodules.vtkRenderingCore import (
            vtkColorTransferFunction,
            vtkRenderer,
            vtkRenderWindow,
            vtkVolume,
            vtkVolumeProperty,
        )
        from vtkmodules.vtkRenderingVolume import vtkFixedPointVolumeRayCastMapper

        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)  # it warns where there is no X
        volume, function = resolved.volume, resolved.transfer_function
        grid = volume.grid
        if np.any(grid.origin) or not np.array_equal(grid.direction, np.eye(3)):
            raise ValueError("a peer's volume has no origin and no direction")
        self._edge = grid.smallest_edge
        self._voxels = numpy_to_vtk(volume.data.ravel(), deep=True)
        image = vtkImageData()
        image.SetDimensions(*grid.size)
        image.SetSpacing(*grid.spacing)
        image.GetPointData().SetScalars(self._voxels)

        self.mapper = vtkFixedPointVolumeRayCastMapper()
        self.mapper.SetInputData(image)
        self.mapper.SetNumberOfThreads(threads)
        self.mapper.AutoAdjustSampleDistancesOff()
        self.mapper.LockSampleDistanceToInputSpacingOff()
        self.mapper.IntermixIntersectingGeometryOff()
        self.mapper.SetImageSampleDistance(1.0)

        opacity, color = vtkPiecewiseFunction(), vtkColorTransferFunction()
        for value, alpha, rgb in zip(function.values, function.opacities, function.colors):
            opacity.AddPoint(value, alpha)
            color.AddRGBPoint(value, *rgb)
        look = vtkVolumeProperty()
        look.SetScalarOpacity(opacity)
        look.SetColor(color)
        look.SetInterpolationTypeToLinear()
        look.ShadeOff()
        look.SetScalarOpacityUnitDistance(function.opacity_unit)
        self._actor = vtkVolume()
        self._actor.SetMapper(self.mapper)
        self._actor.SetProperty(look)

        self._renderer = vtkRenderer()
        self._renderer.SetBackground(0.0, 0.0, 0.0)
        self._renderer.SetBackgroundAlpha(0.0)
        self._renderer.AddVolume(self._actor)
        self.window = vtkRenderWindow()
        self.window.SetOffScreenRendering(True)
        self.window.SetMultiSamples(0)
        self.window.SetAlphaBitPlanes(True)
        self.window.SetSize(resolved.image.width, resolved.image.height)
        self.window.AddRenderer(self._renderer)

        view, asked = self._renderer.GetActiveCamera(), resolved.camera
        view.SetPosition(*asked.position)
        view.SetFocalPoint(*asked.target)
        view.SetViewUp(*asked.up)
        view.SetViewAngle(asked.fov_degrees)
        self._renderer.ResetCameraClippingRange()

    def render(self, step: float) -> tuple[float, float]:
        """Draws with samples every ``step`` smallest voxel edges.

        Returns wall seconds of the window's Render(), and the mapper's own seconds as VTK takes
        them (casting the rays and drawing their picture into the window).
        """
        self.mapper.SetSampleDistance(step * self._edge)
        start = time.perf_counter()
        self.window.Render()
        seconds = time.perf_counter() - start
        self.window.WaitForCompletion()  # OpenGL may still be drawing: nobody's time but its own
        return seconds, self.mapper.GetTimeToDraw()

    def render_empty(self) -> float:
        """Wall seconds of Render() without the volume: what a window costs anyway."""
        self._actor.VisibilityOff()
        start = time.perf_counter()
        self.window.Render()
        seconds = time.perf_counter() - start
        self.window.WaitForCompletion()
        self._actor.VisibilityOn()
        return seconds

    def ray_picture(self) -> np.ndarray:
        """What the mapper's rays gave: float64 [h, w, 4], linear, premultiplied, row 0 on top, in
        steps of 1/32767. Render first.

        VTK hands over the address of this picture and nothing else ("_<hex>_p_void").
        """
        cast = self.mapper.GetRayCastImage()
        match = re.fullmatch(r"_([0-9a-f]+)_p_\w+", cast.GetImage() or "")
        if match is None:
            raise RuntimeError(f"VTK gives its picture as {cast.GetImage()!r}, not as an address")
        row, rows = cast.GetImageMemorySize()
        width, height = cast.GetImageInUseSize()
        left, bottom = cast.GetImageOrigin()
        words = (ctypes.c_uint16 * (row * rows * 4)).from_address(int(match[1], 16))
        used = np.ctypeslib.as_array(words).reshape(rows, row, 4)[:height, :width]
        columns, lines = cast.GetImageViewportSize()
        picture = np.zeros((lines, columns, 4))
        picture[bottom : bottom + height, left : left + width] = used / 32767.0
        return picture[::-1]

    def window_picture(self) -> np.ndarray:
        """The window as float32 [h, w, 4], linear, premultiplied, row 0 on top. Render first."""
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter

        grab = vtkWindowToImageFilter()
        grab.SetInput(self.window)
        grab.SetInputBufferTypeToRGBA()
        grab.ReadFrontBufferOff()
        grab.ShouldRerenderOff()
        grab.Update()
        pixels = grab.GetOutput()
        width, height, _ = pixels.GetDimensions()
        rgba = vtk_to_numpy(pixels.GetPointData().GetScalars()).reshape(height, width, 4)
        return rgba[::-1].astype(np.float32) / 255.0

    def close(self) -> None:
        self.window.Finalize()
