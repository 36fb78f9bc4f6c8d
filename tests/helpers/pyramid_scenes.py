"""Scenes for the method "pyramid", and what it makes of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from reference.pyramid import PyramidPicture, mapped_oracle, render_pyramid_twin

from clvol import TransferFunction
from clvol.integrators.base import FrameData
from clvol.integrators.pyramid.caster import PyramidCaster
from clvol.integrators.pyramid.cells import read_distances
from helpers.small_scenes import SMOOTH, make_scene, waves

CAMERA = {"position": (-55.0, -38.0, -61.0), "target": (22.0, 18.0, 20.0), "fov_degrees": 36.0}
# A thin shell: most of the volume shows nothing.
SHELL = TransferFunction(
    [0.0, 150.0, 165.0, 180.0, 255.0],
    [0.0, 0.0, 0.3, 0.0, 0.0],
    [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.9, 0.9], [1.0, 1.0, 1.0]],
)


def pyramid_scene(array=None, function=SMOOTH, *, width=40, height=36, camera=CAMERA, **asked):
    """A resolved scene; ``asked``: keys of [pyramid], then of [integration], the grid, or clips."""
    clips = asked.pop("clips", ())
    of_pyramid = {k: asked.pop(k) for k in ("levels", "oracle", "epsilon") if k in asked}
    array = waves((40, 37, 45)) if array is None else array
    asked = {"step": 0.7, **asked}
    resolved = make_scene(
        array, function, camera=camera, width=width, height=height, method="pyramid", **asked
    )
    return replace(resolved, clips=clips, pyramid=resolved.pyramid.model_copy(update=of_pyramid))


def pyramid_picture(context, resolved, **how) -> FrameData:
    return rendered(PyramidCaster(context, resolved, **how))


def rendered(caster) -> FrameData:
    resolved = caster.resolved
    return caster.render(resolved.camera, resolved.image.width, resolved.image.height)


def twin_picture(caster: PyramidCaster, clips=()) -> PyramidPicture:
    """The twin's, with the oracle that ``caster`` has."""
    return render_pyramid_twin(replace(caster.resolved, clips=clips), twin_oracle(caster))


def twin_oracle(caster: PyramidCaster):
    if caster.march.oracle.kernel == "minimum":
        return lambda places, left: np.zeros(len(places))
    mapped = mapped_oracle(caster.resolved, map_distances(caster), caster.march.asked.shift)
    if caster.march.oracle.kernel == "map":
        return mapped
    least = caster.resolved.pyramid.epsilon
    return lambda places, left: mapped(places, left) / np.sqrt(np.maximum(left, least))


def map_distances(caster: PyramidCaster) -> np.ndarray:
    """Distances [z, y, x] of the map that ``caster`` has."""
    return read_distances(caster.context, caster.march.map, caster.march.asked.shape)
