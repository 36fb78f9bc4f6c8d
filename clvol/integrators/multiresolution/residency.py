"""Residency: which blocks of a volume are on the device, at which level, for a scene and a view."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clvol.device.fields import field_bytes
from clvol.errors import SceneError
from clvol.features import reduced_for_frames
from clvol.integrators.multiresolution.blocked_volume import levels_of_fields
from clvol.integrators.multiresolution.device_blocks import DeviceBlocks
from clvol.integrators.multiresolution.scene_errors import (
    EffectsOnBlocks,
    effects_on_blocks,
    function_errors,
    scene_errors,
)
from clvol.integrators.multiresolution.selection import Selection, SourceErrors, select_blocks
from clvol.integrators.raycast.history import History
from clvol.opencl.context import DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.store.source import DROPPED, BlockSource
from clvol.store.volume_blocks import VolumeBlocks
from clvol.transfer import TransferFunction
from clvol.volume import Volume


def block_source(volume: Volume) -> BlockSource:
    """The store that holds ``volume``, or else its voxels in memory."""
    found = getattr(volume, "blocks_source", None)
    return VolumeBlocks(volume) if found is None else found


def memory_of_blocks(resolved: ResolvedScene) -> int:
    """Bytes of ``multiresolution.memory`` that fields leave for blocks."""
    return resolved.multiresolution.memory_bytes - bytes_of_fields(resolved)


def bytes_of_fields(resolved: ResolvedScene) -> int:
    """Bytes of the voxels of a scene's fields, at the levels that go with blocks."""
    reduced = reduced_for_frames(resolved)
    return field_bytes(reduced, levels_of_fields(reduced))


class Residency:
    """The blocks of one volume within one budget.

    ``ask`` selects levels for a scene. Blocks whose levels differ from those on the device are read, either at once or
    by a thread while frames show the blocks that are there (``DeviceBlocks``).
    """

    def __init__(self, context: DeviceContext, resolved: ResolvedScene) -> None:
        self.source = block_source(resolved.volume)
        memory = memory_of_blocks(resolved)
        try:
            self.blocks = DeviceBlocks(context, self.source, memory)
        except SceneError as error:
            raise SceneError(f"{resolved.origin}: {error.where}", error.what, error.expected) from None
        self.memory_bytes = memory
        self.selection: Selection | None = None
        self._errors: tuple[TransferFunction, np.ndarray, tuple[Any, ...], SourceErrors] | None = None
        self._with_effects: tuple[SourceErrors, EffectsOnBlocks, SourceErrors] | None = None
        self._means: np.ndarray | None = None
        self._request: tuple = ()
        self._waits = True
        self.history = History()  # of pictures of these blocks
        self.generation = 0  # increases whenever something on the device has changed

    def ask(
        self,
        resolved: ResolvedScene,
        *,
        wait: bool | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> bool:
        """Requests levels for ``resolved``; returns whether anything on the device changed.

        ``wait``: wait until all blocks have arrived; else a thread reads, and ``DeviceBlocks.commit`` puts blocks in
        place. None: as in the last request, but once all blocks have arrived the next request is waited for.
        """
        if wait is not None:
            self._waits = wait
        try:
            changed = self._ask(resolved, self._waits, progress)
        except BaseException:
            self._request = ()  # blocks that have not arrived are requested again
            raise
        self._waits |= not self.blocks.pending
        self.generation += changed
        return changed

    def _ask(self, resolved: ResolvedScene, wait: bool, progress) -> bool:
        settings, function = resolved.multiresolution, resolved.transfer_function
        camera = resolved.camera if settings.view_weighting else None
        view = (camera, resolved.image.width, resolved.image.height) if camera else None
        effects = effects_on_blocks(resolved)
        request = (function, view, settings.occlusion, resolved.background.tobytes(), effects)
        if request == self._request:
            return self.blocks.wait(progress) if wait else self.blocks.commit()
        known = self._scene_errors(function, resolved.background, effects)
        self.selection = select_blocks(
            self.source, function, resolved.background, camera, resolved.image,
            self.blocks.sample_bytes, occlusion=settings.occlusion, known=known,
            least_share=effects.least_share,
        )  # fmt: skip
        self._request = request
        if wait:
            self.blocks.load(self.selection.levels, self._block_means(), progress)
            self.blocks.commit()
            return True
        priority = known.errors[-1]
        self.blocks.start(self.selection.levels, self._block_means(), priority)
        return self.blocks.commit()

    def _block_means(self) -> np.ndarray:
        """The mean of each block; read once."""
        if self._means is None:
            self._means = np.concatenate([part.mean[-1] for part in self.source.statistics()])
        return self._means

    def _scene_errors(
        self, function: TransferFunction, background: np.ndarray, effects: EffectsOnBlocks
    ) -> SourceErrors:
        known = self._source_errors(function, background, effects)
        if self._with_effects is None or self._with_effects[:2] != (known, effects):
            found = scene_errors(self.source, known, effects, background)
            self._with_effects = known, effects, found
        return self._with_effects[2]

    def _source_errors(
        self, function: TransferFunction, background: np.ndarray, effects: EffectsOnBlocks
    ) -> SourceErrors:
        if self._errors is not None:
            old_function, old_background, of_values, errors = self._errors
            same = np.array_equal(old_background, background) and of_values == effects.of_values
            if old_function == function and same:
                return errors
        errors = function_errors(self.source, function, background, effects)
        self._errors = function, np.array(background), effects.of_values, errors
        return errors

    def close(self) -> None:
        """Ends the thread that reads blocks."""
        self.blocks.close()

    def describe(self) -> dict[str, Any]:
        """For stats: the numbers of blocks by level (full resolution first), dropped, and pending; bytes; and the
        selection's error (Delta-E times pixels with view weighting, else Delta-E, summed over blocks) with its lower
        bound."""
        if self.selection is None:
            raise ValueError("no blocks have been requested")
        levels = self.blocks.levels
        counts = np.bincount(levels, minlength=DROPPED + 1)
        return {
            "levels": counts[: self.source.blocks.levels].tolist(),
            "dropped": int(counts[DROPPED]),
            "pending": self.blocks.pending,
            "edge": self.source.blocks.edge,
            "bytes_of_samples": self.blocks.used_bytes,
            "bytes_on_device": self.blocks.device_bytes,
            "bytes_allowed": self.memory_bytes,
            "estimated_error": self.selection.error,
            "least_possible_error": self.selection.bound,
        }
