"""What the effects of a scene need on the device: numbers and arrays (cl/effects.h).

Everything here works on the *reduced* scene (clvol.features.reduced). Effects without a consequence have been removed
from it, so they are neither compiled nor uploaded.
"""

from __future__ import annotations

import copy

import numpy as np

from clvol.device.aimed_lights import aimed_rows, has_aimed, load_images, share_towards
from clvol.device.effect_switches import effect_switches
from clvol.device.environment import environment_maps
from clvol.device.environment_file import load_radiance
from clvol.device.fields import SceneFields
from clvol.device.glow import glow_rows
from clvol.device.light_volume import (
    METHODS,
    casting_lights,
    check_fits,
    shadow_numbers,
    shadow_step,
)
from clvol.device.local_space import LocalSpace, unit_vector
from clvol.device.memory import ValueMap
from clvol.device.mesh_clips import mesh_rows
from clvol.device.noise import device_noise, device_tiles, perturbation
from clvol.device.occlusion_volume import check_occlusion_fits, occlusion_numbers
from clvol.device.opacity_factors import factor_rows, layer_places
from clvol.device.projection import (
    NO_SCORE,
    attenuation_a_step,
    normalisation,
    sample_bounds,
    score_bounds,
)
from clvol.device.volume import ResidentVolume
from clvol.features import GRADIENTS
from clvol.features.gradient_storage import DeviceLimits
from clvol.features.values import reachable
from clvol.features.vocabulary import CLIPS, EFFECT_COUNTERS, LIGHTS
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import EFFECTS
from clvol.scene.clip import Clip
from clvol.scene.depth_cue import DepthCue
from clvol.scene.environment import Environment
from clvol.scene.resolve import ResolvedScene
from clvol.volume.voxel_layout import padded_size

# The switch under which each counter counts anything, in the order of EFFECT_COUNTERS.
_BY_RAYS = ("shadow_rays", "shadow_samples")  # counted only where the method of shadows is "rays"
_COUNTED_BY = ("GRADIENT", "LIGHTING", "ISOSURFACES", "ISOSURFACES", "SHADOWS", "SHADOWS", "FIELDS", "REFRACTION")
_BEND = ("REFRACTION", "CURVED_RAYS")
COUNTERS = dict(zip(EFFECT_COUNTERS, _COUNTED_BY, strict=True))
OPAQUE_DEPTH = 1e15  # optical depth of an opaque surface; finite, so that any share of it is opaque, too
LONGEST_PATH = 8.0  # of rays that turn, in diagonals of the volume's bounding box
_FAR = 1e12  # smallest edges: light from farther away has one direction in float32
Row = tuple[float, ...]  # a float4 of the buffer `items`


