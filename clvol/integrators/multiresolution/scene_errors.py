"""What a scene's effects make of the errors of blocks: those that clips remove are dropped, and hide nothing; and what
lies beside a block that shows, and shows nothing itself, has a share in gradients there."""

from __future__ import annotations

import numpy as np

from clvol.features import called_for, reduced_for_frames
from clvol.integrators.multiresolution.clipped_blocks import kept_shares, removed_blocks
from clvol.integrators.multiresolution.selection import SourceErrors
from clvol.scene.clip import Clip
from clvol.scene.resolve import ResolvedScene
from clvol.store.geometry import BlockGrid
from clvol.volume.grid import Grid

# What an error beside a block counts for: of its voxels one layer has a share in the gradients there.
_BESIDE = 1.0 / 16.0

EffectsOnBlocks = tuple[tuple[Clip, ...], bool]


def effects_on_blocks(resolved: ResolvedScene) -> EffectsOnBlocks:
    """What of a scene's effects matters to the choice of blocks: its clips, and whether anything needs gradients."""
    return reduced_for_frames(resolved).clips, "gradients" in called_for(resolved)


def with_effects(known: SourceErrors, effects: EffectsOnBlocks, grid: Grid, blocks: BlockGrid) -> SourceErrors:
    """``known``, errors under the transfer function alone, with ``effects`` of a scene over ``blocks`` of ``grid``."""
    clips, needs_gradients = effects
    errors, dropped, transmittances = known.errors, known.dropped, known.transmittances
    if needs_gradients and dropped.any():
        beside = dropped & _largest_around(~dropped, blocks)
        errors = errors.copy()
        for level in range(len(errors)):
            errors[level, beside] = _BESIDE * _largest_around(errors[level], blocks)[beside]
        dropped = dropped & ~beside
    if clips:
        removed = removed_blocks(clips, grid, blocks)
        shares = kept_shares(clips, grid, blocks, ~removed & (transmittances < 1.0))
        transmittances = np.where(removed, np.float32(1.0), transmittances**shares)
        errors = np.where(removed, np.float32(0.0), errors)
        dropped = dropped | removed
    return SourceErrors(errors, dropped, transmittances)


def _largest_around(values: np.ndarray, blocks: BlockGrid) -> np.ndarray:
    """[n]: the largest of each block's value and those of the 26 around it."""
    out = values.reshape(blocks.counts)
    for axis in range(3):
        out = np.moveaxis(out, axis, 0)
        wider = out.copy()
        np.maximum(wider[1:], out[:-1], out=wider[1:])
        np.maximum(wider[:-1], out[1:], out=wider[:-1])
        out = np.moveaxis(wider, 0, axis)
    return out.ravel()
