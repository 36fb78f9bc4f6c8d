"""Which method renders a scene, behind one interface: ``warm_up`` and ``render``."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from clvol.device.prefilter import prefiltered
from clvol.device.quantise import quantised
from clvol.render.scene_key import engine_key

if TYPE_CHECKING:
    from clvol.device.volume import DeviceVolume
    from clvol.integrators.multiresolution.engine import MultiresolutionEngine
    from clvol.integrators.multiresolution.residency import Residency
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.opencl.context import DeviceContext
    from clvol.scene.resolve import ResolvedScene
    from clvol.volume import Volume


_BUDGETS_KEPT = 2  # volumes or budgets of the method "multiresolution"
_KEPT = 6  # engines: a pre-integration table may take 64 MiB


class Engines:
    """Makes engines on one device; those of the same volume share it there.

    What is kept is kept by value: engines by all that they were made for (``engine_key``), volumes by the volume
    itself, which does not change. No engine changes behind its key: another transfer function makes another one.
    Not for two threads at once.
    """

    def __init__(self, context: DeviceContext) -> None:
        self.context = context
        self._converted: dict[tuple, tuple[Volume, Volume]] = {}
        self._made: dict[tuple, Raycaster | MultiresolutionEngine] = {}
        self._volumes: dict[Volume, DeviceVolume] = {}
        self._resident: dict[tuple, Residency] = {}

    def make(
        self,
        resolved: ResolvedScene,
        progress: Callable[[int, int], None] | None = None,
        wait: bool | None = None,
    ) -> Raycaster | MultiresolutionEngine:
        """What renders ``resolved`` by its ``integration.method``. ``progress(done, total)``: of the
        blocks that are read for it. ``wait`` False: a thread reads them, and frames show what is there until all
        has come; None: as was said last."""
        from clvol.features import reduced_for_frames

        resolved = self._with_precision(reduced_for_frames(resolved))
        key = engine_key(resolved)
        by_blocks = resolved.integration.method == "multiresolution"
        if key in self._made:
            made = self._made[key] = self._made.pop(key).like(resolved)
            if by_blocks and wait is not None:
                made.ask(wait, progress)
            return made
        if by_blocks:
            made = self._of_blocks(resolved, progress, wait)
        else:
            if resolved.integration.method == "pyramid":
                from clvol.integrators.pyramid.caster import PyramidCaster as Caster
            else:
                from clvol.integrators.raycast.caster import Raycaster as Caster
            made = Caster(self.context, resolved, volume=self._volumes.get(resolved.volume))
            self._volumes[resolved.volume] = made.volume
        while len(self._made) >= _KEPT:
            del self._made[next(iter(self._made))]
        self._made[key] = made
        return made

    def _of_blocks(
        self, resolved: ResolvedScene, progress: Callable[[int, int], None] | None, wait: bool | None
    ) -> MultiresolutionEngine:
        """Engines of one volume and one budget share what is resident: the last ones' budgets are held."""
        from clvol.integrators.multiresolution.engine import MultiresolutionEngine
        from clvol.integrators.multiresolution.residency import Residency

        key = resolved.volume, resolved.multiresolution.memory_bytes
        if key not in self._resident:
            while len(self._resident) >= _BUDGETS_KEPT:
                self._drop(next(iter(self._resident)))
            self._resident[key] = Residency(self.context, resolved)
        return MultiresolutionEngine(self.context, resolved, self._resident[key], progress, wait)

    def _drop(self, key: tuple) -> None:
        residency = self._resident.pop(key)
        residency.blocks.close()
        kept = {k: m for k, m in self._made.items() if getattr(m, "residency", None) is not residency}
        self._made = kept

    def close(self) -> None:
        """Ends the threads that read blocks."""
        for key in list(self._resident):
            self._drop(key)

    def _with_precision(self, resolved: ResolvedScene) -> ResolvedScene:
        """``resolved`` with its voxels as they are rendered, which are found once for each volume."""
        integration = resolved.integration
        if integration.voxel_precision == "stored" and not integration.prefilter:
            return resolved
        key = resolved.volume, integration.voxel_precision, integration.prefilter
        kept = self._converted.get(key, (None, None))
        small = quantised(resolved, kept[0])
        filtered = prefiltered(small, kept[1])
        if key not in self._converted:
            while len(self._converted) >= _KEPT:
                del self._converted[next(iter(self._converted))]
            self._converted[key] = small.volume, filtered.volume
        return filtered
