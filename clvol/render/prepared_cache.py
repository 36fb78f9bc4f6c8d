"""Prepared scenes on one device, kept by value, so that no scene is prepared twice."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from clvol.encoding.coded_volume import CodedVolume
from clvol.integrators.base import Prepared, Shared
from clvol.integrators.decoding import codes_of, compression_stats, with_rendered_voxels
from clvol.integrators.registry import integrator_of
from clvol.opencl.context import DeviceContext
from clvol.render.scene_key import scene_key
from clvol.scene.resolve import ResolvedScene

_KEPT = 6  # prepared scenes


class PreparedCache:
    """Prepares scenes on one device; scenes of the same volume share it there.

    Keys are values: a prepared scene has a key of everything that it was made for (``scene_key``), a volume has
    itself, since it does not change. Nothing changes behind its key: another transfer function
    makes another prepared scene. Not for two threads at once.
    """

    def __init__(self, context: DeviceContext) -> None:
        self.context = context
        self._shared = Shared(context, self._forget)
        self._kept: dict[tuple, Prepared] = {}

    def prepare(
        self,
        resolved: ResolvedScene,
        progress: Callable[[int, int], None] | None = None,
        wait: bool | None = None,
    ) -> Prepared:
        """``resolved``, ready to be rendered by the integrator that it names. ``progress(done, total)`` reports
        the blocks that are read for it. ``wait`` False: a thread reads them, and frames show those that are there until
        all have arrived; None: as in the last request."""
        integrator = integrator_of(resolved)
        resolved = with_rendered_voxels(resolved, self._shared, integrator, progress)
        resolved = integrator.simplified(resolved, self._shared)
        key = scene_key(resolved, integrator)
        if key in self._kept:
            prepared = self._kept[key] = self._kept.pop(key).for_scene(resolved)
            integrator.ask_again(prepared, progress, wait)
            return prepared
        prepared = integrator.prepare(self._shared, resolved, progress, wait)
        while len(self._kept) >= _KEPT:
            del self._kept[next(iter(self._kept))]
        self._kept[key] = prepared
        return prepared

    @property
    def contexts(self) -> list[DeviceContext]:
        """The device's context."""
        return [self.context]

    @property
    def names(self) -> list[str]:
        """The device's name."""
        return [self.context.name]

    @property
    def compile_seconds(self) -> float:
        """Seconds that compilers have taken."""
        return self.context.compile_seconds

    def codes(self, resolved: ResolvedScene) -> CodedVolume | None:
        """The volume of ``resolved`` as codes, which are kept; None for a scene without codes."""
        return codes_of(resolved, self._shared)

    def compression(self, resolved: ResolvedScene, blocks: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """"compression" for the stats of a frame of ``resolved``, whose entry "blocks" is given; nothing for a scene
        without codes."""
        stats = compression_stats(resolved, self._shared, integrator_of(resolved), blocks)
        return {} if stats is None else {"compression": stats}

    def _forget(self, dropped: object) -> None:
        """Forgets the scenes that need ``dropped``."""
        self._kept = {
            key: prepared for key, prepared in self._kept.items() if all(part is not dropped for part in prepared.held)
        }

    def close(self) -> None:
        """Ends the threads that read blocks."""
        self._kept.clear()
        self._shared.close()
