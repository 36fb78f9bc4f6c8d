"""Which method renders a scene, behind one interface: ``warm_up`` and ``render``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from clvol.render.prefilter import prefiltered
from clvol.render.quantise import quantised

if TYPE_CHECKING:
    from clvol.opencl.context import DeviceContext
    from clvol.render.device_volume import DeviceVolume
    from clvol.render.multiresolution.engine import MultiresolutionEngine
    from clvol.render.multiresolution.residency import Residency
    from clvol.render.raycast import Raycaster
    from clvol.scene.resolve import ResolvedScene
    from clvol.volume import Volume


_BUDGETS_KEPT = 2  # volumes or budgets of the method "multiresolution"
_KEPT = 6  # engines: a pre-integration table may take 64 MiB


class Engines:
    """Makes engines on one device; those of the same volume share it there."""

    def __init__(self, context: DeviceContext) -> None:
        self.context = context
        self._quantised: dict[tuple, tuple[tuple, dict]] = {}
        self._made: dict[tuple, Raycaster | MultiresolutionEngine] = {}
        self._volumes: dict[int, tuple[Volume, DeviceVolume]] = {}
        self._resident: dict[tuple, tuple[Volume, Residency]] = {}

    def make(
        self, resolved: ResolvedScene, progress: Callable[[int, int], None] | None = None
    ) -> Raycaster | MultiresolutionEngine:
        """What renders ``resolved`` by its ``integration.method``. ``progress(done, total)``: of the
        blocks that are read for it."""
        from clvol.features import reduced_for_frames

        resolved = self._with_precision(reduced_for_frames(resolved))
        key = _key(resolved)
        if key in self._made:
            made = self._made[key] = self._made.pop(key).like(resolved)
            return made
        if resolved.integration.method == "multiresolution":
            made = self._of_blocks(resolved, progress)
        else:
            if resolved.integration.method == "pyramid":
                from clvol.render.pyramid.caster import PyramidCaster as Caster
            else:
                from clvol.render.raycast import Raycaster as Caster
            held = self._volumes.get(id(resolved.volume))
            made = Caster(self.context, resolved, volume=None if held is None else held[1])
            self._volumes[id(resolved.volume)] = (resolved.volume, made.volume)
        while len(self._made) >= _KEPT:
            del self._made[next(iter(self._made))]
        self._made[key] = made
        return made

    def _of_blocks(
        self, resolved: ResolvedScene, progress: Callable[[int, int], None] | None
    ) -> MultiresolutionEngine:
        """Engines of one volume and one budget share what is resident: the last ones' budgets are held."""
        from clvol.render.multiresolution.engine import MultiresolutionEngine
        from clvol.render.multiresolution.residency import Residency

        key = id(resolved.volume), resolved.multiresolution.memory_bytes
        if key not in self._resident:
            while len(self._resident) >= _BUDGETS_KEPT:
                self._drop(next(iter(self._resident)))
            self._resident[key] = resolved.volume, Residency(self.context, resolved)
        return MultiresolutionEngine(self.context, resolved, self._resident[key][1], progress)

    def _drop(self, key: tuple) -> None:
        _, residency = self._resident.pop(key)
        residency.blocks.close()
        kept = {k: m for k, m in self._made.items() if getattr(m, "residency", None) is not residency}
        self._made = kept

    def close(self) -> None:
        """Ends the threads that read blocks."""
        for key in list(self._resident):
            self._drop(key)

    def _with_precision(self, resolved: ResolvedScene) -> ResolvedScene:
        integration = resolved.integration
        if integration.voxel_precision == "stored" and not integration.prefilter:
            return resolved
        asked = tuple(getattr(resolved, name) for name in _CONVERTED)
        key = (*map(id, asked), integration.voxel_precision, integration.prefilter)
        if key not in self._quantised:
            small = prefiltered(quantised(resolved))
            while len(self._quantised) >= _KEPT:
                del self._quantised[next(iter(self._quantised))]
            # What the key identifies is kept alive with it.
            self._quantised[key] = asked, {name: getattr(small, name) for name in _CONVERTED}
        return replace(resolved, **self._quantised[key][1])


# What other voxels make of a scene (quantise.py, prefilter.py).
_CONVERTED = (
    "volume", "transfer_function", "isosurfaces", "material", "gradient_opacity",
    "directional_opacity", "transfer_layers", "noise", "voxel_range",
)  # fmt: skip
# What an engine is made for beside volume, transfer function and integration: by their words ...
_BY_WORDS = (
    "lights", "isosurfaces", "clips", "material", "gradient", "environment", "shadow", "noise",
    "depth_cue",
)  # fmt: skip
# ... or by identity, where they hold arrays.
_BY_IDENTITY = ("gradient_opacity", "directional_opacity", "transfer_layers", "fields")


def _key(resolved: ResolvedScene) -> tuple:
    """Equal for scenes that an engine may be shared for (Raycaster.like)."""
    alike = resolved.integration.model_copy(update={"step": 1.0, "early_termination": 0.0})
    words = tuple(repr(getattr(resolved, name)) for name in _BY_WORDS)
    if alike.method == "multiresolution":
        words += repr(resolved.multiresolution), resolved.background.tobytes()
        if resolved.multiresolution.stepping == "pyramid":
            words += (repr(resolved.pyramid.levels),)
    if alike.method == "pyramid":
        from clvol.render.pyramid.oracles import oracle_named

        words += repr(resolved.pyramid), oracle_named(resolved.pyramid.oracle)
    arrays = tuple(id(getattr(resolved, name) or None) for name in _BY_IDENTITY)
    return (id(resolved.volume), id(resolved.transfer_function), alike, words, arrays)
