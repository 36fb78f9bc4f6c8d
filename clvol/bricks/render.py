"""Partial pictures of a scene whose volume is divided into bricks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clvol.bricks.composite import composited
from clvol.bricks.tree import Box, Tree, divided, most_boxes
from clvol.device.effect_switches import effect_switches
from clvol.errors import SceneError
from clvol.features import reduced_for_frames
from clvol.features.compression import is_compressed
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.integrator import INTEGRATOR
from clvol.integrators.raycast.part_volume import PartVolume
from clvol.integrators.registry import integrator_of
from clvol.opencl.context import DeviceContext
from clvol.render.renderer import open_context
from clvol.scene import load_scene
from clvol.scene.resolve import ResolvedScene
from clvol.volume.voxel_layout import padded_size

# Switches of effects that are no sum over a ray's segments, each of which depends on voxels beside it alone.
_NOT_IN_PARTS = {
    "SHADOWS": ("shadow", "and light comes to a brick through all others"),
    "ENVIRONMENT_VISIBLE": ("environment.visible", "behind which all others lie"),
    "REFRACTION": ("isosurface.refraction", "behind which rays go on through other bricks"),
    "NOISE": ("noise", "and it moves places from one brick to another"),
}


@dataclass(frozen=True)
class PartialPicture:
    """What a brick adds: ``rgba`` float32 [height, width, 4], premultiplied; ``samples`` of the volume; ``bytes`` of
    the voxels that were there."""

    rgba: np.ndarray
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
        resolved, box = self.resolved, self.boxes[number]
        volume = PartVolume(context, resolved, box.lower, box.upper)
        caster = Raycaster(context, resolved, volume=volume)
        image = resolved.image
        data = caster.render(resolved.camera, image.width, image.height, depth=False)
        return PartialPicture(data.rgba, data.samples, volume.nbytes)

    def composited(self, partial: Sequence[np.ndarray]) -> np.ndarray:
        """The whole picture, of those of all bricks by number."""
        image = self.resolved.image
        return composited((partial[number] for number in self.order()), image.height, image.width)


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
        (integration.compositing != "over", "integration.compositing", repr(integration.compositing), "'over'"),
        (integration.prefilter, "integration.prefilter", "true, which depends on all voxels", "false"),
        (integration.voxel_precision != "stored", "integration.voxel_precision", repr(integration.voxel_precision),
         "'stored'"),
        (image.ray_spacing > 1, "image.ray_spacing", str(image.ray_spacing), "1"),
        (image.samples > 1, "image.samples", str(image.samples), "1: edges of a brick are not those of the picture"),
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
    if count > (most := most_boxes(padded_size(resolved.volume))):
        raise SceneError(f"{resolved.origin}: volume", f"{count} bricks of so small a volume", f"at most {most}")


def render_in_bricks(
    context: DeviceContext, resolved: ResolvedScene, count: int, progress: Callable[[int, int], None] | None = None
) -> tuple[np.ndarray, int]:
    """The picture of ``resolved``, float32 [height, width, 4], from ``count`` bricks that are on the device one after
    the other; and the number of samples. It is that of the whole volume to within 1e-6 for early_termination = 0, and
    within early_termination otherwise, since each brick's rays end by themselves.

    SceneError for a scene that bricks cannot render.
    """
    bricks = bricks_of(resolved, count)
    partial, samples = [], 0
    for number in range(count):
        made = bricks.render(context, number)
        partial.append(made.rgba)
        samples += made.samples
        if progress is not None:
            progress(number + 1, count)
    return bricks.composited(partial), samples


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

    def close(self) -> None:
        self._context.release()
