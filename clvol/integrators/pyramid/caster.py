"""The integrator "pyramid" on a volume that is on the device as a whole."""

from __future__ import annotations

from clvol.device.volume import DeviceVolume
from clvol.features import reduced_for_frames
from clvol.integrators.pyramid.march import TILE, SliceMarch, march_switches, without_clips, workers_for
from clvol.integrators.pyramid.oracles import oracle_named
from clvol.integrators.raycast.caster import Raycaster, lanes_of
from clvol.integrators.raycast.switches import raycast_switches
from clvol.opencl.context import DeviceContext
from clvol.scene.resolve import ResolvedScene


class PyramidCaster(Raycaster):
    """A ``Raycaster`` with a ``SliceMarch``, for scenes of emission and absorption, pre-integrated."""

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


def pyramid_switches(resolved: ResolvedScene, lanes: int) -> dict[str, int]:
    """The switches (-D) for a scene of the integrator "pyramid"."""
    resolved = without_clips(reduced_for_frames(resolved))
    march = march_switches(oracle_named(resolved.pyramid.oracle), workers_for(lanes))
    return {**raycast_switches(resolved, lanes=lanes), **march}
