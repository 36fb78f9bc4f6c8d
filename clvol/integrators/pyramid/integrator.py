"""The method "pyramid" as an integrator: adaptive sampling along rays and across them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from clvol.device.voxels import as_rendered
from clvol.encoding.coded_volume import UndecodedVolume
from clvol.errors import SceneError
from clvol.features import emits, reduced_for_frames
from clvol.features.refuse import PLAIN, refuse_effects, refuse_keys, refuse_quadrature, refuse_sparse_rays
from clvol.integrators.base import Prepared, Progress, Shared
from clvol.integrators.pyramid.bricks import BrickPyramidCaster
from clvol.integrators.pyramid.caster import PyramidCaster, pyramid_switches
from clvol.integrators.pyramid.clips import halves_of
from clvol.integrators.pyramid.layout import pyramid_bytes
from clvol.integrators.pyramid.oracles import names, oracle_named
from clvol.integrators.raycast.caster import device_volume
from clvol.integrators.resident_codes import brick_switches, bricks_for, check_resident
from clvol.integrators.whole_volume import WholeVolume
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume

if TYPE_CHECKING:
    from clvol.scene import Scene

# Segments have many lengths, and pixels are interpolated from their neighbours.
_KEYS = {
    "filter": ("linear", "cubic", "catmull-rom"),
    "quadrature": ("steps",),
    "classification": ("preintegrated",),
    "compositing": ("over",),
}
_EFFECTS = PLAIN | {
    "cubic filter", "catmull-rom filter", "prefilter", "clipping", "colour cycling", "lighting", "specular",
    "spot lights", "image lights",
    "environment", "environment background", "shadows", "scattering", "gradients", "sobel gradients",
    "precomputed gradients", "gradient opacity", "directional opacity", "depth cueing", "isosurfaces",
}  # fmt: skip


class Pyramid(WholeVolume):
    """Slices of pixels at many levels of detail, sampled only where an oracle requires it."""

    name = "pyramid"
    tuned_as = "pyramid"
    holds_codes = True

    def check(self, resolved: ResolvedScene) -> None:
        origin, oracle = resolved.origin, resolved.pyramid.oracle
        if oracle not in names():
            expected = " or ".join(map(repr, names()))
            raise SceneError(f"{origin}: pyramid.oracle", f"got {oracle!r}", expected)
        refuse_keys(resolved, _KEYS)
        refuse_sparse_rays(resolved, "method")
        if halves_of(reduced_for_frames(resolved).clips) is None:
            what = (
                "got clips that leave more than one stretch of a ray, or are of many planes, "
                "with the method 'pyramid'"
            )
            expected = "planes and boxes that keep what is inside, 16 planes in all, or the method 'raycast'"
            raise SceneError(f"{origin}: clip", what, expected)
        refuse_effects(resolved, "integration.method", self.name, "raycast", _EFFECTS)
        _check_shadows(resolved)
        refuse_quadrature(resolved)
        check_resident(resolved)

    def device_bytes(self, volume: Volume, scene: Scene | ResolvedScene) -> int:
        return super().device_bytes(volume, scene) + pyramid_bytes(volume, scene)

    def how_shown(self, resolved: ResolvedScene) -> Mapping[str, str]:
        sampled = "; where it meets one it is sampled at every step" if emits(reduced_for_frames(resolved)) else ""
        return {"isosurfaces": f"each pixel's ray looks for them{sampled}"}

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        resolved = as_rendered(resolved)
        return {"pyramid.cl": {**pyramid_switches(resolved, lanes), **brick_switches(resolved)}}

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        folder = oracle_named(resolved.pyramid.oracle).folder
        custom = b"" if folder is None else (folder / "oracle_custom.h").read_bytes()
        return ("oracle_cells.cl", "oracle_visible.cl", "*.h"), custom

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        memory = (resolved.compression.memory,) if isinstance(resolved.volume, UndecodedVolume) else ()
        return (resolved.pyramid, oracle_named(resolved.pyramid.oracle), *memory)

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        if (bricks := bricks_for(shared, resolved)) is not None:
            return BrickPyramidCaster(shared.context, resolved, bricks)
        return PyramidCaster(shared.context, resolved, volume=device_volume(shared, resolved))


def _check_shadows(resolved: ResolvedScene) -> None:
    """SceneError for shadows that need rays of their own, and for those of what is clipped."""
    scene = reduced_for_frames(resolved)
    if scene.shadow is None:
        return
    if scene.shadow.method == "rays":
        what = "got 'rays' with the method 'pyramid', whose maps of empty space are not those of shadow rays"
        raise SceneError(f"{resolved.origin}: shadow.method", what, "'volume', or the method 'raycast'")
    if scene.clips:
        what = "got 'pyramid' in a scene with clips and shadows, of which its light volume would know none"
        raise SceneError(f"{resolved.origin}: integration.method", what, "'raycast', or a scene without one of them")


INTEGRATOR = Pyramid()
