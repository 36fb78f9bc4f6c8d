"""[transfer_function] generator: a function made from the data, as control points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from clvol.errors import SceneError
from clvol.lazily import lazily
from clvol.scene.default_unit import default_opacity_unit
from clvol.scene.transfer_function import TransferFunctionSettings
from clvol.scene.transfer_layer import TransferLayer
from clvol.transfer import TransferFunction
from clvol.transfer.color import srgb_to_linear

if TYPE_CHECKING:
    from clvol.choice import generated as generators
    from clvol.choice.sample import Sample
    from clvol.scene.scene import Scene
else:
    generators = lazily("clvol.choice.generated")

# sRGB, over the range of the values
_PALETTE = ((0.25, 0.35, 0.90), (0.20, 0.75, 0.80), (0.45, 0.85, 0.35), (0.95, 0.80, 0.25), (0.95, 0.35, 0.25))


def generated_function(
    scene: Scene, settings: TransferFunctionSettings, sample: Sample
) -> tuple[TransferFunction, tuple[TransferLayer, ...]]:
    """The function that ``settings`` request of the volume that ``sample`` is of, in its values, and its layers by
    gradient magnitude. SceneError for a scene with layers of its own beside a function of two values."""
    assert settings.generator is not None
    if scene.transfer_layer and settings.generator.endswith("-2d"):
        what = f"got {settings.generator!r} in a scene with [[transfer_layer]]s"
        raise SceneError(f"{scene.origin}: transfer_function.generator", what, "one of both")
    unit = settings.opacity_unit
    if unit is None:
        voxel = float(np.exp(np.mean(np.log(sample.grid.spacing))))
        unit = voxel if settings.generator.startswith("boundary") else default_opacity_unit(sample.grid)
    made = generators.generate(sample, settings.generator, settings.strength, settings.thickness)
    if made is None:
        values = sample.values[np.isfinite(sample.values)]
        value = float(values[0]) if values.size else 0.0
        return TransferFunction([value], [settings.strength], [[0.7, 0.7, 0.7]], unit), ()
    ends = made.curve[0][0], made.curve[-1][0]

    def function(curve: Sequence[tuple[float, float]]) -> TransferFunction:
        values = np.array([value for value, _ in curve])
        colors = _colors(scene, settings, values, ends, unit)
        return TransferFunction(values, [opacity for _, opacity in curve], colors, unit)

    layers = tuple(TransferLayer(magnitude, function(curve)) for magnitude, curve in made.layers)
    return function(made.curve), layers


def _colors(
    scene: Scene, settings: TransferFunctionSettings, values: np.ndarray, ends: tuple[float, float], unit: float
) -> np.ndarray:
    """Linear light [n, 3] at ``values``: of the colour map that the scene names, or of a palette over the range."""
    if settings.colormap is not None:
        plain = settings.model_copy(update={"generator": None})
        return plain.function(ends, unit, scene.folder, scene.origin).color(values)
    return srgb_to_linear(generators.palette(_PALETTE, (values - ends[0]) / (ends[1] - ends[0])))
