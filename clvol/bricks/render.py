"""Partial pictures of a scene whose volume is divided into bricks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clvol.bricks.composite import put_together, winners
from clvol.bricks.tree import Box, Tree, divided, most_boxes
from clvol.device.effect_switches import effect_switches
from clvol.errors import SceneError
from clvol.features import reduced_for_frames
from clvol.features.compression import is_compressed
from clvol.features.vocabulary import OPACITY_FACTORS
from clvol.integrators.base import FrameData
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.integrator import INTEGRATOR
from clvol.integrators.raycast.part_volume import PartVolume
from clvol.integrators.registry import integrator_of
from clvol.opencl.context import DeviceContext
from clvol.render.renderer import open_context
from clvol.scene import load_scene
from clvol.scene.resolve import ResolvedScene
from clvol.volume.voxel_layout import padded_size

_COMPOSITINGS = ("over", "maximum", "minimum")
_NEARLY = 1e-6  # opacity: in which of two bricks it reaches one half may depend on rounding
# Switches of effects that are no sum over a ray's segments, each of which depends on voxels beside it alone.
_NOT_IN_PARTS = {
    "SHADOWS": ("shadow", "and light comes to a brick through all others"),
    "AMBIENT_OCCLUSION": ("ambient_occlusion", "and matter in one brick takes light from another"),
    "ENVIRONMENT_VISIBLE": ("environment.visible", "behind which all others lie"),
    "REFRACTION": ("isosurface.refraction", "behind which rays go on through other bricks"),
    "CURVED_RAYS": ("refraction", "and rays bend from one brick to another"),
    "NOISE": ("noise", "and it moves places from one brick to another"),
}


@dataclass(frozen=True)
class PartialPicture:
    """What a brick adds: ``pixels`` float32 [height, width, 4], premultiplied, and the score of each as a fifth channel
    where the brick with the highest one shows; ``samples`` of the volume; ``bytes`` of the voxels that were there."""

    pixels: np.ndarray
    samples: int
    bytes: int


@dataclass(frozen=True, eq=False)
class Bricks:
    """The bricks of a scene, with even steps."""

    resolved: ResolvedScene
    tree: Tree

    @property
    def boxes(self) -> list[Box]:
        return self.tree.boxes

    def order(self) -> list[int]:
        """The numbers of the bricks as the scene's camera sees them, nearer ones first."""
        camera, grid = self.resolved.camera, self.resolved.volume.grid
        to_lattice = grid.world_to_index()
        forward = to_lattice[:3, :3] @ camera.basis()[0]
        position = np.append(np.asarray(camera.position, np.float64), 1.0)
        eye = None if camera.projection == "orthographic" else (to_lattice @ position)[:3]
        return list(self.tree.front_to_back(eye, forward))

    def render(self, context: DeviceContext, number: int) -> PartialPicture:
        """The partial picture of a brick: its voxels are read, rendered and forgotten."""
        image = self.resolved.image
        if not self.projects:
            data, volume = self._rendered(context, number, None)
            return PartialPicture(data.rgba, data.samples, volume.nbytes)
        data, volume = self._rendered(context, number, np.zeros((image.height, image.width), np.float32))
        assert data.depth is not None  # the scores
        pixels = np.concatenate([data.rgba, data.depth[..., None]], axis=-1)
        return PartialPicture(pixels, data.samples, volume.nbytes)

    @property
    def projects(self) -> bool:
        """Whether one sample of each ray shows."""
        return self.resolved.integration.compositing != "over"

    def _rendered(
        self, context: DeviceContext, number: int, in_front: np.ndarray | None
    ) -> tuple[FrameData, PartVolume]:
        """A brick from the scene's camera, with depth where something is ``in_front``."""
        resolved, box, image = self.resolved, self.boxes[number], self.resolved.image
        volume = PartVolume(context, resolved, box.lower, box.upper)
        volume.in_front = in_front
        caster = Raycaster(context, resolved, volume=volume)
        return caster.render(resolved.camera, image.width, image.height, depth=in_front is not None), volume

    def depth(self, context: DeviceContext, number: int, in_front: np.ndarray) -> np.ndarray:
        """float32 [height, width]: where opacity reaches one half within the brick ``number``, as ``Frame.depth``;
        infinite elsewhere. ``in_front`` as ``in_front()`` gives it."""
        found = self._rendered(context, number, in_front)[0].depth
        assert found is not None  # as requested
        return found

    def in_front(self, last: Sequence[np.ndarray]) -> Iterator[tuple[int, np.ndarray]]:
        """The bricks within which opacity may reach one half, nearer ones first, with the opacity in front of each:
        float32 [height, width]. Of a projection, those that show in some pixel: 1 there, and -1 elsewhere. ``last``
        float32 [height, width]: the last channel of the pixels of all bricks by number."""
        if self.projects:
            order = self.order()
            chosen = winners([last[number] for number in order])
            for place, number in enumerate(order):
                if (chosen == place).any():
                    yield number, np.where(chosen == place, 1.0, -1.0).astype(np.float32)
            return
        left = np.ones(last[0].shape)
        for number in self.order():
            behind = left * (1.0 - last[number].astype(np.float64))
            if ((left > 0.5 - _NEARLY) & (behind <= 0.5 + _NEARLY)).any():
                yield number, (1.0 - left).astype(np.float32)
            left = behind

    def composited(self, partial: Sequence[np.ndarray]) -> np.ndarray:
        """The whole picture, of those of all bricks by number."""
        image = self.resolved.image
        return put_together((partial[number] for number in self.order()), image.height, image.width)


