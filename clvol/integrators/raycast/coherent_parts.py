"""Pictures that devices share, whose rays start where those of the shared picture before first contributed.

What is kept of a picture is an array that all its devices write to (``KeptDepths``), and that of the picture before is
one that all of them read. So rays start after whatever was met, whichever device met it. Each device finds its own
starts; it takes none if it had no part in the picture before, or cannot tell how the camera has moved since.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clvol.device.view import EVERY_PIXEL
from clvol.integrators.base import SHARED_COHERENCE, KeptDepths, PartOfPicture, PictureArrays
from clvol.integrators.raycast.history import History, refused, reproject, step_back
from clvol.integrators.raycast.picture import PictureParts
from clvol.integrators.raycast.reprojection import Move
from clvol.integrators.raycast.same_starts import Facts

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.scene.camera import Camera


class CoherentParts(PictureParts):
    """As ``PictureParts``, with ``PictureArrays.kept``. ``history``: of shared pictures on this device."""

    coherent = True

    def __init__(
        self, caster: Raycaster, camera: Camera, width: int, height: int, depth: bool, history: History
    ) -> None:
        super().__init__(caster, camera, width, height, depth, EVERY_PIXEL)
        self._history, self._size = history, (width, height)
        self._facts = Facts.of(caster.resolved, caster.volume.contents)
        self._found = history.move_to(caster, self._stages[0].frame, self._size, self._facts)
        reason = self._found if isinstance(self._found, str) else None
        self.notes["coherence"] = {"reason": reason, "audit": caster.resolved.coherence.audit}

    def begin(self, stage: int, arrays: list[PictureArrays]) -> None:
        super().begin(stage, arrays)
        kept = arrays[stage].kept
        if kept is None:
            self._history.forget()
            return
        context, history, this = self._context, self._history, self._stages[stage]
        width, height = self._size
        tallies = context.output(np.uint32, (this.tiles, 4))
        written = context.output(np.float32, (height, width), kept.now)
        this.outputs |= {"starts": self._starts(kept), "kept": written, "tallies": tallies}
        history.frame, history.size, history.facts, history.number = this.frame, self._size, self._facts, kept.number

    def _starts(self, kept: KeptDepths):
        context, history, shape = self._context, self._history, self._size[::-1]
        if kept.before is None or kept.number_before != history.number or not isinstance(self._found, Move):
            return history.array("hull", shape, lambda: context.upload(np.full(shape, np.inf, np.float32)))
        before, caster = context.share(kept.before), self._caster
        audit = caster.resolved.coherence.audit
        return reproject(context, history, self._found, self._size, step_back(caster), audit, before)

    def render(self, stage: int, tiles: np.ndarray) -> PartOfPicture:
        part, this = super().render(stage, tiles), self._stages[stage]
        if "tallies" not in this.outputs:
            return part
        own, _ = self._own_tiles(this, tiles)
        sums = self._context.read(this.outputs["tallies"])[own].sum(axis=0, dtype=np.int64)
        return replace(part, counters={**part.counters, **dict(zip(SHARED_COHERENCE, map(int, sums)))})


def parts_from_history(caster: Raycaster, camera: Camera, width: int, height: int, depth: bool) -> PictureParts:
    """As ``RendersParts.parts``, for scenes that request starts from the picture before. Where pictures take none,
    notes say why."""
    refusal = refused(caster.resolved, caster.switches)
    if refusal is None:
        return CoherentParts(caster, camera, width, height, depth, caster.history.of_shared)
    parts = PictureParts(caster, camera, width, height, depth, EVERY_PIXEL)
    parts.notes["coherence"] = refusal
    return parts
