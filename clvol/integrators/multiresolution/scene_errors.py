"""What a scene's effects make of the errors of blocks: those that clips remove are dropped, and hide nothing; what lies
beside a block that shows, and shows nothing itself, has a share in gradients there; and surfaces show where voxels are
on the wrong side of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from clvol.device.fields import kept_blocks
from clvol.device.noise import displacement_bound, value_bound
from clvol.features import called_for, reduced_for_frames
from clvol.integrators.multiresolution.blocked_volume import levels_of_fields
from clvol.integrators.multiresolution.clipped_blocks import MARGIN, kept_shares, removed_blocks
from clvol.integrators.multiresolution.looks import Looks, looks_of
from clvol.integrators.multiresolution.projection_errors import projected_colors, projection_errors
from clvol.integrators.multiresolution.selection import SourceErrors, source_errors
from clvol.integrators.multiresolution.visible_error import ShownColors
from clvol.scene.clip import Clip
from clvol.scene.field import ResolvedField
from clvol.scene.isosurface import Isosurface
from clvol.scene.noise import Noise
from clvol.scene.resolve import ResolvedScene
from clvol.store.geometry import BlockGrid
from clvol.store.source import BlockSource, BlockStatistics
from clvol.transfer import TransferFunction
from clvol.volume.grid import Grid

# What an error beside a block counts for: of its voxels one layer has a share in the gradients there.
_BESIDE = 1.0 / 16.0
# What an error counts for that nobody sees, beside one in the middle of the picture, where it may take light from what
# is seen, or be seen through a surface that bends rays.
_OF_SHADOWS = 1.0 / 64.0


@dataclass(frozen=True)
class EffectsOnBlocks:
    """What of a scene's effects matters to the choice of blocks: its clips, whether anything needs gradients, its
    surfaces, its compositing, whether there are shadows or ambient occlusion, which what is not seen casts, too, or
    rays that surfaces bend to it, its masks with their levels, its noise, which ``moves`` samples by so many voxels at
    most, and how values may look."""

    clips: tuple[Clip, ...] = ()
    needs_gradients: bool = False
    surfaces: tuple[Isosurface, ...] = ()
    compositing: str = "over"
    casts_shadows: bool = False
    bends_rays: bool = False
    masks: tuple[tuple[ResolvedField, int], ...] = ()
    noise: tuple[Noise, ...] = ()
    moves: float = 0.0
    looks: Looks = Looks()

    @property
    def reach(self) -> float:
        """Voxels beyond what is interpolated at a place that have a share in it."""
        return float(self.needs_gradients) + self.moves

    @property
    def least_share(self) -> float:
        """As in ``select_blocks``."""
        return _OF_SHADOWS if self.casts_shadows or self.bends_rays else 0.0

    @property
    def of_values(self) -> tuple[Any, ...]:
        """What ``function_errors`` depends on."""
        return self.compositing, self.noise, self.looks


def effects_on_blocks(resolved: ResolvedScene) -> EffectsOnBlocks:
    reduced = reduced_for_frames(resolved)
    return EffectsOnBlocks(
        reduced.clips, "gradients" in called_for(resolved), reduced.isosurfaces, reduced.integration.compositing,
        reduced.shadow is not None or reduced.ambient_occlusion is not None,
        any(surface.refraction != 1.0 for surface in reduced.isosurfaces), _masks(reduced),
        reduced.noise, _moved_by(reduced), looks_of(reduced),
    )  # fmt: skip


def function_errors(
    source: BlockSource, function: TransferFunction, background: np.ndarray, effects: EffectsOnBlocks
) -> SourceErrors:
    """The errors of ``source`` under ``function`` over ``background`` (linear [3]), by the scene's compositing."""
    source = _as_perturbed(source, effects)
    if effects.compositing == "over":
        return effects.looks.errors(source, function, background)
    return projection_errors(source, function, background, effects.compositing)


def _masks(resolved: ResolvedScene) -> tuple[tuple[ResolvedField, int], ...]:
    fields = zip(resolved.fields, levels_of_fields(resolved))
    return tuple((field, level) for field, level in fields if field.role == "mask")


def _moved_by(resolved: ResolvedScene) -> float:
    """Voxels by which noise moves places, at most."""
    shortest = min(resolved.volume.grid.spacing)
    return float(sum(displacement_bound(noise) for noise in resolved.noise) / shortest)


