"""How rays go through the samples of a scene: a part of a caster, beside where its samples are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from clvol.device.empty_space import distance_map
from clvol.errors import RenderError
from clvol.opencl.context import DeviceArray, DeviceContext, Kernel
from clvol.opencl.structs import effects_dtype
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster


class March(Protocol):
    """What differs between kernels that render a picture from the same samples.

    A march belongs to one caster, which hands itself over.
    """

    workers: int  # work-items of a tile
    renders_all_pixels: bool  # pixels depend on their neighbours: there are no sparse pictures
    counters: tuple[str, ...]  # names of what its kernel counts, before what samples count

    def adopt(self, resolved: ResolvedScene) -> ResolvedScene:
        """What is left of the scene for the caster, without what the march sees to by itself."""
        ...

    def switches(self) -> dict[str, int]:
        """What is compiled for it, beside the switches of the samples."""
        ...

    def local_size(self, lanes: int) -> tuple[int] | None: ...

    def kernel(self, context: DeviceContext, name: str, declared: str, switches: dict[str, int]) -> Kernel: ...

    def find_empty_space(self, caster: Raycaster, mask: np.ndarray) -> None:
        """``mask`` bool [z, y, x]: the cells in which anything can be seen. Sets ``caster.distances``."""
        ...

    def scene_changed(self, caster: Raycaster) -> None:
        """Called when transfer function, blocks, switches and empty space of the caster are as they will be."""
        ...

    def for_scene(self, caster: Raycaster, before: Raycaster) -> March:
        """For ``caster``, which was ``before`` and got another scene (``Prepared.for_scene``)."""
        ...

    def begin(self, caster: Raycaster, camera: Camera | None, width: int, height: int) -> None:
        """A frame from ``camera`` follows; None: one without pixels."""
        ...

    def arguments(self, caster: Raycaster) -> tuple[str, dict[str, DeviceArray]]:
        """Declared arguments of its kernel, beside those of the samples, and what they are for the next launch."""
        ...

    def check_structs(self, caster: Raycaster) -> None:
        """RenderError where the compiler lays out structs in another way than the host."""
        ...


class RayMarch:
    """A ray per pixel, by itself (cl/raycast.cl)."""

    workers = 1
    renders_all_pixels = False
    counters: tuple[str, ...] = ()

    def adopt(self, resolved: ResolvedScene) -> ResolvedScene:
        return resolved

    def switches(self) -> dict[str, int]:
        return {}

    def local_size(self, lanes: int) -> tuple[int] | None:
        return (1,) if lanes > 1 else None

    def kernel(self, context: DeviceContext, name: str, declared: str, switches: dict[str, int]) -> Kernel:
        return context.kernel(f"{name}.cl", name, declared, switches)

    def find_empty_space(self, caster: Raycaster, mask: np.ndarray) -> None:
        caster.distances = distance_map(caster.context, mask)

    def scene_changed(self, caster: Raycaster) -> None:
        pass

    def for_scene(self, caster: Raycaster, before: Raycaster) -> RayMarch:
        return self

    def begin(self, caster: Raycaster, camera: Camera | None, width: int, height: int) -> None:
        pass

    def arguments(self, caster: Raycaster) -> tuple[str, dict[str, DeviceArray]]:
        return "", {}

    def check_structs(self, caster: Raycaster) -> None:
        kernel = caster.context.kernel("raycast.cl", "view_size", "out size uint32", caster.switches)
        size = caster.context.empty(np.uint32, (2,))
        kernel(caster.context.queue, (1,), (1,), size=size)
        check_sizes(caster.context.read(size), {"View": caster.view_dtype, "Effects": effects_dtype()})


def check_sizes(on_device: np.ndarray, ours: dict[str, np.dtype]) -> None:
    """RenderError where structs of the device and of the host differ in size (bytes)."""
    for size, (name, dtype) in zip(on_device, ours.items()):
        if size != dtype.itemsize:
            raise RenderError(f"struct {name}", f"{size} bytes on the device", f"{dtype.itemsize}")
