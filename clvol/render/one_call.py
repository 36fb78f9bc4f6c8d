"""A picture in one call: ``clvol.render(x, ...)``."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from clvol.errors import UsageError
from clvol.integrators.base import Progress
from clvol.render.frame import Frame
from clvol.render.renderer import Renderer
from clvol.scene import Scene, load_scene
from clvol.scene.table import Table, expected_key
from clvol.volume.series import VolumeSeries
from clvol.volume.volume import Volume


def render(
    x: Any,
    *,
    devices: Sequence[Any] | None = None,
    memory_cap: int | None = None,
    progress: Progress | bool | None = None,
    depth: bool = True,
    **tables: Any,
) -> Frame:
    """The picture of ``x``: a Scene, a Volume, a VolumeSeries, whatever ``Volume`` takes (an array of numpy, an object
    of xarray, SimpleITK, nibabel, VTK, ...), or the path of a scene or volume file.

    ``tables`` are those of a scene. A dict changes keys of the scene's own table, and keeps the others; an object
    (``clvol.Camera(...)``) and a list take the table's place. What is left out is chosen from the volume. ``devices``,
    ``memory_cap`` and ``progress`` are as for ``Renderer``; without ``depth`` no depth is computed. A Renderer renders
    a scene more than once for less.

    >>> clvol.render("head.nrrd", image={"width": 800}, camera={"view": "left"}).save("head.png")

    Raises UsageError, SceneError, VolumeError, DeviceError, RenderError.
    """
    scene = _scene_of(x, tables)
    with Renderer(scene, devices, memory_cap, progress) as renderer:
        moment = scene.moment  # of a picture that carries its scene
        camera = None if moment is None or "camera" in tables else moment.camera
        time = None if moment is None or "animation" in tables else moment.time
        return renderer.render(camera=camera, progress=progress, depth=depth, time=time)


def _scene_of(x: Any, tables: Mapping[str, Any]) -> Scene:
    unknown = next((name for name in tables if name not in Scene.model_fields), None)
    if unknown is not None:
        names = ["devices", "memory_cap", "progress", "depth", *Scene.model_fields]
        raise UsageError("clvol.render", f"unknown keyword {unknown}", expected_key(unknown, names))
    if isinstance(x, Scene):
        return _changed(x, tables)
    if isinstance(x, (str, os.PathLike)):
        return _changed(load_scene(os.fspath(x)), tables)
    if isinstance(x, Mapping):
        raise UsageError("clvol.render", "got a dict", "a scene: clvol.render(clvol.Scene(**tables))")
    if "volume" in tables:
        raise UsageError("clvol.render", "got volume beside voxels", "either voxels or volume, not both")
    return Scene(volume=x if isinstance(x, (Volume, VolumeSeries)) else Volume(x), **tables)


def _changed(scene: Scene, tables: Mapping[str, Any]) -> Scene:
    """``scene`` with ``tables``; a dict is merged into the table that the scene has."""
    update = {}
    for name, value in tables.items():
        own = getattr(scene, name)
        if isinstance(value, Mapping) and isinstance(own, Table):
            value = {**{key: getattr(own, key) for key in own.model_fields_set}, **value}
        update[name] = value
    return scene.model_copy(update=update) if update else scene
