"""The ray caster as an integrator: rays through a volume that is on the device as a whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clvol.device.brick_pool import CodedBricks
from clvol.device.gradients import storing_switches
from clvol.device.light_volume import METHODS
from clvol.device.voxels import as_rendered
from clvol.encoding.coded_volume import EDGE, UndecodedVolume
from clvol.errors import SceneError
from clvol.features import GRADIENTS, effects
from clvol.features.compression import coded_source, is_compressed
from clvol.features.refuse import refuse_quadrature
from clvol.integrators.base import Prepared, Progress, Shared
from clvol.integrators.raycast.bricks import BrickCaster, BrickVolume
from clvol.integrators.raycast.caster import Raycaster, device_volume
from clvol.integrators.raycast.switches import raycast_switches
from clvol.integrators.whole_volume import WholeVolume
from clvol.scene.resolve import ResolvedScene
from clvol.volume.voxel_layout import holds_pairs

# Effects that read voxels in other ways than rays do, or others than the volume's own.
_OF_ALL_VOXELS = {"precomputed gradients", "prefilter"}
_KEPT = 3  # volumes as bricks


class Raycast(WholeVolume):
    """Samples along one ray per pixel, step by step or cell by cell, with all effects and all filters."""

    name = "raycast"
    tuned_as = "raycast"
    holds_codes = True

    def check(self, resolved: ResolvedScene) -> None:
        refuse_quadrature(resolved)
        if resolved.compression.decode == "resident" and (reason := needs_all_voxels(resolved)) is not None:
            where = f"{resolved.origin}: compression.decode"
            raise SceneError(where, f"got 'resident' in a scene that calls for {reason}", "'upload' or 'auto'")

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        return (resolved.compression.memory,) if isinstance(resolved.volume, UndecodedVolume) else ()

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        resolved = as_rendered(resolved)
        switches = {**raycast_switches(resolved, lanes=lanes), **_brick_switches(resolved)}
        programs = {"raycast.cl": switches}
        if resolved.image.ray_spacing > 1:
            programs["fill_between_rays.cl"] = switches
        if switches.get("SHADOWS") == METHODS["volume"]:
            programs["light_volume.cl"] = switches
        if switches.get("GRADIENT") == GRADIENTS["precomputed"]:
            programs["gradients.cl"] = storing_switches(switches, resolved.gradient.operator)
        return programs

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        return ("*.h",), b""

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        if isinstance(resolved.volume, UndecodedVolume) and needs_all_voxels(resolved) is None:
            return BrickCaster(shared.context, resolved, brick_volume(shared, resolved, resolved.volume))
        return Raycaster(shared.context, resolved, volume=device_volume(shared, resolved))


def brick_volume(shared: Shared, resolved: ResolvedScene, volume: UndecodedVolume) -> BrickVolume:
    """The bricks of ``volume``, shared by all scenes that allow them as much memory."""
    memory, context, codes = resolved.compression.memory_bytes, shared.context, volume.codes
    key = codes, memory

    def make() -> BrickVolume:
        source = CodedBricks(context, volume, codes.blocks, codes.codebooks, codes.coded, codes.name or "volume")
        return BrickVolume(context, source, memory, pairs=holds_pairs(volume))

    return shared.keep("bricks", key, make, _KEPT)


def _brick_switches(resolved: ResolvedScene) -> dict[str, int]:
    """The switches of codes that are to stay on the device."""
    if resolved.compression.decode != "resident" or not is_compressed(resolved):
        return {}
    source = coded_source(resolved.volume)
    return {"BRICKS": (EDGE if source is None else source.blocks.edge).bit_length() - 1}


def needs_all_voxels(resolved: ResolvedScene) -> str | None:
    """An effect of the scene for which all voxels have to be on the device at once; None if there is none."""
    for effect in effects(resolved):
        if effect.called_for and effect.name in _OF_ALL_VOXELS:
            return effect.name
    return "quantised voxels" if resolved.integration.voxel_precision != "stored" else None


INTEGRATOR = Raycast()
