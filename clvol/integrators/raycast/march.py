"""The march of rays through the samples of a scene: the part of a caster that does not depend on how its samples are
stored."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from clvol.device.arguments import Arguments
from clvol.device.empty_space import distance_map
from clvol.integrators.raycast.fine_cells import fine_masks
from clvol.opencl.context import DeviceArray, DeviceContext, Kernel
from clvol.opencl.struct_check import REPORT_ARGUMENTS, check_structs
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.volume.voxel_layout import FINE_SHIFT, MOST_OCTANT_CELLS

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster


class March(Protocol):
    """The differences between kernels that render a picture from the same samples.

    A march belongs to one caster, which passes itself to each method.
    """

    workers: int  # work-items of a tile
    varies_steps: bool  # its rays may take several steps at once (step_map.py)
    renders_all_pixels: bool  # pixels depend on their neighbours, so there are no sparse pictures
    counters: tuple[str, ...]  # names of its kernel's counters, which precede those of the samples

    def adopt(self, resolved: ResolvedScene) -> ResolvedScene:
        """The scene for the caster, without the parts that the march handles itself."""
        ...

    def switches(self) -> dict[str, int]:
        """The switches (-D) of the march, in addition to those of the samples."""
        ...

    def local_size(self, lanes: int) -> tuple[int] | None: ...

    def kernel(self, context: DeviceContext, name: str, declared: Arguments, switches: dict[str, int]) -> Kernel: ...

    def find_empty_space(self, caster: Raycaster, mask: np.ndarray) -> None:
        """Sets ``caster.distances``. ``mask`` bool [z, y, x]: the cells in which anything can be visible."""
        ...

    def scene_changed(self, caster: Raycaster) -> None:
        """Called once the transfer function, blocks, switches and empty space of the caster are final."""
        ...

    def for_scene(self, caster: Raycaster, before: Raycaster) -> March:
        """The march for ``caster``, made from ``before`` for another scene (``Prepared.for_scene``)."""
        ...

    def begin(self, caster: Raycaster, camera: Camera | None, width: int, height: int) -> None:
        """Announces a frame from ``camera``; None: a frame without pixels."""
        ...

    def arguments(self, caster: Raycaster) -> tuple[Arguments, dict[str, DeviceArray]]:
        """Declared arguments of its kernel, beyond those of the samples, and their arrays for the next launch."""
        ...

    def check_structs(self, caster: Raycaster, switches: dict[str, int]) -> None:
        """RenderError where the device's compiler lays out structs differently from the host, in the program of these
        ``switches``: one that is used anyway."""
        ...


def refined(caster: Raycaster, mask: np.ndarray) -> np.ndarray:
    """``mask`` in smaller cells, if that gains anything: those of the caster's maps, also of the one of surfaces, from
    now on."""
    found = fine_masks(caster, mask)
    if found is None:
        return mask
    mask, met = found
    caster.map_cells, caster.map_shift = mask.shape[::-1], FINE_SHIFT
    if caster.context.is_cpu and mask.size <= MOST_OCTANT_CELLS:
        caster.octant_cells = mask.size
    if met is not None:
        caster.effects.set_surfaces(distance_map(caster.context, met, bool(caster.octant_cells)))
    return mask


class RayMarch:
    """One independent ray per pixel (cl/raycast.cl)."""

    workers = 1
    varies_steps = True
    renders_all_pixels = False
    counters: tuple[str, ...] = ()

    def adopt(self, resolved: ResolvedScene) -> ResolvedScene:
        return resolved

    def switches(self) -> dict[str, int]:
        return {}

    def local_size(self, lanes: int) -> tuple[int] | None:
        return (1,) if lanes > 1 else None

    def kernel(self, context: DeviceContext, name: str, declared: Arguments, switches: dict[str, int]) -> Kernel:
        return context.kernel(f"{name}.cl", name, declared, switches)

    def find_empty_space(self, caster: Raycaster, mask: np.ndarray) -> None:
        # Fields have maps of the same cells, and noise moves what is in them. Where steps follow the data the picture
        # depends, within its error, on where leaps end.
        effects = caster.effects.switches
        plain = not effects or (effects.get("SEGMENT_OPACITIES") and not effects["NOISE"])
        surfaces = effects.get("ISOSURFACES") and not effects["NOISE"] and not effects["FIELDS"]
        if caster.skip and (plain or surfaces) and "STEP_CELLS" not in caster.switches:
            mask = refined(caster, mask)
        caster.distances = distance_map(caster.context, mask, bool(caster.octant_cells))

    def scene_changed(self, caster: Raycaster) -> None:
        pass

    def for_scene(self, caster: Raycaster, before: Raycaster) -> RayMarch:
        return self

    def begin(self, caster: Raycaster, camera: Camera | None, width: int, height: int) -> None:
        pass

    def arguments(self, caster: Raycaster) -> tuple[Arguments, dict[str, DeviceArray]]:
        return (), {}

    def check_structs(self, caster: Raycaster, switches: dict[str, int]) -> None:
        kernel = caster.context.kernel("raycast.cl", "struct_fields", REPORT_ARGUMENTS, switches)
        check_structs(caster.context, kernel, caster.structs)
