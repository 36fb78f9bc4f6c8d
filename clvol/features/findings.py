"""The state shared by the passes of the analysis: the scene as reduced so far, and what is visible in it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from clvol.features.effect import Effect
from clvol.features.geometry import grids_apart
from clvol.features.values import reachable, shows
from clvol.scene.field import ResolvedField
from clvol.scene.isosurface import Isosurface
from clvol.scene.resolve import ResolvedScene

PROJECTIONS = {
    "maximum": "maximum intensity projection",
    "minimum": "minimum intensity projection",
    "average": "averaging",
    "attenuated-maximum": "attenuated maximum intensity projection",
}
NO_VALUES = "no voxel is finite"
NOTHING_VISIBLE = "nothing of the volume is visible"


class Findings:
    """The scene as reduced so far, with what the passes have found.

    ``scene``: without everything found to have no consequence. ``effects``: by name. ``projection``: a compositing
    other than "over" in words, or None. ``has_values``: whether any voxel is finite. ``emits``: whether the transfer
    function shows any of the volume. ``adds``: whether a density field shows anything. ``surfaces``: the iso-surfaces
    with a consequence. ``blank``: none of these three is visible. ``lit``, ``by_lights``: whether anything is lit,
    and whether by lights; known after the pass over lighting. ``cycles_later``: whether cycling colours are back
    where they began.
    """

    def __init__(self, scene: ResolvedScene) -> None:
        self.scene = scene
        self.effects: dict[str, Effect] = {}
        self.projection = PROJECTIONS.get(scene.integration.compositing)
        self.has_values = has_values(scene)
        self.emits = emits(scene)
        self.adds = self.projection is None and any(
            density_shows(field, scene) for field in scene.fields if field.role == "density"
        )
        self.surfaces = self._surfaces(*reachable(scene))
        self.blank = not (self.emits or self.adds or self.surfaces)
        self.lit = self.by_lights = self.cycles_later = False

    def note(self, *effects: Effect) -> None:
        for effect in effects:
            self.effects[effect.name] = effect

    def change(self, **parts: Any) -> None:
        differing = {key: part for key, part in parts.items() if getattr(self.scene, key) != part}
        if differing:
            self.scene = replace(self.scene, **differing)

    def _surfaces(self, low: float, high: float) -> tuple[Isosurface, ...]:
        if self.projection or not self.has_values:
            return ()
        there = [s for s in self.scene.isosurfaces if low <= s.value <= high]
        solid = [s for s in there if s.opacity > 0]
        behind = self.emits or self.adds or solid or has_background(self.scene)
        return tuple(s for s in there if s.opacity > 0 or (s.refraction != 1 and behind))


def has_no_gradient(scene: ResolvedScene) -> bool:
    """Whether the finite part of the volume has a single value, and there is no noise."""
    low, high = scene.volume.value_range
    return low == high and not scene.noise


def has_values(scene: ResolvedScene) -> bool:
    """Whether any voxel is finite."""
    volume = scene.volume
    return volume.nan_count + volume.inf_count < math.prod(volume.shape)


def emits(scene: ResolvedScene) -> bool:
    """Whether the transfer function, including its layers, can show any of the volume."""
    functions = [scene.transfer_function]
    by_gradient = any(not layer.values for layer in scene.transfer_layers)
    if scene.integration.compositing == "over" and not (by_gradient and has_no_gradient(scene)):
        functions += [layer.function for layer in scene.transfer_layers]
    if scene.glow is not None:
        functions.append(scene.glow.shape)
    low, high = reachable(scene)
    return has_values(scene) and any(shows(function, low, high) for function in functions)


def density_shows(field: ResolvedField, scene: ResolvedScene) -> bool:
    if not shows(field.function, *field.volume.value_range):
        return False
    return not grids_apart(scene.volume.grid, field.volume.grid)


def has_background(scene: ResolvedScene) -> bool:
    """Whether the environment is visible where a ray stays transparent."""
    environment = scene.environment
    return environment is not None and environment.visible and environment.intensity > 0
