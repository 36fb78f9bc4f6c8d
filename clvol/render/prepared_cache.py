"""Prepared scenes on one device, kept by value, so that no scene is prepared twice."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from clvol.encoding.coded_volume import CodedVolume
from clvol.integrators.base import ChangesStep, Prepared, Shared
from clvol.integrators.channels import prepared_channels
from clvol.integrators.decoding import codes_of, compression_stats, with_rendered_voxels
from clvol.integrators.registry import integrator_of
from clvol.opencl.context import DeviceContext
from clvol.render.scene_key import scene_key, value_key
from clvol.scene.resolve import ResolvedScene
from clvol.volume.series import is_other_step
from clvol.volume.volume import Volume

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
        self._asked: dict[tuple, Volume] = {}  # those of the scenes that were requested

    def prepare(
        self,
        resolved: ResolvedScene,
        progress: Callable[[int, int], None] | None = None,
        wait: bool | None = None,
    ) -> Prepared:
        """``resolved``, ready to be rendered by the integrator that it names. ``progress(done, total)`` reports
        the blocks that are read for it. ``wait`` False: a thread reads them, and frames show those that are there until
        all have arrived; None: as in the last request."""
        if resolved.channels:
            return prepared_channels(resolved, lambda scene: self.prepare(scene, progress, wait))
        integrator, asked = integrator_of(resolved), resolved.volume
        resolved = with_rendered_voxels(resolved, self._shared, integrator, progress)
        resolved = integrator.simplified(resolved, self._shared)
        key = scene_key(resolved, integrator)
        if key in self._kept:
            prepared = self._kept[key] = self._kept.pop(key).for_scene(resolved)
            integrator.ask_again(prepared, progress, wait)
            return prepared
        changed = self._from_other_step(resolved, key)
        self._leave_other_steps(asked)
        prepared = changed or integrator.prepare(self._shared, resolved, progress, wait)
        self._asked[key] = asked
        while len(self._kept) >= _KEPT:
            first = next(iter(self._kept))
            del self._kept[first], self._asked[first]
        self._kept[key] = prepared
        return prepared

    def _from_other_step(self, resolved: ResolvedScene, key: tuple) -> Prepared | None:
        """``resolved``, of a scene that differs in the step of a series alone and is of no use any more; None where
        there is none, or where its integrator makes every step anew."""
        volume = resolved.volume
        for other, prepared in self._kept.items():
            before = prepared.resolved.volume
            if not isinstance(prepared, ChangesStep) or not is_other_step(before, volume):
                continue
            if _without(other, before) == _without(key, volume):
                try:
                    changed = prepared.for_step(resolved)
                except BaseException:
                    self._leave_other_steps(volume)  # it may have voxels of both steps
                    raise
                if changed is not None:
                    for kind in ("volume", "history"):
                        self._shared.rename(kind, before, volume)
                return changed
        return None

    def _leave_other_steps(self, volume: Volume) -> None:
        """Forgets whatever was made of other steps of the series of ``volume``, so that memory does not grow."""
        left = [key for key, asked in self._asked.items() if is_other_step(asked, volume)]
        dropped = {id(v): v for key in left for v in (self._asked[key], self._kept[key].resolved.volume)}
        for key in left:
            del self._kept[key], self._asked[key]
        if dropped:
            self._shared.forget(list(dropped.values()))

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
        self._asked = {key: volume for key, volume in self._asked.items() if key in self._kept}

    def close(self) -> None:
        """Ends the threads that read blocks."""
        self._kept.clear()
        self._asked.clear()
        self._shared.close()


def _without(key: tuple, volume: Volume) -> list[Any]:
    """``key`` without the ``volume`` in it."""
    own = value_key(volume)
    return [None if part == own else part for part in key]
