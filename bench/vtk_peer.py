"""VTK on one of our scenes: its CPU ray caster vtkFixedPointVolumeRayCastMapper, unshaded or
shaded, and, for iso-surfaces, vtkGPUVolumeRayCastMapper, which runs on whatever OpenGL there is.

They are set up to do just what the scene says: fixed sample distance, one ray a pixel, linear
interpolation, the scene's material and light if it has one, nothing adjusted to a frame rate.

There are two pictures of the CPU ray caster, both linear and premultiplied: the rays' own, 15 bits
a channel as the mapper keeps it, and the window's, 8 bits a channel, into which OpenGL draws the
first as a texture. In the window, edges are softer: the texture is interpolated, up to half a pixel
beside its place.

Shading differs from clvol's in this: the CPU ray caster knows normals in 16 bits and one eye
direction for all rays (so a headlight is a directional one), and interpolates what is shaded at the
corners of a cell. Its gradients are computed once, in the first frame.
"""

from __future__ import annotations

import ctypes
import os
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

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


class _Window:
    """The scene's volume, look, light and camera in an off-screen window; subclasses map it.

    ValueError for a scene that VTK would show otherwise: a volume with an origin or a direction,
    more than one light, a point light, an intensity other than 1, a material of one side.
    """

    def __init__(self, resolved: ResolvedScene, mapper_name: str) -> None:
        import vtkmodules.vtkRenderingOpenGL2  # noqa: F401  (registers the OpenGL window)
        import vtkmodules.vtkRenderingVolume as volume_mappers
        import vtkmodules.vtkRenderingVolumeOpenGL2  # noqa: F401  (draws the mapper's picture)
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonCore import vtkLogger
        from vtkmodules.vtkCommonDataModel import vtkImageData
        from vtkmodules.vtkRenderingCore import (
            vtkRenderer,
            vtkRenderWindow,
            vtkVolume,
            vtkVolumeProperty,
        )

        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)  # it warns where there is no X
        volume = resolved.volume
        grid = volume.grid
        if np.any(grid.origin) or not np.array_equal(grid.direction, np.eye(3)):
            raise ValueError("a peer's volume has no origin and no direction")
        self._edge = grid.smallest_edge
        self._voxels = numpy_to_vtk(volume.data.ravel(), deep=True)
        image = vtkImageData()
        image.SetDimensions(*grid.size)
        image.SetSpacing(*grid.spacing)
        image.GetPointData().SetScalars(self._voxels)

        self.mapper = getattr(volume_mappers, mapper_name)()
        self.mapper.SetInputData(image)
        self.mapper.AutoAdjustSampleDistancesOff()
        self.mapper.LockSampleDistanceToInputSpacingOff()
        self.mapper.SetImageSampleDistance(1.0)

        self._look = vtkVolumeProperty()
        self._look.SetInterpolationTypeToLinear()
        self._look.SetScalarOpacityUnitDistance(resolved.transfer_function.opacity_unit)
        self._actor = vtkVolume()
        self._actor.SetMapper(self.mapper)
        self._actor.SetProperty(self._look)

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
        self._light(resolved)

    def _light(self, resolved: ResolvedScene) -> None:
        """Shading by the scene's one light, or none."""
        self._renderer.AutomaticLightCreationOff()
        self._look.SetShade(bool(resolved.lights))
        if not resolved.lights:
            return
        light, *more = resolved.lights
        if more or light.type == "point" or light.intensity != 1:
            raise ValueError("a peer has one light, directional or at the eye, of intensity 1")
        from vtkmodules.vtkRenderingCore import vtkLight

        if not resolved.material.two_sided:
            raise ValueError("a peer's material is two-sided")
        if light.type == "headlight":
            travels = np.subtract(resolved.camera.target, resolved.camera.position)
        else:
            travels = np.asarray(light.direction, dtype=np.float64)
        shown = vtkLight()
        shown.SetLightTypeToSceneLight()
        shown.SetPositional(False)
        shown.SetFocalPoint(*resolved.camera.target)
        shown.SetPosition(*np.subtract(resolved.camera.target, travels / np.linalg.norm(travels)))
        shown.SetDiffuseColor(*light.color)
        shown.SetSpecularColor(*light.color)
        shown.SetAmbientColor(*self._ambient_color(resolved))
        self._renderer.AddLight(shown)
        self._renderer.SetTwoSidedLighting(True)
        material = resolved.material
        self._look.SetAmbient(material.ambient)
        self._look.SetDiffuse(material.diffuse)
        self._look.SetSpecular(material.specular)
        self._look.SetSpecularPower(material.shininess)

    def _ambient_color(self, resolved: ResolvedScene) -> Any:
        """The light's, which the CPU ray caster multiplies by the sample's colour; VTK has 0 if
        not set, and there is no ambient share then."""
        return (1.0, 1.0, 1.0)

    def _set_functions(self, points: list[tuple[float, float, Any]]) -> None:
        """The transfer function through (value, opacity, linear colour)."""
        from vtkmodules.vtkCommonDataModel import vtkPiecewiseFunction
        from vtkmodules.vtkRenderingCore import vtkColorTransferFunction

        opacity, color = vtkPiecewiseFunction(), vtkColorTransferFunction()
        for value, alpha, rgb in points:
            opacity.AddPoint(value, alpha)
            color.AddRGBPoint(value, *rgb)
        self._look.SetScalarOpacity(opacity)
        self._look.SetColor(color)

    def render_empty(self) -> float:
        """Wall seconds of Render() without the volume: what a window costs anyway."""
        self._actor.VisibilityOff()
        start = time.perf_counter()
        self.window.Render()
        seconds = time.perf_counter() - start
        self.window.WaitForCompletion()
        self._actor.VisibilityOn()
        return seconds

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


