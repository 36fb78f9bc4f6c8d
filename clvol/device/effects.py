"""What the effects of a scene need on the device: switches, numbers, arrays (cl/effects.h).

Everything here looks at the *reduced* scene (clvol.features.reduced): what has no consequence is not
in it any more, so it is neither compiled nor uploaded.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from clvol.device.environment import environment_maps
from clvol.device.environment_file import load_radiance
from clvol.device.fields import SceneFields, field_switches
from clvol.device.gradients import gradient_switch
from clvol.device.light_volume import (
    METHODS,
    casting_lights,
    check_fits,
    shadow_numbers,
    shadow_step,
    shadow_switches,
)
from clvol.device.memory import ValueMap
from clvol.device.noise import TARGETS, device_noise, device_tiles, perturbation
from clvol.device.opacity_factors import factor_rows, factor_switches, layer_places
from clvol.device.projection import (
    NO_SCORE,
    attenuation_a_step,
    normalisation,
    sample_bounds,
    score_bounds,
)
from clvol.device.volume import DeviceVolume
from clvol.features import COMPOSITINGS, GRADIENTS, emits, is_lit
from clvol.features.gradient_storage import UNLIMITED, DeviceLimits
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import effects_dtype
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Grid
from clvol.volume.voxel_layout import padded_size

# As numbered in cl/effects.h, each with the switch that it takes to be counted at all.
_BY_RAYS = ("shadow_rays", "shadow_samples")  # nor is it counted where shadows are by volume
COUNTERS = {
    "gradients": "GRADIENT",
    "lit_samples": "LIGHTING",
    "surface_tests": "ISOSURFACES",
    "surface_hits": "ISOSURFACES",
    "shadow_rays": "SHADOWS",
    "shadow_samples": "SHADOWS",
    "field_samples": "FIELDS",
    "bends": "REFRACTION",
}
LIGHT_TYPES = {"directional": 0, "point": 1, "headlight": 2}
OPAQUE_DEPTH = 1e15  # of a surface; finite, so that any share of it counts
CLIP_TYPES = {"plane": 0, "box": 1, "sphere": 2}
_FAR = 1e12  # smallest edges: from there light comes from one direction, to float32
ARGUMENTS = (
    ", in effects V1, in items float32, in gradients uint32, in surface_distances uint8, "
    "in environment float32, in light_volume float32, in noise uint32, in factors float32, "
    "in fields float32"
)


def effect_switches(
    resolved: ResolvedScene, limits: DeviceLimits | None = None
) -> dict[str, int]:
    """The switches (-D) of a reduced scene's effects; none at all for a scene without any.

    ``limits``: of the device, which may be too small for precomputed gradients; None: it is not.
    """
    seen = resolved.environment is not None and resolved.environment.visible
    if resolved.integration.compositing != "over":
        return _projection_switches(resolved, seen)
    lit = is_lit(resolved)
    surfaces = resolved.isosurfaces
    refracts = any(surface.refraction != 1.0 for surface in surfaces)
    factors = resolved.gradient_opacity is not None or resolved.directional_opacity is not None
    decides = factors or bool(resolved.transfer_layers)
    switches = {
        "LIGHTING": int(lit),
        "LIGHTS": int(bool(resolved.lights)),
        "SPECULAR": int(lit and resolved.material.specular > 0),
        "ISOSURFACES": int(bool(surfaces)),
        "REFRACTION": int(refracts),
        "CLIP": int(bool(resolved.clips)),
        "DEPTH_CUE": int(resolved.depth_cue is not None),
        "ENVIRONMENT": int(lit and resolved.environment is not None),
        "ENVIRONMENT_VISIBLE": int(seen),
        **factor_switches(resolved),
        **field_switches(resolved),
        "NOISE": _noise(resolved),
        **shadow_switches(resolved),
        "GRADIENT": _gradient(resolved, limits) if lit or refracts or decides else 0,
    }
    if not any(switches.values()):
        return {}
    # Whole segments' opacities serve where no effect cuts segments or changes what they absorb.
    changed = decides or surfaces or resolved.fields or resolved.integration.classification == "pre"
    return {
        "EFFECTS": 1,
        "TRANSLUCENT": int(is_translucent(resolved)),
        "SEGMENT_OPACITIES": int(not changed),
        **switches,
    }


def _projection_switches(resolved: ResolvedScene, seen: bool) -> dict[str, int]:
    """What counts where one value of each ray is shown."""
    return {
        "EFFECTS": 1,
        "COMPOSITING": COMPOSITINGS[resolved.integration.compositing],
        "CLIP": int(bool(resolved.clips)),
        "ENVIRONMENT_VISIBLE": int(seen),
        "NOISE": _noise(resolved),
        **field_switches(resolved),
    }


def _noise(resolved: ResolvedScene) -> int:
    """NOISE_ADDS and NOISE_MOVES of cl/scene_value.h."""
    return sum(1 << TARGETS[target] for target in {term.target for term in resolved.noise})


def _gradient(resolved: ResolvedScene, limits: DeviceLimits | None) -> int:
    asked = resolved.gradient
    if resolved.noise:  # differences of noisy values, whatever the operator is
        return GRADIENTS["central"]
    limits = limits or UNLIMITED
    return gradient_switch(
        resolved.volume, resolved.integration.filter, asked.operator, asked.storage, limits
    )


def is_translucent(resolved: ResolvedScene) -> bool:
    """Whether anything but surfaces shows: the volume under its transfer function, or a field."""
    return emits(resolved) or any(field.role == "density" for field in resolved.fields)


class LocalSpace:
    """World axes, origin in the middle of the volume, smallest voxel edges as the unit.

    ``matrix`` float64 [3, 3] and ``shift`` [3]: from lattice points to local ones. ``inverse_transpose``
    takes derivatives per lattice unit to derivatives per edge.
    """

    def __init__(self, grid: Grid, size: tuple[int, int, int]) -> None:
        self.unit = grid.smallest_edge
        self.matrix = np.asarray(grid.direction) * (np.asarray(grid.spacing) / self.unit)
        self.shift = -self.matrix @ (0.5 * (np.asarray(size, np.float64) - 1.0))
        self.inverse_transpose = np.linalg.inv(self.matrix).T
        lower, upper = grid.index_bounds()
        self._to_world = grid.index_to_world()
        self.centre = (self._to_world @ np.append(0.5 * (lower + upper), 1.0))[:3]

    def point(self, world: Any) -> np.ndarray:
        """A world point in local coordinates."""
        return (np.asarray(world, np.float64) - self.centre) / self.unit


class EffectState:
    """Device state of a scene's effects; ``switches`` is empty where it has none."""

    def __init__(
        self, context: DeviceContext, resolved: ResolvedScene, volume: DeviceVolume
    ) -> None:
        self.switches = effect_switches(resolved, DeviceLimits.of(context))
        if not self.switches:
            return
        self.context = context
        self._value_gain = volume.values.gain
        self.space = LocalSpace(resolved.volume.grid, padded_size(resolved.volume))
        self.numbers = np.zeros(1, effects_dtype())
        none = {
            name: context.upload(np.zeros(4, dtype))
            for name, dtype in (
                ("items", np.float32), ("gradients", np.uint32), ("surface_distances", np.uint8),
                ("environment", np.float32), ("light_volume", np.float32), ("noise", np.uint32),
                ("factors", np.float32), ("fields", np.float32),
            )
        }  # fmt: skip
        self.arrays: dict[str, DeviceArray] = none
        self.fields: SceneFields | None = None
        self._fill(resolved, volume)
        self._add_factors(resolved, volume)
        if self.switches.get("GRADIENT") == GRADIENTS["precomputed"]:
            gradients, scale = volume.gradients(resolved.gradient.operator)
            self.arrays["gradients"], self.numbers["gradient_scale"] = gradients, scale
        if resolved.environment is not None:
            self._add_environment(resolved)
        if resolved.noise:
            self.arrays["noise"] = context.upload(device_tiles(resolved.noise))
            self._fill_noise(resolved)
        if "COMPOSITING" in self.switches:
            self._add_projection(resolved, volume)
        if self.switches.get("SHADOWS"):
            check_fits(resolved, DeviceLimits.of(context))
            for name, value in shadow_numbers(resolved, padded_size(resolved.volume)).items():
                self.numbers[0][name] = value
        self.arrays["effects"] = context.upload(self.numbers)

    def _fill(self, resolved: ResolvedScene, volume: DeviceVolume) -> None:
        numbers, space, values = self.numbers[0], self.space, volume.values
        for axis, name in enumerate("xyz"):
            numbers[f"local_{name}"] = (*space.matrix[axis], space.shift[axis])
            numbers[f"gradient_{name}"][:3] = space.inverse_transpose[axis]
        diagonal = np.diag(np.diag(space.inverse_transpose))
        numbers["gradient_x"][3] = float(np.array_equal(diagonal, space.inverse_transpose))
        material = resolved.material
        numbers["material"] = (
            material.ambient, material.diffuse, material.specular, material.shininess
        )  # fmt: skip
        per_edge = values.gain * space.unit  # from value per world length
        fade = material.fade * per_edge
        # Within float32, so that what fades most is not taken for what does not fade.
        per_fade = float(np.clip(1.0 / fade, 1e-30, 1e30)) if fade > 0 else 0.0
        numbers["shading"][:2] = (per_fade, float(material.two_sided))
        if resolved.depth_cue is not None:
            self._fill_depth_cue(resolved.depth_cue)
        lights, surfaces, clips = self._items(resolved, values)
        rows = [*lights, *surfaces, *clips]
        if rows:
            self.arrays["items"] = self.context.upload(np.array(rows, np.float32))
        keeps = sum(clip.keep == "inside" for clip in resolved.clips)
        numbers["counts"] = (
            len(resolved.lights), len(resolved.isosurfaces), keeps, len(resolved.clips) - keeps
        )  # fmt: skip
        numbers["first"][:3] = (0, len(lights), len(lights) + len(surfaces))

    def _add_factors(self, resolved: ResolvedScene, volume: DeviceVolume) -> None:
        """Opacity factors, transfer layers and fields: their tables share a buffer."""
        numbers, tables = self.numbers[0], []
        per_edge = volume.values.gain * self.space.unit

        def place(array: np.ndarray) -> int:
            tables.append(np.asarray(array, np.float32).ravel())
            return sum(table.size for table in tables[:-1])

        for k, factor in enumerate((resolved.gradient_opacity, resolved.directional_opacity)):
            rows = factor_rows(factor, per_edge)
            numbers["factors"][k], numbers["factor_offsets"][k] = rows.shape[1], place(rows)
        places = layer_places(resolved, per_edge)
        numbers["factors"][2], numbers["factor_offsets"][2] = places.size, place(places)
        if resolved.fields:
            self.fields = SceneFields(self.context, resolved, volume.cells, place, numbers)
            self.arrays["fields"] = self.fields.voxels
        if any(table.size for table in tables):
            self.arrays["factors"] = self.context.upload(np.concatenate(tables))

    def _add_environment(self, resolved: ResolvedScene) -> None:
        asked = resolved.environment
        radiance = load_radiance(
            asked.path, asked.layout, asked.intensity, asked.rotation_degrees
        )  # fmt: skip
        maps = environment_maps(radiance, resolved.material.shininess, sky=asked.visible)
        self.arrays["environment"] = self.context.upload(maps.nodes)
        places = [maps.diffuse, maps.specular, maps.sky or maps.diffuse]
        self.numbers[0]["maps"][:3] = [place.size for place in places]
        self.numbers[0]["map_offsets"][:3] = [place.offset for place in places]

    def _fill_noise(self, resolved: ResolvedScene) -> None:
        """The terms at ``animation.time``."""
        grid, numbers = resolved.volume.grid, self.numbers[0]
        terms, *counts = device_noise(
            resolved.noise, grid, resolved.animation.time, self._value_gain
        )
        numbers["noise_terms"], numbers["noise_counts"][:2] = terms, counts
        numbers["noise_reach"][:3] = 0.5 * grid.smallest_edge / np.asarray(grid.spacing)

    def _add_projection(self, resolved: ResolvedScene, volume: DeviceVolume) -> None:
        moved = perturbation(resolved.noise, resolved.volume.grid, self._value_gain)
        numbers = self.numbers[0]
        numbers["value_bounds"][:2] = sample_bounds(volume, resolved, moved)
        numbers["projection"][:2] = normalisation(volume, resolved)
        numbers["projection"][2] = attenuation_a_step(resolved)
        numbers["projection"][3] = NO_SCORE
        if resolved.integration.compositing != "average":
            self.arrays["factors"] = self.context.upload(score_bounds(volume, resolved, moved))

    def set_hidden(self, score: float) -> None:
        """``score``: samples that score no more than that show nothing."""
        self.numbers[0]["projection"][3] = score
        self.arrays["effects"] = self.context.upload(self.numbers)

    def for_scene(self, resolved: ResolvedScene) -> EffectState:
        """The same for ``resolved``, which may differ in ``animation.time`` and in the step alone."""
        other = self.copy()
        changes = resolved.noise or self.switches.get("SHADOWS") or "COMPOSITING" in self.switches
        if self.switches and changes:
            other.numbers = self.numbers.copy()
            if self.switches.get("SHADOWS"):
                other.numbers[0]["shadow"][1] = shadow_step(resolved)
            if resolved.noise:
                other._fill_noise(resolved)
            other.numbers[0]["projection"][2] = attenuation_a_step(resolved)
            other.arrays["effects"] = self.context.upload(other.numbers)
        return other

    def _fill_depth_cue(self, cue: Any) -> None:
        unit = self.space.unit
        length = max((cue.end - cue.start) / unit, 1e-30)
        self.numbers[0]["depth_cue"][:3] = (cue.start / unit, 1.0 / length, cue.strength)
        self.numbers[0]["depth_color"][:3] = cue.color

    def _items(self, resolved: ResolvedScene, values: ValueMap) -> tuple[list, list, list]:
        space = self.space
        lights, surfaces, clips = [], [], []
        casting = casting_lights(resolved)
        for number, light in enumerate(resolved.lights):
            at = np.zeros(3)
            if light.type == "directional":
                at = -_unit(light.direction)
            kind = LIGHT_TYPES[light.type]
            if light.type == "point":
                at = space.point(light.position)
                if np.abs(at).max() > _FAR:
                    at, kind = _unit(at), LIGHT_TYPES["directional"]
            lights.append((*at, kind))
            volume = casting.index(number) if number in casting else -1.0
            lights.append((*(np.asarray(light.color) * light.intensity), volume))
        for surface in sorted(resolved.isosurfaces, key=lambda s: s.value):
            level = float(values(surface.value))
            depth = -np.log1p(-surface.opacity) if surface.opacity < 1 else OPAQUE_DEPTH
            surfaces.append((level, surface.opacity, surface.refraction, depth))
            surfaces.append((*surface.color, 0.0))
            surfaces.append((*surface.back_color, 0.0))
        for clip in sorted(resolved.clips, key=lambda c: c.keep != "inside"):
            radius = 0.0 if clip.radius is None else clip.radius / space.unit
            first = {"plane": clip.point, "box": clip.lower, "sphere": clip.center}[clip.type]
            second = np.zeros(3)
            first = space.point(first)
            if clip.type == "plane":
                second = _unit(clip.normal)
                first = (first @ second) * second  # the plane's nearest point has the most digits
            elif clip.type == "box":
                second = space.point(clip.upper)
            clips.append((CLIP_TYPES[clip.type], 0.0, 0.0, min(radius, _FAR)))
            clips.append((*np.clip(first, -_FAR, _FAR), 0.0))
            clips.append((*np.clip(second, -_FAR, _FAR), 0.0))
        return lights, surfaces, clips

    def copy(self) -> EffectState:
        """The same, with arrays that may be replaced."""
        other = copy.copy(self)
        if self.switches:
            other.arrays = dict(self.arrays)
        return other

    def set_surfaces(self, distances: DeviceArray) -> None:
        """``distances``: as of ``distance_map``, to the cells in which a surface can be."""
        self.arrays["surface_distances"] = distances

    def counted(self, sums: dict[str, int]) -> dict[str, int]:
        """Of sums by the names of COUNTERS those that the scene's effects count."""
        by_volume = self.switches.get("SHADOWS") == METHODS["volume"]
        return {
            name: total
            for name, total in sums.items()
            if self.switches.get(COUNTERS[name]) and not (by_volume and name in _BY_RAYS)
        }


def _unit(vector: Any) -> np.ndarray:
    """``vector`` at length 1; scaled first, so that no square over- or underflows."""
    vector = np.asarray(vector, np.float64)
    vector = vector / np.abs(vector).max()
    return vector / np.linalg.norm(vector)
