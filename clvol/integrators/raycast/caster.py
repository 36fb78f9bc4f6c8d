"""The ray caster's host side: device state of one scene, and a frame from it (cl/raycast.cl)."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from clvol.device.arguments import EFFECT_ARGUMENTS, Arguments, counts_argument, picture_arguments, scene_arguments
from clvol.device.effect_state import COUNTERS, EffectState
from clvol.device.effect_switches import effect_switches
from clvol.device.empty_space import dilated, distance_map, surface_mask, visible_mask
from clvol.device.function_tables import function_tables
from clvol.device.light_volume import METHODS, fill_light_volume, shadow_step
from clvol.device.memory import Perturbation
from clvol.device.noise import perturbation
from clvol.device.occlusion_volume import fill_occlusion_volume
from clvol.device.opacity_factors import layer_functions, shown_function
from clvol.device.projection import hidden_score
from clvol.device.transfer_lookup import color_shift, cycled_function, device_function, scene_nodes
from clvol.device.view import EVERY_PIXEL, PixelLattice, PixelList, Pixels, RayFrame
from clvol.device.volume import DeviceVolume, ResidentVolume
from clvol.features import reduced_for_frames
from clvol.features.gradient_storage import DeviceLimits
from clvol.features.vocabulary import LEVEL_COUNTERS
from clvol.integrators.base import FrameData, Progress, Shared
from clvol.integrators.raycast.bending_cells import bending_cells
from clvol.integrators.raycast.cell_depths import cell_depths
from clvol.integrators.raycast.coherent_parts import parts_from_history
from clvol.integrators.raycast.constant_cells import changing_cells
from clvol.integrators.raycast.frame_view import VolumePart, frame_view, volume_view
from clvol.integrators.raycast.history import COHERENT_ARGUMENTS, History, render_from_history
from clvol.integrators.raycast.listed import listed_by_tiles
from clvol.integrators.raycast.march import March, RayMarch
from clvol.integrators.raycast.picture import PictureParts, TilesDone, WholePicture
from clvol.integrators.raycast.step_map import step_map, upload_steps
from clvol.integrators.raycast.surface_tiles import without_surfaces
from clvol.integrators.raycast.switches import raycast_switches
from clvol.integrators.raycast.warm_up import warm_up
from clvol.opencl.arguments import reads, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.opencl.structs import EFFECTS, FIELD, NOISE_TERM, view_dtype
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.tiles import TILE, bands
from clvol.transfer import TransferFunction
from clvol.transfer.lookup_nodes import LookupNodes, visible_cells
from clvol.transfer.pieces import shown_spans, value_gate

SECONDS_A_SAMPLE = 1e-8  # a first guess, used to divide a frame into launches
_BAND_SECONDS = 0.5
_PACE_MARGIN = 4.0  # tiles may take this many times as long as those before them
_KEPT = 6  # volumes; a search for settings may render many variants of one
_COARSE_ARGUMENTS = (reads("coarse", np.float32, "columns", "rows", 4), reads("coarse_depths", np.float32))
_LISTED = (reads("listed", np.int32, "width", "height", 2),)

Caster = TypeVar("Caster", bound="Raycaster")


def device_volume(shared: Shared, resolved: ResolvedScene) -> DeviceVolume:
    """The scene's volume on the device, shared by all scenes of that volume."""
    return shared.keep("volume", resolved.volume, lambda: DeviceVolume(shared.context, resolved.volume), _KEPT)