def bricks_of(resolved: ResolvedScene, count: int) -> Bricks:
    """``resolved`` in ``count`` bricks. SceneError for a scene that bricks cannot render, with the reason."""
    check_bricks(resolved, count)
    integration = resolved.integration.model_copy(update={"step_error": 0.0})
    gradient = resolved.gradient.model_copy(update={"storage": "on-the-fly"})
    in_parts = replace(resolved, integration=integration, gradient=gradient)
    return Bricks(in_parts, divided(padded_size(resolved.volume), count))


def check_bricks(resolved: ResolvedScene, count: int) -> None:
    """SceneError if the scene cannot be rendered in ``count`` bricks."""
    integration, image = resolved.integration, resolved.image
    asked: list[tuple[bool, str, str, str]] = [
        (integrator_of(resolved) is not INTEGRATOR, "integration.method", repr(integration.method), "'raycast'"),
        (integration.quadrature != "steps", "integration.quadrature", repr(integration.quadrature), "'steps'"),
        (integration.compositing not in _COMPOSITINGS, "integration.compositing", repr(integration.compositing),
         "'over', 'maximum' or 'minimum', which a brick's pixels tell all of"),
        (integration.minification != "off", "integration.minification", repr(integration.minification), "'off'"),
        (integration.prefilter, "integration.prefilter", "true, which depends on all voxels", "false"),
        (integration.voxel_precision != "stored", "integration.voxel_precision", repr(integration.voxel_precision),
         "'stored'"),
        (image.ray_spacing > 1, "image.ray_spacing", str(image.ray_spacing), "1"),
        (image.samples > 1, "image.samples", str(image.samples), "1: edges of a brick are not those of the picture"),
        (bool(resolved.channels), "volume.channels", "several values per voxel", "one"),
        (any(field.role == "color" for field in resolved.fields), "field", "colours of voxels", "a scene without"),
        (is_compressed(resolved), "compression", "codes in place of voxels", "voxels as they are"),
        (resolved.volume.dtype == np.float64, "volume", "float64 voxels", "float32 or integers"),
    ]  # fmt: skip
    for is_wrong, key, got, expected in asked:
        if is_wrong:
            raise SceneError(f"{resolved.origin}: {key}", f"got {got} for bricks", expected)
    switches = effect_switches(reduced_for_frames(resolved))
    for switch, (key, reason) in _NOT_IN_PARTS.items():
        if switches.get(switch):
            raise SceneError(f"{resolved.origin}: {key}", f"got it for bricks, {reason}", "a scene without")
    if switches.get("OPACITY_FACTORS", 0) & OPACITY_FACTORS["fur"]:
        what = "got target 'fur' for bricks, and its noise is fixed to the whole volume"
        raise SceneError(f"{resolved.origin}: noise", what, "a scene without")
    if count > (most := most_boxes(padded_size(resolved.volume))):
        raise SceneError(f"{resolved.origin}: volume", f"{count} bricks of so small a volume", f"at most {most}")


def nearest(depths: Iterable[np.ndarray], height: int, width: int) -> np.ndarray:
    """float32 [height, width]: of each pixel the first of ``depths`` that is finite; infinite where none is."""
    found = np.full((height, width), np.inf, np.float32)
    for depth in depths:
        np.copyto(found, depth, where=np.isinf(found))
    return found


def render_in_bricks(
    context: DeviceContext, resolved: ResolvedScene, count: int, progress: Callable[[int, int], None] | None = None,
    depth: bool = False,
) -> tuple[np.ndarray, np.ndarray | None, int]:  # fmt: skip
    """The picture of ``resolved``, float32 [height, width, 4], from ``count`` bricks that are on the device one after
    the other; its ``depth``, float32 [height, width], if that is wanted; and the number of samples. It is that of the
    whole volume to within 1e-6 for early_termination = 0, and within early_termination otherwise, since each brick's
    rays end by themselves.

    SceneError for a scene that bricks cannot render.
    """
    bricks = bricks_of(resolved, count)
    partial, samples = [], 0
    for number in range(count):
        made = bricks.render(context, number)
        partial.append(made.pixels)
        samples += made.samples
        if progress is not None:
            progress(number + 1, count)
    depths = None
    if depth:  # of those bricks once more, now that it is known what is in front of them
        places = bricks.in_front([each[..., -1] for each in partial])
        found = (bricks.depth(context, number, in_front) for number, in_front in places)
        depths = nearest(found, resolved.image.height, resolved.image.width)
    return bricks.composited(partial), depths, samples


class BricksRun:
    """Renders bricks of a scene in this process, one by one. The scene is loaded once, without its voxels where they
    can be read in parts. ``overrides`` and ``count`` as for ``load_scene`` and ``bricks_of``."""

    def __init__(
        self, path: str, overrides: Sequence[str], count: int, devices: Sequence[str] | None, memory_cap: int | None
    ) -> None:
        self._bricks = bricks_of(load_scene(path, overrides).resolve(memory_cap), count)
        self._context = open_context(devices)

    def make(self, number: int) -> PartialPicture:
        return self._bricks.render(self._context, number)

    def depth(self, number: int, in_front: np.ndarray) -> np.ndarray:
        return self._bricks.depth(self._context, number, in_front)

    def close(self) -> None:
        self._context.release()