class EffectState:
    """Device state of a scene's effects; ``switches`` is empty for a scene without effects."""

    def __init__(
        self, context: DeviceContext, resolved: ResolvedScene, volume: ResidentVolume
    ) -> None:
        self.switches = effect_switches(resolved, DeviceLimits.of(context))
        if not self.switches:
            return
        self.context = context
        self._values = volume.values
        self.space = LocalSpace(resolved.volume.grid, padded_size(resolved.volume))
        self.numbers = np.zeros(1, EFFECTS)
        none = {
            name: context.upload(np.zeros(4, dtype))
            for name, dtype in (
                ("items", np.float32), ("gradients", np.uint32), ("surface_distances", np.uint8),
                ("constant_distances", np.uint8), ("environment", np.float32),
                ("light_volume", np.float32), ("noise", np.uint32),
                ("factors", np.float32), ("fields", np.float32), ("occlusion", np.float32),
            )
        }  # fmt: skip
        self.arrays: dict[str, DeviceArray] = none
        self.fields: SceneFields | None = None
        self._images = load_images(resolved.lights)
        self._fill(resolved, volume)
        self._add_factors(resolved, volume)
        if self.switches.get("GRADIENT") == GRADIENTS["precomputed"]:
            gradients, scale = volume.gradients(resolved.gradient.operator)
            self.arrays["gradients"], self.numbers["gradient_scale"] = gradients, scale
        self._add_environment(resolved.environment, resolved.material.shininess)
        if resolved.all_noise:
            self.arrays["noise"] = context.upload(device_tiles(resolved.all_noise))
            self._fill_noise(resolved)
        if "COMPOSITING" in self.switches:
            self._add_projection(resolved, volume)
        if self.switches.get("SHADOWS"):
            check_fits(resolved, DeviceLimits.of(context))
            for name, value in shadow_numbers(resolved, padded_size(resolved.volume)).items():
                self.numbers[0][name] = value
        if resolved.ambient_occlusion is not None and self.switches.get("AMBIENT_OCCLUSION"):
            check_occlusion_fits(resolved, DeviceLimits.of(context))
            for name, value in occlusion_numbers(resolved, padded_size(resolved.volume)).items():
                self.numbers[0][name] = value
        self.arrays["effects"] = context.upload(self.numbers)

    def _fill(self, resolved: ResolvedScene, volume: ResidentVolume) -> None:
        numbers, space, values = self.numbers[0], self.space, volume.values
        for axis, name in enumerate("xyz"):
            numbers[f"local_{name}"] = (*space.matrix[axis], space.shift[axis])
            numbers[f"gradient_{name}"][:3] = space.inverse_transpose[axis]
        diagonal = np.diag(np.diag(space.inverse_transpose))
        numbers["along_axes"] = np.array_equal(diagonal, space.inverse_transpose)
        material = resolved.material
        for name in ("ambient", "diffuse", "specular", "shininess", "two_sided"):
            numbers[name] = getattr(material, name)
        per_edge = values.gain * space.unit  # from value per world length
        fade = material.fade * per_edge
        # The fade stays within float32, so that the strongest one is not taken for none (0).
        numbers["fade"] = float(np.clip(1.0 / fade, 1e-30, 1e30)) if fade > 0 else 0.0
        if resolved.depth_cue is not None:
            self._fill_depth_cue(resolved.depth_cue)
        lights, surfaces, clips = self._items(resolved, values)
        rows = [*lights, *surfaces, *clips]
        meshes = mesh_rows(resolved, space, len(rows))
        if rows or meshes:
            listed = np.array(rows, np.float32).reshape(-1, 4)
            self.arrays["items"] = self.context.upload(np.concatenate([listed, *meshes]))
        simple = [clip for clip in resolved.clips if clip.type != "mesh"]
        keeps = sum(clip.keep == "inside" for clip in simple)
        numbers["mesh_clips"] = len(resolved.clips) - len(simple)
        numbers["light_count"], numbers["surface_count"] = len(resolved.lights), len(resolved.isosurfaces)
        numbers["kept_clips"], numbers["removed_clips"] = keeps, len(simple) - keeps
        numbers["first_surface"], numbers["first_clip"] = len(lights), len(lights) + len(surfaces)

    def _add_factors(self, resolved: ResolvedScene, volume: ResidentVolume) -> None:
        """Opacity factors, transfer layers and fields: their tables share a buffer."""
        numbers = self.numbers[0]
        tables: list[np.ndarray] = []
        per_edge = volume.values.gain * self.space.unit

        def place(array: np.ndarray) -> int:
            tables.append(np.asarray(array, np.float32).ravel())
            return sum(table.size for table in tables[:-1])

        for name in ("gradient_opacity", "directional_opacity"):
            rows = factor_rows(getattr(resolved, name), per_edge)
            numbers[f"{name}_points"], numbers[f"{name}_table"] = rows.shape[1], place(rows)
        places = layer_places(resolved, per_edge)
        numbers["layer_count"], numbers["layer_table"] = places[0].size, place(np.concatenate(places))
        numbers["layer_rows"] = places[-1].size if len(places) > 1 else 1
        if resolved.glow is not None:
            rows = glow_rows(resolved.glow, volume.values, reachable(resolved), self.space.unit)
            numbers["glow_points"], numbers["glow_table"] = rows.shape[1], place(rows)
        if resolved.refraction is not None:
            index = resolved.refraction
            rows = np.stack([volume.values(index.values), index.indices]).astype(np.float32)
            numbers["index_points"], numbers["index_table"] = rows.shape[1], place(rows)
            corners = resolved.volume.grid.world_corners()
            diagonal = float(np.linalg.norm(np.ptp(corners, axis=0)))
            numbers["longest_path"] = LONGEST_PATH * diagonal / self.space.unit
        if resolved.fields:
            levels = volume.field_levels(resolved)
            self.fields = SceneFields(
                self.context, resolved, volume.cells, place, numbers, volume.cell_layout, levels
            )
            self.arrays["fields"] = self.fields.voxels
        if any(table.size for table in tables):
            self.arrays["factors"] = self.context.upload(np.concatenate(tables))

    def _add_environment(self, table: Environment | None, shininess: float) -> None:
        """The maps of the environment, after the pictures that lights project."""
        texels = self._images.texels
        if table is None:
            if len(texels):
                self.arrays["environment"] = self.context.upload(texels)
            return
        radiance = load_radiance(table.path, table.layout, table.intensity, table.rotation_degrees)
        maps = environment_maps(radiance, shininess, sky=table.visible)
        nodes = np.concatenate([texels, maps.nodes]) if len(texels) else maps.nodes
        self.arrays["environment"] = self.context.upload(nodes)
        places = {"diffuse": maps.diffuse, "specular": maps.specular, "sky": maps.sky or maps.diffuse}
        for name, place in places.items():
            self.numbers[f"{name}_map_size"], self.numbers[f"{name}_map"] = place.size, place.offset + len(texels)

    def _fill_noise(self, resolved: ResolvedScene) -> None:
        """The terms at ``animation.time``."""
        grid, numbers = resolved.volume.grid, self.numbers[0]
        numbers["noise_terms"], numbers["added_terms"], numbers["moving_terms"] = device_noise(
            resolved.all_noise, grid, resolved.animation.time, self._values
        )
        numbers["tinting_terms"] = len(resolved.attenuation_noise)
        numbers["fur_terms"] = len(resolved.fur)
        numbers["noise_reach"][:3] = 0.5 * grid.smallest_edge / np.asarray(grid.spacing)

    def _add_projection(self, resolved: ResolvedScene, volume: ResidentVolume) -> None:
        moved = perturbation(resolved.noise, resolved.volume.grid, self._values.gain, volume.cell_shift)
        numbers = self.numbers[0]
        numbers["lowest_sample"], numbers["highest_sample"] = sample_bounds(volume, resolved, moved)
        numbers["lowest_value"], numbers["values_per_range"] = normalisation(volume, resolved)
        numbers["attenuation"] = attenuation_a_step(resolved)
        numbers["hidden_score"] = NO_SCORE
        if resolved.integration.compositing != "average":
            self.arrays["factors"] = self.context.upload(score_bounds(volume, resolved, moved))

    def update_projection(self, resolved: ResolvedScene, volume: ResidentVolume) -> None:
        """Bounds of the values of ``volume``, of which other parts are resident now."""
        self.numbers = self.numbers.copy()
        self._add_projection(resolved, volume)
        self.arrays["effects"] = self.context.upload(self.numbers)

    def set_hidden(self, score: float) -> None:
        """Samples of at most this score show nothing."""
        self.numbers["hidden_score"] = score
        self.arrays["effects"] = self.context.upload(self.numbers)

    def for_scene(self, resolved: ResolvedScene) -> EffectState:
        """The same for ``resolved``, which may differ only in ``animation.time`` and in the step."""
        other = self.copy()
        changes = resolved.all_noise or self.switches.get("SHADOWS") or "COMPOSITING" in self.switches
        if self.switches and changes:
            other.numbers = self.numbers.copy()
            if self.switches.get("SHADOWS"):
                other.numbers["shadow_step"] = shadow_step(resolved)
            if resolved.all_noise:
                other._fill_noise(resolved)
            other.numbers["attenuation"] = attenuation_a_step(resolved)
            other.arrays["effects"] = self.context.upload(other.numbers)
        return other

    def for_step(self, resolved: ResolvedScene, volume: ResidentVolume) -> EffectState:
        """The same for ``resolved``, whose voxels alone differ: ``volume``."""
        other = self.copy()
        if not self.switches:
            return other
        other.numbers = self.numbers.copy()
        if self.switches.get("GRADIENT") == GRADIENTS["precomputed"]:
            gradients, scale = volume.gradients(resolved.gradient.operator)
            other.arrays["gradients"], other.numbers["gradient_scale"] = gradients, scale
        if resolved.all_noise:
            other._fill_noise(resolved)
        if "COMPOSITING" in self.switches:
            other._add_projection(resolved, volume)
        other.arrays["effects"] = self.context.upload(other.numbers)
        return other

    def _fill_depth_cue(self, cue: DepthCue) -> None:
        if cue.start is None or cue.end is None:
            raise ValueError("a [depth_cue] table that is not complete")
        unit = self.space.unit
        length = max((cue.end - cue.start) / unit, 1e-30)
        numbers = self.numbers[0]
        numbers["cue_start"], numbers["cue_per_edge"] = cue.start / unit, 1.0 / length
        numbers["cue_strength"], numbers["cue_color"][:3] = cue.strength, cue.color

    def _items(
        self, resolved: ResolvedScene, values: ValueMap
    ) -> tuple[list[Row], list[Row], list[Row]]:
        """Lights, iso-surfaces and clips, in two (or, of aimed lights, more) and three rows each."""
        space = self.space
        lights: list[Row] = []
        surfaces: list[Row] = []
        clips: list[Row] = []
        casting, aimed = casting_lights(resolved), has_aimed(resolved.lights)
        for number, light in enumerate(resolved.lights):
            at = np.zeros(3)
            if light.type == "directional":
                at = -unit_vector(np.asarray(light.direction, np.float64))
            kind, color = LIGHTS[light.type], np.asarray(light.color) * light.intensity
            if light.has_position:
                at = space.point(np.asarray(light.position, np.float64))
                if np.abs(at).max() > _FAR:
                    at, kind = unit_vector(at), LIGHTS["directional"]
                    color = color * share_towards(light, self._images, -at) if light.is_aimed else color
            lights.append((*at, kind))
            volume = casting.index(number) if number in casting else -1.0
            lights.append((*color, volume))
            if aimed:
                lights += aimed_rows(light, self._images)
        for surface in sorted(resolved.isosurfaces, key=lambda s: s.value):
            level = float(values(surface.value))
            depth = -np.log1p(-surface.opacity) if surface.opacity < 1 else OPAQUE_DEPTH
            surfaces.append((level, surface.opacity, surface.refraction, depth))
            surfaces.append((*surface.color, 0.0))
            back = surface.color if surface.back_color is None else surface.back_color
            surfaces.append((*back, 0.0))
        simple = [clip for clip in resolved.clips if clip.type != "mesh"]
        for clip in sorted(simple, key=lambda c: c.keep != "inside"):
            clips += _clip_rows(clip, space)
        return lights, surfaces, clips

    def copy(self) -> EffectState:
        """The same, with arrays that may be replaced."""
        other = copy.copy(self)
        if self.switches:
            other.arrays = dict(self.arrays)
        return other

    def set_surfaces(self, distances: DeviceArray) -> None:
        """``distances``: a ``distance_map`` of the cells in which a surface can be."""
        self.arrays["surface_distances"] = distances

    def set_constant(self, distances: DeviceArray) -> None:
        """``distances``: a ``distance_map`` of the cells in which the field is not constant."""
        self.arrays["constant_distances"] = distances

    def counted(self, sums: dict[str, int]) -> dict[str, int]:
        """``sums`` by name, of COUNTERS only those that the scene's effects count."""
        by_volume = self.switches.get("SHADOWS") in (METHODS["volume"], METHODS["half-angle"])
        bend = any(self.switches.get(switch) for switch in _BEND)

        def counts(name: str) -> bool:
            if by_volume and name in _BY_RAYS:
                return False
            return bend if name == "bends" else bool(self.switches.get(COUNTERS[name]))

        return {name: total for name, total in sums.items() if name not in COUNTERS or counts(name)}


def _clip_rows(clip: Clip, space: LocalSpace) -> list[Row]:
    """The three rows of a clip: type and radius, then two points or a point and a normal."""
    radius = 0.0 if clip.radius is None else clip.radius / space.unit
    corner = {"plane": clip.point, "box": clip.lower, "sphere": clip.center}[clip.type]
    first, second = space.point(np.asarray(corner, np.float64)), np.zeros(3)
    if clip.type == "plane":
        second = unit_vector(np.asarray(clip.normal, np.float64))
        first = (first @ second) * second  # the point of the plane nearest to the origin has the most digits
    elif clip.type == "box":
        second = space.point(np.asarray(clip.upper, np.float64))
    return [
        (CLIPS[clip.type], 0.0, 0.0, min(radius, _FAR)),
        (*np.clip(first, -_FAR, _FAR), 0.0),
        (*np.clip(second, -_FAR, _FAR), 0.0),
    ]