class Raycaster:
    """Device state for a scene: volume, tables, distance map, program; ``render`` makes a frame.

    ``lanes``: rays that a work-item marches together (16 on CPU devices, 1 elsewhere). ``skip``: whether rays leap over
    empty space. ``tile``: pixels (width, height) of a work-item's tile. None of the three changes the picture.
    """

    held: Sequence[object] = ()
    _structs_match = False  # what the compiler makes of structs has not been compared yet
    march: March
    function: TransferFunction
    nodes: LookupNodes
    gate: tuple[float, float]
    spans: tuple[np.ndarray, np.ndarray]
    visible_share: float
    switches: dict[str, int]
    table: DeviceArray
    distances: DeviceArray
    warp: DeviceArray
    surface_cells: np.ndarray
    segment_steps: np.ndarray  # uint8 [z, y, x]: steps of a segment (step_map.py), where they follow the data
    _step_map: DeviceArray
    map_cells: tuple[int, ...]  # cells (x, y, z) of ``distances``, each of 2^map_shift lattice units
    map_shift: int
    octant_cells = 0  # as many, where a map per octant follows (cl/skip_empty.h); the maps of effects are alike
    visible_nodes: tuple[np.ndarray, np.ndarray]  # ``between`` and ``at`` of ``visible_mask``
    shown: np.ndarray  # bool [z, y, x]: cells in which anything can be seen
    volume_part: VolumePart | None = None

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        *,
        lanes: int | None = None,
        skip: bool = True,
        tile: tuple[int, int] = (TILE, TILE),
        volume: ResidentVolume | None = None,
        march: March | None = None,
        history: History | None = None,
    ) -> None:
        self.context = context
        self.march = march or RayMarch()
        self.resolved = resolved = self.march.adopt(reduced_for_frames(resolved))
        self.lanes = lanes_of(context, lanes)
        self.skip = skip
        shares_tiles = self.lanes > 1 or self.march.renders_all_pixels
        self.tile = tile if shares_tiles else (1, 1)
        self.volume: ResidentVolume = volume or DeviceVolume(context, resolved.volume)
        self.map_cells, self.map_shift = self.volume.cells, self.volume.cell_shift
        self.effects = EffectState(context, resolved, self.volume)
        self.view_dtype = view_dtype(self.volume.switches["VOXEL_BITS"])
        self.without_surfaces: Raycaster | None = None
        self.no_array = context.empty(np.float32, (4,))
        self._view = context.empty(self.view_dtype, (1,))
        self._pace: dict[str, float] = {}  # seconds per tile, by kernel
        self.history = history or History()
        self.set_transfer_function(resolved.transfer_function)

    @property
    def renders_all_pixels(self) -> bool:
        return self.march.renders_all_pixels

    def set_transfer_function(self, function: TransferFunction) -> None:
        """Another transfer function: rebuilds the table and the visible cells, and compiles nothing."""
        # The nodes do not depend on the cycle of colours, so it compiles nothing.
        self.nodes = scene_nodes(self.resolved, function)
        self.function = function
        self._set_colors()
        self._find_visible()

    def _find_visible(self) -> None:
        """Finds the cells in which anything can be seen, and what follows from them and from the voxels."""
        resolved, context, function = self.resolved, self.context, self.function
        mapped = device_function(shown_function(resolved, function), self.volume.values)
        visible = visible_cells(mapped, self.nodes.values)
        self.gate, self.spans = value_gate(mapped), shown_spans(mapped)
        at_nodes = mapped.opacity(self.nodes.values) > 0
        mask = visible_mask(self.volume, resolved.integration.filter, self.nodes, visible, at_nodes, self._moved)
        if resolved.isosurfaces:
            mask |= self._surface_cells()
        if resolved.integration.compositing != "over":  # a mean may be a value that occurs in no cell
            mask = np.full_like(mask, visible.any() or at_nodes.any())
            self.effects.set_hidden(hidden_score(resolved.integration.compositing, self.gate))
        fields = self.effects.switches and self.effects.fields
        if fields:
            mask = ((mask | fields.shown) & fields.kept) | bending_cells(self)
        self.shown = mask
        self.visible_share = float(mask.mean())
        self.switches = raycast_switches(
            resolved, lanes=self.lanes, skip=self.skip, function=function,
            varies=self.march.varies_steps and isinstance(self.volume, DeviceVolume),
        )
        if mask.all() and self.switches.get("CONSTANT_CELLS"):
            self.switches["SKIP_EMPTY"] = 0  # there is nothing to leap over, and rays look at another map
        self.map_cells, self.map_shift = self.volume.cells, self.volume.cell_shift
        self.octant_cells = 0
        self.visible_nodes = visible, at_nodes
        self.march.find_empty_space(self, mask)
        warp = self.nodes.warp
        self.warp = context.upload(np.zeros(2, np.float32) if warp is None else warp)
        self.switches |= self.volume.layout
        self.switches |= self.effects.switches  # those that respect the limits of the device
        self.switches |= self.march.switches()
        self.light_volume_samples = 0
        if self._casts_shadows:
            self._build_shadows()
        self.occlusion_samples = 0
        self._build_occlusion()
        self._follow_data()
        if self.switches.get("CONSTANT_CELLS"):
            self.effects.set_constant(distance_map(context, changing_cells(self), bool(self.octant_cells)))
        self.without_surfaces = without_surfaces(self)
        self.march.scene_changed(self)

    def _set_colors(self) -> None:
        """Builds the tables with the colours at the scene's time."""
        functions = layer_functions(self.resolved, self.function)
        moved = [cycled_function(self.resolved, function) for function in functions]
        self._functions = [device_function(function, self.volume.values) for function in moved]
        self._build_table()

    @property
    def _moved(self) -> Perturbation:
        resolved, volume = self.resolved, self.volume
        return perturbation(resolved.noise, resolved.volume.grid, volume.values.gain, volume.cell_shift)

    @property
    def _casts_shadows(self) -> bool:
        return bool(self.effects.switches.get("SHADOWS"))

    def _build_shadows(self) -> None:
        """Fills the light volume, where there is one. No camera changes it."""
        variant, own = self._sample_arguments
        if self.switches["SHADOWS"] == METHODS["volume"] and self.visible_share:
            self.effects.arrays["light_volume"], self.light_volume_samples = fill_light_volume(
                self.context, self.resolved, self.switches, self.volume_view(), variant, {**self._scene_arrays(), **own}
            )

    def _build_occlusion(self) -> None:
        """Finds the ambient occlusion, where there is one. No camera changes it."""
        effects = self.effects
        if effects.switches.get("AMBIENT_OCCLUSION") and self.visible_share:
            variant, own = self._sample_arguments
            arrays = {**self._scene_arrays(), **own}
            effects.arrays["occlusion"], self.occlusion_samples = fill_occlusion_volume(
                self.context, self.resolved, self.switches, self.volume_view(), effects.numbers, variant, arrays
            )

    def _scene_arrays(self) -> dict[str, DeviceArray]:
        return {"volume": self.volume.voxels, "table": self.table, "distances": self.distances}

    def _surface_cells(self) -> np.ndarray:
        """bool [z, y, x]: cells in which an iso-surface can be. The effects get the distances to them."""
        levels = [float(self.volume.values(s.value)) for s in self.resolved.isosurfaces]
        filter = self.resolved.integration.filter
        mask = surface_mask(self.volume, filter, levels, self._moved)
        if filter == "nearest":  # the region nearest to one voxel lies in two cells
            mask = dilated(mask)
        self.effects.set_surfaces(distance_map(self.context, mask))
        self.surface_cells = mask
        return mask

    def _build_table(self) -> None:
        origin = float(np.float32(self.nodes.first))
        functions, values = self._functions, self.volume.values
        tables, self.pieces = function_tables(self.resolved, functions, values, self.length, origin)
        self.step_units = self.length / functions[0].opacity_unit
        self.table = self.context.upload(tables)

    def _follow_data(self) -> None:
        """Finds how many steps a segment may have, if steps follow the data."""
        if self.switches.get("STEP_CELLS") and isinstance(self.volume, DeviceVolume):
            mapped = device_function(self.function, self.volume.values)
            self.segment_steps = step_map(self.context, self.resolved, self.volume, mapped, self.nodes.values)
            self._step_map = upload_steps(self.context, self.segment_steps)

    @property
    def length(self) -> float:
        """World length of a step."""
        return self.resolved.integration.step * self.resolved.volume.grid.smallest_edge

    def for_scene(self: Caster, resolved: ResolvedScene) -> Caster:
        """As ``Prepared.for_scene``: shares the volume, empty space, and often the tables."""
        other = copy.copy(self)
        other.resolved = resolved = self.march.adopt(reduced_for_frames(resolved))
        other.effects = self.effects.for_scene(resolved)
        if color_shift(resolved) != color_shift(self.resolved):
            other._set_colors()
        if other.length != self.length:
            other._build_table()
            other._follow_data()
        later = resolved.animation.time != self.resolved.animation.time
        moved = later and bool(resolved.all_noise)  # cycling moves no opacity
        if other._casts_shadows and (moved or shadow_step(resolved) != shadow_step(self.resolved)):
            other._build_shadows()
        if moved:
            other._build_occlusion()
        other.without_surfaces = without_surfaces(other)
        other.march = self.march.for_scene(other, self)
        return other

    def for_step(self: Caster, resolved: ResolvedScene) -> Caster | None:
        """As ``ChangesStep.for_step``: programs, tables and the buffer of voxels stay."""
        if not isinstance(self.volume, DeviceVolume) or type(self.march) is not RayMarch:
            return None
        reduced = self.march.adopt(reduced_for_frames(resolved))
        if effect_switches(reduced, DeviceLimits.of(self.context)) != self.effects.switches:
            return None  # an effect has no consequence in one of the two steps
        other = copy.copy(self)
        other.resolved = reduced
        self.volume.change(reduced.volume)
        self.history.forget()  # where rays contributed to another step
        other.effects = self.effects.for_step(reduced, self.volume)
        if color_shift(reduced) != color_shift(self.resolved):
            other._set_colors()
        if other.length != self.length:
            other._build_table()
        other._find_visible()
        return other

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:
        """As ``Prepared.render``. ``progress(tiles done, all)`` is called after each launch."""
        if isinstance(lattice, PixelList) and not self.lists_rays:
            return listed_by_tiles(self, camera, width, height, progress, depth, lattice)
        self.begin(camera, width, height, lattice)
        if isinstance(lattice, PixelList) or not self.march.renders_all_pixels or lattice.alone:
            return self._picture(camera, width, height, progress, depth, lattice)
        data = self._picture(camera, width, height, progress, depth, EVERY_PIXEL)
        shown = None if data.depth is None else data.depth[lattice.slices]
        return replace(data, rgba=data.rgba[lattice.slices], depth=shown)

    def _picture(
        self, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool, lattice: Pixels
    ) -> FrameData:
        if self.shows_nothing:  # nothing can be seen: no ray needs to be cast
            size = lattice.size(width, height)[::-1]
            nowhere = np.full(size, np.inf, np.float32) if depth else None
            return FrameData(np.zeros((*size, 4), np.float32), nowhere, 0, 0, self.nothing_counted)
        if lattice == EVERY_PIXEL and self.resolved.coherence.mode == "reproject":
            return render_from_history(self, self.history, camera, width, height, progress, depth)
        return WholePicture(self, camera, width, height, depth, lattice).render(progress)

    def cell_depths(self) -> np.ndarray | None:
        """As ``cell_depths``; None where bounds are not at hand."""
        return cell_depths(self.volume, self._functions[0], self.resolved.volume.grid.smallest_edge)

    def groups(
        self, frame: RayFrame, size: tuple[int, int], tiles: np.ndarray | None
    ) -> Iterator[np.ndarray | None]:
        """The groups in which ``tiles`` (int [n]; None: all) of a picture of ``size`` are rendered, one after another.
        What a group needs is on the device when it is given."""
        yield tiles

    def parts(
        self, camera: Camera, width: int, height: int, depth: bool = True, lattice: Pixels = EVERY_PIXEL
    ) -> PictureParts | None:
        """As ``RendersParts.parts``; None where nothing can be seen, and for lists that are rendered tile by tile."""
        if self.shows_nothing or (isinstance(lattice, PixelList) and not self.lists_rays):
            return None
        self.begin(camera, width, height, lattice)
        if lattice == EVERY_PIXEL and self.resolved.coherence.mode == "reproject":
            return parts_from_history(self, camera, width, height, depth)
        return PictureParts(self, camera, width, height, depth, lattice)

    def begin(self, camera: Camera, width: int, height: int, lattice: Pixels) -> None:
        """Announces a picture to the march; of a lattice ``alone`` that of its pixels."""
        if isinstance(lattice, PixelLattice) and lattice.alone:
            width, height = lattice.size(width, height)
        self.march.begin(self, camera, width, height)

    @property
    def lists_rays(self) -> bool:
        """Whether a kernel casts the rays of a list; otherwise the tiles that they are in are rendered."""
        return not self.march.renders_all_pixels

    @property
    def visible_cells(self) -> tuple[np.ndarray, int]:
        """As in ``Prepared``."""
        return self.shown, self.volume.cell_shift

    @property
    def nothing_counted(self) -> dict[str, int]:
        return dict.fromkeys(self.march.counters and self._counter_names, 0)

    @property
    def shows_nothing(self) -> bool:
        """Whether no ray needs to be cast."""
        return not self.visible_share and not self.switches.get("ENVIRONMENT_VISIBLE")

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        """Compiles everything that a frame of this size needs, by launching it: drivers finish compiling then."""
        warm_up(self, width, height, depth, None)

    def warm_up_parts(self, width: int, height: int, depth: bool = True) -> None:
        """As ``RendersParts.warm_up_parts``."""
        warm_up(self, width, height, depth, np.zeros(1, np.int64))

    def launches(
        self,
        name: str,
        view: np.ndarray,
        tiles: int,
        depth: bool,
        progress: TilesDone | None,
        outputs: dict[str, DeviceArray],
        chosen: np.ndarray | None = None,
        size: tuple[int, int] = (0, 0),
    ) -> DeviceArray | None:
        """Runs kernel ``name`` over all tiles, or those that ``chosen`` lists, in launches that are each kept short.
        ``size``: pixels (width, height) of the outputs. Returns uint32 [n, names], what was counted for these tiles, if
        anything is."""
        context = self.context
        switches = {**self.switches, "WITH_DEPTH": int(depth)}
        variant, more, added = self._more_arguments(tiles)
        declared = scene_arguments(switches["VOXEL_BITS"]) + variant
        fills = name == "fill_between_rays"
        declared += (_COARSE_ARGUMENTS if fills else ()) + (_LISTED if name == "listed_rays" else ())
        declared += picture_arguments(depth=depth)
        declared += (writes("rays", np.uint32, "tiles"),) if fills else ()
        declared += (COHERENT_ARGUMENTS if "kept" in outputs else ()) + more
        arrays = {**outputs, **added}
        sizes = dict(zip(("width", "height"), size)) | {"tiles": tiles}
        sizes |= dict(zip(("columns", "rows"), view["lattice"][0].tolist()))
        if "kept" in outputs:
            switches["COHERENT"] = 1
        if chosen is not None:
            switches["TILES_CHOSEN"] = 1
            declared += (reads("chosen", np.int32),)
            arrays["chosen"] = context.upload(chosen.astype(np.int32))
        self.check_structs(switches)
        kernel = self.march.kernel(context, name, declared, switches)
        pixels = tiles * self.tile[0] * self.tile[1] if view["image"][0, 0] else 0
        items = tiles if chosen is None else len(chosen)
        if pixels and name in self._pace:
            expected = _PACE_MARGIN * items * self._pace[name]
        else:
            expected = pixels * self._most_samples() * SECONDS_A_SAMPLE * (items / tiles)
        done = 0
        for first, count in bands(items, expected, _BAND_SECONDS):
            view["first_tile"] = first
            context.write_once(self._view, view)
            kernel(
                context.queue,
                (count * self.march.workers,),
                self.march.local_size(self.lanes),
                sizes=sizes,
                view=self._view,
                **self._scene_arrays(),
                **arrays,
            )
            done += count
            if done < items or progress is not None:
                context.finish()
            if progress is not None:
                progress(done)
        return added.get("counts")

    def took(self, name: str, tiles: int, seconds: float) -> None:
        """Remembers what ``tiles`` of kernel ``name`` took, by which launches are made neither long nor needlessly
        many."""
        self._pace[name] = seconds / max(tiles, 1)

    def _more_arguments(self, tiles: int) -> tuple[Arguments, Arguments, dict[str, DeviceArray]]:
        """The arguments that kernels take in addition to those of a scene of emission and absorption, for a launch over
        ``tiles``: those that follow the scene's, those at the end, and the arrays of both."""
        names = self._counter_names
        variant, added = self._sample_arguments
        if not names:
            return variant, (), added
        counts = self.context.output(np.uint32, (tiles, len(names)))
        own, arrays = self.march.arguments(self)
        return variant, own + counts_argument(len(names)), {**arrays, **added, "counts": counts}

    @property
    def _sample_arguments(self) -> tuple[Arguments, dict[str, DeviceArray]]:
        """The declared arguments, and the arrays, of whatever changes or replaces samples of the volume."""
        if self.switches.get("STEP_CELLS"):
            return (reads("steps", np.uint8),), {"steps": self._step_map}
        if not self.effects.switches:
            return (), {}
        return EFFECT_ARGUMENTS, self.effects.arrays

    @property
    def _counter_names(self) -> tuple[str, ...]:
        """Names of what the kernels count: first the march's, then the samples'."""
        of_levels = LEVEL_COUNTERS if self.switches.get("MINIFICATION") else ()
        return (*self.march.counters, *(COUNTERS if self.effects.switches else of_levels))

    def counted(self, counts: np.ndarray) -> dict[str, int]:
        """Sums by name of what tiles counted: ``counts`` uint32 [tiles, names]."""
        sums = counts.sum(axis=0, dtype=np.uint64)
        named = {name: int(total) for name, total in zip(self._counter_names, sums)}
        if not self.effects.switches:
            return named
        named = self.effects.counted(named)
        return {**named, "occlusion_samples": self.occlusion_samples} if self.occlusion_samples else named

    def _most_samples(self) -> float:
        corners = self.resolved.volume.grid.world_corners()
        diagonal = np.linalg.norm(corners.max(axis=0) - corners.min(axis=0))
        return float(diagonal / self.length)

    def frame_view(self, frame: RayFrame, width: int, height: int) -> np.ndarray:
        """``View`` [1] of a picture of ``width`` by ``height`` pixels with the rays of ``frame``."""
        return frame_view(self, frame, width, height)

    def volume_view(self) -> np.ndarray:
        """``View`` [1] with the members that do not depend on the camera."""
        return volume_view(self)

    def check_structs(self, switches: dict[str, int]) -> None:
        """RenderError where the device's compiler lays out structs differently from the host; looked at once, in the
        first program that is used. ``switches``: those of that program."""
        if not self._structs_match:
            self.march.check_structs(self, switches)
            self._structs_match = True

    @property
    def structs(self) -> dict[str, np.dtype]:
        """The structs that the program shares with the host, by name."""
        effects = {"Field": FIELD, "NoiseTerm": NOISE_TERM, "Effects": EFFECTS} if self.effects.switches else {}
        return {"View": self.view_dtype, **effects}


def lanes_of(context: DeviceContext, lanes: int | None = None) -> int:
    """Rays that a work-item marches together: ``lanes``, or the number that suits the device."""
    return lanes or (16 if context.is_cpu else 1)
