"""The method "multiresolution" as an integrator: blocks at the levels that pictures need, within a budget of memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from clvol.device.light_volume import METHODS
from clvol.device.voxels import as_rendered
from clvol.errors import SceneError
from clvol.features import called_for, reduced_for_frames
from clvol.features.refuse import PLAIN, refuse_effects, refuse_keys, refuse_quadrature, refuse_sparse_rays
from clvol.integrators.base import Prepared, Progress, Shared
from clvol.integrators.multiresolution.caster import block_switches
from clvol.integrators.multiresolution.coded_residency import CodedResidency
from clvol.integrators.multiresolution.coded_source import CodedSource, is_coded
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.residency import (
    Residency,
    block_source,
    bytes_of_fields,
    memory_of_blocks,
)
from clvol.integrators.multiresolution.sample_allocator import map_shift, most_bytes
from clvol.integrators.pyramid.blocks import block_pyramid_switches
from clvol.integrators.pyramid.layout import block_pyramid_bytes
from clvol.integrators.raycast.history import unsupported
from clvol.integrators.raycast.reprojection import MARGIN
from clvol.scene.resolve import ResolvedScene
from clvol.scene.sizes import format_size
from clvol.store.geometry import BlockGrid
from clvol.volume import Volume
from clvol.volume.lazy import FilledVolume

if TYPE_CHECKING:
    from clvol.scene import Scene

_KEYS = {
    "filter": ("linear",),
    "quadrature": ("steps",),
    "classification": ("post", "preintegrated"),
    "voxel_precision": ("stored",),
}
_EFFECTS = PLAIN | {
    "clipping", "lighting", "specular", "spot lights", "image lights", "environment", "environment background",
    "gradients", "depth cueing", "isosurfaces", "projection", "shadows", "scattering",
    "label field", "density field", "mask field", "color field", "noise", "associated colours", "ambient occlusion",
    "gradient opacity", "directional opacity", "fur", "two-dimensional transfer function", "joint transfer function",
    "light at both ends", "attenuation noise", "refraction",
}  # fmt: skip
_FAR_RAYS = {
    "shadows": "pass blocks of all tiles at once",
    "ambient occlusion": "pass blocks of all tiles at once",
    "refraction": "bend to blocks of other tiles",
}
_BUDGETS = 2  # volumes and budgets whose blocks stay resident: they hold all the memory


class Multiresolution:
    """Levels of detail per block, chosen by the picture's error, within ``multiresolution.memory``."""

    name = "multiresolution"
    reads_blocks = True
    holds_codes = False
    tuned_as = "multiresolution"

    def check(self, resolved: ResolvedScene) -> None:
        refuse_keys(resolved, _KEYS)  # first, since some of these keys are effects, too
        origin = resolved.origin
        if isinstance(resolved.volume, FilledVolume):
            where = f"{origin}: volume.nan"
            what = "got a number for a store with NaN voxels, with the method 'multiresolution'"
            expected = "'transparent', or a store made with that number, or the method 'raycast'"
            raise SceneError(where, what, expected)
        if _slices(resolved):
            self._check_slices(resolved)
        if resolved.compression.decode == "resident":
            self._check_far_rays(resolved)
            self._check_codes(resolved)
        if _slices(resolved):
            refuse_effects(resolved, "multiresolution.stepping", "pyramid", "limited", PLAIN)
        refuse_effects(resolved, "integration.method", self.name, "raycast", _EFFECTS)
        self._check_gradients(resolved)
        self._check_fields(resolved)
        refuse_quadrature(resolved)

    def _check_fields(self, resolved: ResolvedScene) -> None:
        settings, taken = resolved.multiresolution, bytes_of_fields(resolved)
        if 2 * taken > settings.memory_bytes:
            where = f"{resolved.origin}: multiresolution.memory"
            what = f"got {settings.memory}, of which the voxels of fields take {format_size(taken)}"
            raise SceneError(where, what, f"at least {format_size(2 * taken)}, or smaller fields")

    def _check_far_rays(self, resolved: ResolvedScene) -> None:
        """SceneError where rays pass blocks of all tiles at once, of codes that are decoded tile by tile."""
        needed = called_for(resolved)
        for name, rays in _FAR_RAYS.items():
            if name in needed:
                where = f"{resolved.origin}: compression.decode"
                what = f"got 'resident' in a scene with {name}, whose rays {rays}"
                raise SceneError(where, what, f"'auto', or a scene without {name}")

    def _check_gradients(self, resolved: ResolvedScene) -> None:
        got = resolved.gradient.storage
        if got == "precomputed" and "gradients" in called_for(resolved):
            where = f"{resolved.origin}: gradient.storage"
            what = f"got {got!r} with the method 'multiresolution', whose blocks change with the view"
            raise SceneError(where, what, "'auto' or 'on-the-fly', or the method 'raycast'")

    def _check_codes(self, resolved: ResolvedScene) -> None:
        where, got = f"{resolved.origin}: compression.decode", "got 'resident' with the method 'multiresolution'"
        if not is_coded(block_source(resolved.volume)):
            what = f"{got} and a volume that is no store of codes of all levels"
            raise SceneError(where, what, "'auto', or a store of codes, or the method 'raycast'")
        settings = resolved.multiresolution
        for key, plain in (("tiles", 0), ("stepping", None)):
            value = getattr(settings, key)
            if value == "pyramid" or (plain is not None and value != plain):
                raise SceneError(where, f"{got} and {key} = {value!r}", "'auto', or pictures of a ray for every pixel")

    def _check_slices(self, resolved: ResolvedScene) -> None:
        refuse_sparse_rays(resolved, "stepping")
        kind, tiles = resolved.integration.classification, resolved.multiresolution.tiles
        if kind != "preintegrated":
            where = f"{resolved.origin}: multiresolution.stepping"
            expected = "the classification 'preintegrated', or another stepping"
            raise SceneError(where, f"got 'pyramid' with the classification {kind!r}", expected)
        if tiles:
            where = f"{resolved.origin}: multiresolution.tiles"
            raise SceneError(where, f"got {tiles} with the stepping 'pyramid'", "0, or another stepping")

    def refines_in_time(self, scene: Scene | ResolvedScene) -> bool:
        return not _slices(scene) and scene.compression.decode != "resident"

    def device_bytes(self, volume: Volume, scene: Scene | ResolvedScene) -> int:
        budget = scene.multiresolution.memory_bytes
        source = getattr(volume, "blocks_source", None)
        blocks = BlockGrid(volume.shape) if source is None else source.blocks
        fields = bytes_of_fields(scene) if isinstance(scene, ResolvedScene) else 0
        needed = min(most_bytes(blocks, volume.dtype, budget) + fields, budget)
        if _slices(scene):
            edge = blocks.edge >> map_shift(blocks, budget)
            z, y, x = blocks.counts
            needed += block_pyramid_bytes((z * edge, y * edge, x * edge), scene)
        return needed + scene.image.width * scene.image.height * 20

    def how_shown(self, resolved: ResolvedScene) -> Mapping[str, str]:
        return {}

    def memory_advice(self, scene: Scene | ResolvedScene) -> tuple[str, str]:
        return f"at most {scene.multiresolution.memory} of blocks, ", ", or less multiresolution.memory"

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        resolved = reduced_for_frames(resolved)
        of_samples = {"VOXEL_PAIRS": 0, "SAMPLE_BUFFERS": 1}  # one buffer holds all samples
        if _slices(resolved):
            return {"pyramid.cl": block_pyramid_switches(resolved, lanes) | of_samples}
        switches = block_switches(resolved, lanes, True) | of_samples
        reprojects = resolved.coherence.mode == "reproject" and not unsupported(resolved, switches)
        programs = {"raycast.cl": {**switches, **({"COHERENT": 1} if reprojects else {})}}
        if reprojects:
            programs["reproject.cl"] = {"MARGIN": MARGIN}
        if resolved.multiresolution.tiles:
            programs["tile_rays.cl"] = switches
        if resolved.image.refines:
            programs["listed_rays.cl"] = switches
        if switches.get("SHADOWS") == METHODS["volume"]:
            programs["light_volume.cl"] = switches
        if switches.get("AMBIENT_OCCLUSION"):
            programs["occlusion_volume.cl"] = switches
        return programs

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        return ("block_cells.cl", "*.h"), b""

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        settings = resolved.multiresolution
        of_slices = (resolved.pyramid.levels,) if _slices(resolved) else ()
        return settings, resolved.compression.decode == "resident", *of_slices

    def simplified(self, resolved: ResolvedScene, shared: Shared) -> ResolvedScene:
        return as_rendered(resolved, shared.keep)

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        source, memory = block_source(resolved.volume), memory_of_blocks(resolved)
        if resolved.compression.decode == "resident" and is_coded(source):
            coded = cast(CodedSource, source)
            codes = shared.keep(
                "resident codes", (resolved.volume, memory), lambda: CodedResidency(shared.context, coded, resolved),
                _BUDGETS,
            )  # fmt: skip
            return MultiresolutionEngine(shared.context, resolved, codes, progress, wait)
        key = resolved.volume, memory
        residency = shared.keep("resident blocks", key, lambda: Residency(shared.context, resolved), _BUDGETS)
        return MultiresolutionEngine(shared.context, resolved, residency, progress, wait)

    def ask_again(self, prepared: Any, progress: Progress | None, wait: bool | None) -> None:
        if wait is not None:
            prepared.ask(wait, progress)


def _slices(scene: Scene | ResolvedScene) -> bool:
    return scene.multiresolution.stepping == "pyramid"


INTEGRATOR = Multiresolution()
