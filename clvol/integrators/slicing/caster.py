"""Slices of a volume that is on the device as a whole: the host side of cl/march_slices.h."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from clvol.device.arguments import Arguments
from clvol.features import SLICES
from clvol.features.vocabulary import ACCUMULATE
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.march import RayMarch
from clvol.integrators.slicing.slices import SlicePlaces, slice_places
from clvol.opencl import structs
from clvol.opencl.arguments import reads
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.scene.slicing import Slicing

_SHAPES = {
    "object-aligned": "along-axis",
    "object-aligned-interpolated": "along-axis",
    "view-aligned": "along-view",
    "shells": "shells",
    "half-angle": "along-view",  # of scenes in which nothing is lit
}
_NOWHERE = SlicePlaces(0.0, 1.0, 1.0, 0)  # those of a picture without pixels


class SlicesMarch(RayMarch):
    """A ``March`` from slice to slice of its ``places``, which depend on the camera."""

    varies_steps = False

    def __init__(self, settings: Slicing) -> None:
        self.settings = settings
        self.places = _NOWHERE

    def switches(self) -> dict[str, int]:
        return slicing_switches(self.settings)

    def for_scene(self, caster: Raycaster, before: Raycaster) -> SlicesMarch:
        return copy.copy(self)

    def begin(self, caster: Raycaster, camera: Camera | None, width: int, height: int) -> None:
        self.places = _NOWHERE if camera is None else slice_places(caster.resolved, camera, caster.volume.size)

    def row(self) -> np.ndarray:
        """``Slices`` [1] of cl/slices.h."""
        row = np.zeros(1, structs.SLICES)
        for name in structs.SLICES.names or ():
            row[name] = getattr(self.places, name)
        return row


class SlicingCaster(Raycaster):
    """A ``Raycaster`` with a ``SlicesMarch``, for scenes of emission and absorption. Nothing is leapt over: slices are
    drawn whole."""

    march: SlicesMarch

    def __init__(self, context: DeviceContext, resolved: ResolvedScene, **more: Any) -> None:
        super().__init__(context, resolved, skip=False, march=SlicesMarch(resolved.slicing), **more)

    @property
    def structs(self) -> dict[str, np.dtype]:
        return {**super().structs, "Slices": structs.SLICES}

    @property
    def _sample_arguments(self) -> tuple[Arguments, dict[str, DeviceArray]]:
        return (reads("slices", structs.SLICES),), {"slices": self.context.upload(self.march.row())}


def slicing_switches(settings: Slicing) -> dict[str, int]:
    """The switches (-D) of cl/march_slices.h, without those of the samples."""
    return {
        "SLICES": SLICES[_SHAPES[settings.geometry]],
        "ACCUMULATE": ACCUMULATE[settings.accumulate],
        "OPACITY_CORRECTION": int(settings.opacity_correction),
    }
