"""The integrator "pyramid" on a volume that is on the device as a whole."""

from __future__ import annotations

from clvol.device.effect_switches import effect_switches
from clvol.device.empty_space import distance_map
from clvol.device.volume import DeviceVolume
from clvol.features import reduced_for_frames
from clvol.integrators.pyramid.march import (
    TILE,
    SliceMarch,
    cut_face_switches,
    march_switches,
    without_clips,
    workers_for,
)
from clvol.integrators.pyramid.oracles import oracle_named
from clvol.integrators.raycast.caster import Raycaster, lanes_of
from clvol.integrators.raycast.constant_cells import uses_constant_cells
from clvol.integrators.raycast.switches import raycast_switches
from clvol.opencl.context import DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction


class PyramidCaster(Raycaster):
    """A ``Raycaster`` with a ``SliceMarch``, pre-integrated."""

    march: SliceMarch

    def __init__(
        self,
        context: DeviceContext,
        resolved: ResolvedScene,
        *,
        lanes: int | None = None,
        workers: int | None = None,
        tile: int = TILE,
        leap: bool = True,
        volume: DeviceVolume | None = None,
    ) -> None:
        oracle, lanes = oracle_named(resolved.pyramid.oracle), lanes_of(context, lanes)
        march = SliceMarch(oracle, lanes, workers, tile, leap)
        super().__init__(context, resolved, lanes=lanes, tile=(tile, tile), volume=volume, march=march)

    def _follow_data(self) -> None:
        self.switches |= constant_switches(self.resolved, self.lanes, self.function)

    def _build_shadows(self) -> None:
        """The rays of a light volume leap by the ray caster's map, not by that of the slices."""
        of_slices = getattr(self, "distances", None)
        self.distances = distance_map(self.context, self.march.shown, bool(self.octant_cells))
        super()._build_shadows()
        if of_slices is not None:
            self.distances = of_slices


def pyramid_switches(resolved: ResolvedScene, lanes: int) -> dict[str, int]:
    """The switches (-D) for a scene of the integrator "pyramid"."""
    resolved = reduced_for_frames(resolved)
    march = {
        **march_switches(oracle_named(resolved.pyramid.oracle), workers_for(lanes)), **cut_face_switches(resolved)
    }  # fmt: skip
    resolved = without_clips(resolved)
    return {**raycast_switches(resolved, lanes=lanes), **constant_switches(resolved, lanes), **march}


def constant_switches(
    resolved: ResolvedScene, lanes: int, function: TransferFunction | None = None
) -> dict[str, int]:
    """The switch (-D) of a reduced scene, or with ``function`` in place of its own, of which enough is constant to look
    for it before light is."""
    effects = effect_switches(resolved)
    return {"CONSTANT_CELLS": 1} if lanes > 1 and effects and uses_constant_cells(resolved, effects, function) else {}