class _Perturbed:
    """``source`` with values that may lie ``added`` beyond those of its voxels."""

    def __init__(self, source: BlockSource, added: float) -> None:
        self._source, self._added = source, added

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def statistics(self) -> Iterator[BlockStatistics]:
        for part in self._source.statistics():
            yield replace(part, reach_low=part.reach_low - self._added, reach_high=part.reach_high + self._added)


def _as_perturbed(source: BlockSource, effects: EffectsOnBlocks) -> BlockSource:
    added = float(sum(value_bound(noise) for noise in effects.noise))
    return cast(BlockSource, _Perturbed(source, added)) if added else source


def shown_colors(
    source: BlockSource, function: TransferFunction, background: np.ndarray, effects: EffectsOnBlocks
) -> list[ShownColors]:
    """What may be shown of one value all through a block."""
    if effects.compositing == "over":
        return effects.looks.shown(function, source.blocks.edge * source.grid.smallest_edge, background)
    return [projected_colors(function, background)]


def scene_errors(
    source: BlockSource, known: SourceErrors, effects: EffectsOnBlocks, background: np.ndarray
) -> SourceErrors:
    """``known``, the errors of ``source`` under the transfer function alone over ``background`` (linear [3]), with the
    ``effects`` of a scene."""
    if effects.surfaces:
        source = _as_perturbed(source, effects)
        known = _with_surfaces(source, known, effects.surfaces, background)
    return with_effects(known, effects, source.grid, source.blocks)


def _with_surfaces(
    source: BlockSource, known: SourceErrors, surfaces: tuple[Isosurface, ...], background: np.ndarray
) -> SourceErrors:
    """Surfaces as a medium that is behind them what they are: its errors are those of voxels on the wrong side. A block
    that no surface goes through shows none, but may hide what is behind it."""
    ordered = sorted(surfaces, key=lambda surface: surface.value)
    values = np.array([surface.value for surface in ordered], np.float64)
    opacities = np.array([surface.opacity for surface in ordered], np.float64)
    colors = np.array([surface.color for surface in ordered], np.float64)
    path = source.blocks.edge * source.grid.smallest_edge
    steps = TransferFunction(
        np.repeat(values, 2), np.append(0.0, np.repeat(opacities, 2)[:-1]),
        np.concatenate([colors[:1], np.repeat(colors, 2, axis=0)[:-1]]), path,
    )  # fmt: skip
    found = source_errors(source, steps, background)
    through = np.zeros(source.blocks.count, bool)
    for part in source.statistics():
        piece = slice(part.first, part.first + len(part.reach_low))
        for value in values:
            through[piece] |= (part.reach_low <= value) & (value <= part.reach_high)
    errors = known.errors + np.where(through, found.errors, np.float32(0.0))
    return SourceErrors(errors, known.dropped & ~through, known.transmittances * found.transmittances)


def with_effects(known: SourceErrors, effects: EffectsOnBlocks, grid: Grid, blocks: BlockGrid) -> SourceErrors:
    """``known``, errors of what shows, with clips, masks and gradients of ``effects``, over ``blocks`` of ``grid``."""
    clips, needs_gradients = effects.clips, effects.needs_gradients
    errors, dropped, transmittances = known.errors, known.dropped, known.transmittances
    if needs_gradients and dropped.any():
        beside = dropped & _largest_around(~dropped, blocks)
        errors = errors.copy()
        for level in range(len(errors)):
            errors[level, beside] = _BESIDE * _largest_around(errors[level], blocks)[beside]
        dropped = dropped & ~beside
    if clips:
        removed = _for_good(removed_blocks(clips, grid, blocks), effects, blocks)
        shares = kept_shares(clips, grid, blocks, ~removed & (transmittances < 1.0))
        transmittances = np.where(removed, np.float32(1.0), transmittances**shares)
        errors = np.where(removed, np.float32(0.0), errors)
        dropped = dropped | removed
    if effects.masks:
        kept = kept_blocks(effects.masks, grid, blocks.counts, blocks.edge, MARGIN).ravel()
        removed = _for_good(~kept, effects, blocks)
        transmittances = np.where(removed, np.float32(1.0), transmittances)
        errors = np.where(removed, np.float32(0.0), errors)
        dropped = dropped | removed
    return SourceErrors(errors, dropped, transmittances)


def _for_good(removed: np.ndarray, effects: EffectsOnBlocks, blocks: BlockGrid) -> np.ndarray:
    """bool [n]: of the ``removed`` blocks those that noise does not make samples of places outside of them."""
    kept = ~removed
    for _ in range(min(int(np.ceil(effects.moves / blocks.edge)), max(blocks.counts))):
        kept = _largest_around(kept, blocks)
    return ~kept


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