class VtkPeer(_Window):
    """VTK's CPU ray caster; ``threads`` is what it may use. Shaded where the scene has a light."""

    def __init__(self, resolved: ResolvedScene, threads: int) -> None:
        super().__init__(resolved, "vtkFixedPointVolumeRayCastMapper")
        self.mapper.SetNumberOfThreads(threads)
        self.mapper.IntermixIntersectingGeometryOff()
        function = resolved.transfer_function
        self._set_functions([*zip(function.values, function.opacities, function.colors)])

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


class VtkIsosurface(_Window):
    """VTK's ray-cast iso-surfaces: the scene's own, its transfer function left out.

    VTK does this in OpenGL alone. Without a GPU that is Mesa's llvmpipe, on the processor, with as
    many threads as LP_NUM_THREADS says when the first window is opened. VTK has one opacity and
    colour function for surfaces, so the back has the front's colour. ValueError for a scene without
    exactly one surface within the volume's range.
    """

    def __init__(self, resolved: ResolvedScene) -> None:
        low, high = resolved.volume.value_range
        surfaces = resolved.isosurfaces
        if len(surfaces) != 1 or not low <= surfaces[0].value <= high:
            raise ValueError("a peer's scene has one isosurface, within the volume's range")
        surface = surfaces[0]
        super().__init__(resolved, "vtkGPUVolumeRayCastMapper")
        self.mapper.SetUseJittering(False)
        self.mapper.SetBlendModeToIsoSurface()
        # VTK reads both from tables over the range of their points, which must not be empty.
        self._set_functions([(value, surface.opacity, surface.color) for value in (low, high)])
        values = self._look.GetIsoSurfaceValues()
        values.SetNumberOfContours(1)
        values.SetValue(0, surface.value)

    def _ambient_color(self, resolved: ResolvedScene) -> Any:
        return resolved.isosurfaces[0].color  # here VTK adds it as it is

    def render(self, step: float) -> float:
        """Wall seconds until all is drawn, with samples every ``step`` smallest voxel edges."""
        self.mapper.SetSampleDistance(step * self._edge)
        start = time.perf_counter()
        self.window.Render()
        self.window.WaitForCompletion()
        return time.perf_counter() - start

    def opengl(self) -> dict[str, Any]:
        """What draws: OpenGL's names of itself, and its threads if it is llvmpipe. Render first."""
        lines = self.window.ReportCapabilities().splitlines()
        found = dict(line.split(": ", 1) for line in lines if ": " in line)
        return {
            "renderer": found.get("OpenGL renderer string", "unknown").strip(),
            "version": found.get("OpenGL version string", "unknown").strip(),
            "threads": _llvmpipe_threads(),
            "LP_NUM_THREADS": os.environ.get("LP_NUM_THREADS"),
        }


def _llvmpipe_threads() -> int | None:
    """Rasterizer threads of this process (Linux names them), None where it cannot be told."""
    names = []
    try:
        for task in Path("/proc/self/task").iterdir():
            names.append((task / "comm").read_text(encoding="utf-8"))
    except OSError:
        return None
    return sum(name.startswith("llvmpipe-") for name in names) or None
