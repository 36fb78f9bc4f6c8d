"""Residency of blocks of codes: which of them are on the device, at which level and depth, for a scene and a view."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clvol.device.tile_ranges import Ranges, sums_over_tiles, tile_ranges
from clvol.device.view import RayFrame, ray_frame
from clvol.errors import SceneError
from clvol.integrators.multiresolution.choice_selection import Chosen, select_choices
from clvol.integrators.multiresolution.code_choices import Choices, choices_of
from clvol.integrators.multiresolution.coded_source import CodedSource
from clvol.integrators.multiresolution.residency import memory_of_blocks
from clvol.integrators.multiresolution.resident_codes import ResidentCodes, Wanted
from clvol.integrators.multiresolution.scene_errors import (
    EffectsOnBlocks,
    effects_on_blocks,
    function_errors,
    scene_errors,
    shown_colors,
)
from clvol.integrators.multiresolution.selection import SourceErrors
from clvol.integrators.multiresolution.view_weight import view_weights, visibility
from clvol.integrators.raycast.history import History
from clvol.opencl.context import DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.tiles import TILE
from clvol.store.codecs.coded_blocks import MeasuredError
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.transfer import TransferFunction
from clvol.volume.grid import Grid

_POOL_SHARE = 8  # of the memory an eighth is for decoded blocks, where a view's tiles do not need more
_TRIES = 12  # budgets that are tried
_BATCH_SHARE = 8


class CodedResidency:
    """As ``Residency``, for a source of codes, and with another choice: the depth that a block at full resolution is
    cut to. Everything counts: codes, codebooks, index, the pool of decoded blocks, the map of empty space.

    A request always waits for its blocks.
    """

    def __init__(self, context: DeviceContext, source: CodedSource, resolved: ResolvedScene) -> None:
        self.source, self._origin = source, resolved.origin
        self.memory_bytes = memory_of_blocks(resolved)
        self.choices: Choices = choices_of(context, source, self.memory_bytes // _BATCH_SHARE)
        self.blocks = ResidentCodes(context, source, self.memory_bytes)
        self.chosen: Chosen | None = None
        self._errors: tuple[TransferFunction, np.ndarray, EffectsOnBlocks, SourceErrors, np.ndarray] | None = None
        self._means = np.concatenate([part.mean[-1] for part in source.statistics()])
        self._request: tuple = ()
        self.history = History()  # of pictures of these blocks
        self.generation = 0  # increases whenever something on the device has changed

    def ask(
        self,
        resolved: ResolvedScene,
        *,
        wait: bool | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> bool:
        """As ``Residency.ask``. SceneError where the memory does not suffice for the coarsest codes and what a tile of
        the picture needs decoded; it says how much would."""
        settings, image = resolved.multiresolution, resolved.image
        view = resolved.camera, image.width, image.height
        weighting = settings.view_weighting, settings.occlusion
        effects = effects_on_blocks(resolved)
        request = resolved.transfer_function, view, weighting, resolved.background.tobytes(), effects
        if request == self._request:
            return False
        self._request = ()
        found, errors = self._source_errors(resolved.transfer_function, resolved.background, effects)
        if settings.view_weighting:
            errors = errors * self._weights(resolved, found)
        sizes = np.where(found.dropped, 0, self.choices.size)
        wanted, pool = self._fitting(errors, sizes, found.dropped, resolved)
        self.blocks.set_codes(wanted, self._means, pool)
        self._request = request
        self.generation += 1
        return True

    def _weights(self, resolved: ResolvedScene, found: SourceErrors) -> np.ndarray:
        """float32 [choices, n]: as for ``select_blocks``."""
        grid, blocks, image = self.source.grid, self.source.blocks, resolved.image
        of_levels = np.ones((blocks.levels, blocks.count), np.float32)
        view_weights(resolved.camera, grid, blocks, image.width, image.height).apply(of_levels)
        if resolved.multiresolution.occlusion:
            of_levels *= visibility(resolved.camera, grid, blocks, found.transmittances)
        return of_levels[self.choices.level]

    def _source_errors(
        self, function: TransferFunction, background: np.ndarray, effects: EffectsOnBlocks
    ) -> tuple[SourceErrors, np.ndarray]:
        """The errors of levels, and those of all choices, float32 [choices, n]."""
        if self._errors is not None:
            old_function, old_background, old_effects, known, of_choices = self._errors
            if old_function == function and np.array_equal(old_background, background) and old_effects == effects:
                return known, of_choices
        source = self.source
        found = scene_errors(source, function_errors(source, function, background, effects), effects, background)
        shown = shown_colors(source, function, background, effects)
        errors = np.zeros((len(self.choices.level), source.blocks.count), np.float32)
        for part in source.statistics():
            piece = slice(part.first, part.first + len(part.reach_low))
            errors[:, piece] = self.choices.errors(found.errors[:, piece], part, shown)
        errors[:, found.dropped] = 0.0
        self._errors = function, np.array(background), effects, found, errors
        return found, errors

    def _fitting(
        self, errors: np.ndarray, sizes: np.ndarray, dropped: np.ndarray, resolved: ResolvedScene
    ) -> tuple[Wanted, int]:
        """What to hold, and the bytes of the pool. The more bytes are for codes, the finer blocks are, and the more of
        the pool a tile needs: as many as leave enough for that are found by bisection."""
        total = self.memory_bytes - self.blocks.overhead_bytes
        least, most = int(sizes.min(axis=0).sum()), total
        whole = Chosen(np.zeros(sizes.shape[1], np.intp), int(sizes[0].sum()), 0.0, 0.0)
        if whole.bytes <= total:  # so that rays see only voxels, as in ``all_resolutions``
            wanted = self._wanted(whole, sizes, dropped)
            needed, decoded = self._pool_needed(wanted, total, resolved)
            if whole.bytes + needed <= total:
                self.chosen = whole
                return wanted, min(total - whole.bytes, decoded)
        found, smallest = None, least
        budget = most
        for tries in range(_TRIES + 1):
            if tries == _TRIES and found is None:
                budget = smallest
            if budget < least:
                break
            chosen = select_choices(errors, sizes, budget)
            wanted = self._wanted(chosen, sizes, dropped)
            needed, decoded = self._pool_needed(wanted, total, resolved)
            if chosen.bytes + needed <= total:
                found = chosen, wanted, min(total - chosen.bytes, decoded)
                if budget == total or chosen.bytes < budget - budget // 64:  # no more is of any use
                    break
                least = max(least, budget)
            else:
                most = budget
            budget = (least + most) // 2
        if found is None:
            self._refuse(errors, sizes, dropped, resolved)
        assert found is not None
        self.chosen, wanted, pool = found
        return wanted, pool

    def _pool_needed(self, wanted: Wanted, total: int, resolved: ResolvedScene) -> tuple[int, int]:
        """Bytes of decoded blocks that the picture needs at a time, and of all of them. An eighth of the ``total`` is
        for them where tiles do not need more."""
        image, tile = resolved.image, (TILE, TILE)
        decoded = self.blocks.sample_bytes(wanted.level)
        whole = int(decoded.sum())
        frame = ray_frame(resolved.camera, self.source.grid, image.width, image.height)
        grids = self.source.grid, self.source.blocks
        reach = effects_on_blocks(resolved).reach
        ranges = seen_by_tiles(frame, *grids, wanted.level, (image.width, image.height), tile, reach)
        of_tiles = sums_over_tiles(ranges, decoded, -(-image.width // TILE), -(-image.height // TILE))
        least = max(int(of_tiles.max(initial=0)), least_pool(decoded, self.source.blocks), total // _POOL_SHARE)
        return min(least, whole), whole

    def _refuse(
        self, errors: np.ndarray, sizes: np.ndarray, dropped: np.ndarray, resolved: ResolvedScene
    ) -> None:
        coarsest = select_choices(errors, sizes, int(sizes.min(axis=0).sum()))
        needed, whole = self._pool_needed(self._wanted(coarsest, sizes, dropped), 0, resolved)
        pool = coarsest.bytes // (_POOL_SHARE - 1) + _POOL_SHARE  # its share of what all takes
        needed = coarsest.bytes + max(needed, min(pool, whole))
        least = self.memory_bytes
        while (more := self.blocks.overhead_within(least) + needed) > least:
            least = more
        raise SceneError(
            f"{self._origin}: multiresolution.memory", f"got {self.memory_bytes} bytes for codes and decoded blocks",
            f"at least {max(least, self.memory_bytes + 1)} bytes",
        )  # fmt: skip

    def _wanted(self, chosen: Chosen, sizes: np.ndarray, dropped: np.ndarray) -> Wanted:
        level = np.where(dropped, DROPPED, self.choices.level[chosen.choice]).astype(np.uint8)
        size = np.take_along_axis(sizes, chosen.choice[None], axis=0)[0]
        return Wanted(level, self.choices.depth[chosen.choice], size)

    def close(self) -> None:
        self.blocks.close()

    def compression(self) -> dict[str, Any]:
        """The entry "compression" of a frame's stats."""
        source, voxels = self.source, float(np.prod(self.source.blocks.shape, dtype=np.float64))
        measured: MeasuredError | None = getattr(getattr(source, "codes", None), "measured", None)
        return {
            "codec": source.codebooks.codec,
            "bits_per_voxel": 8.0 * self.blocks.code_bytes / voxels,
            "psnr": None if measured is None or np.isinf(measured.psnr) else measured.psnr,
            "max_voxel_error": None if measured is None else measured.max_voxel_error,
            "device_bytes": self.blocks.device_bytes,
            "decoded_voxels": self.blocks.take_decoded(),
        }

    def describe(self) -> dict[str, Any]:
        """As ``Residency.describe``, and the numbers of blocks at full resolution by depth: cut after 0, 1, ... stages,
        and uncut."""
        if self.chosen is None:
            raise ValueError("no blocks have been requested")
        blocks, books = self.blocks, self.source.codebooks
        levels, depths = blocks.levels, np.minimum(blocks.depths, books.stages + 1)
        counts = np.bincount(levels, minlength=DROPPED + 1)
        return {
            "levels": counts[: self.source.blocks.levels].tolist(),
            "depths": np.bincount(depths[levels == 0], minlength=books.stages + 2).tolist(),
            "dropped": int(counts[DROPPED]),
            "pending": 0,
            "edge": self.source.blocks.edge,
            "bytes_of_codes": blocks.code_bytes,
            "bytes_of_samples": blocks.used_bytes,
            "bytes_on_device": blocks.device_bytes,
            "bytes_allowed": self.memory_bytes,
            "estimated_error": self.chosen.error,
            "least_possible_error": self.chosen.bound,
        }


def least_pool(decoded: np.ndarray, blocks: BlockGrid) -> int:
    """Bytes that a block and its neighbours take at most, which are looked at together; ``decoded`` int64 [n]: bytes of
    each."""
    around = min(int(np.prod([min(n, 3) for n in blocks.counts])), len(decoded))
    return around * int(decoded.max(initial=0))


def seen_by_tiles(
    frame: RayFrame, grid: Grid, blocks: BlockGrid, levels: np.ndarray, picture: tuple[int, int], tile: tuple[int, int],
    reach: float = 0.0,
) -> Ranges:  # fmt: skip
    """The tiles of a picture whose rays may need samples of each block at ``levels``: those that see it, or what is
    within half the distance of its samples around it, where it has a share in blended values. ``reach``: voxels that
    gradients reach beyond that."""
    spacing = np.asarray(grid.spacing)
    low = blocks.places(np.arange(blocks.count))[:, ::-1] * blocks.edge - 0.5
    high = low + blocks.edge
    coarse = np.minimum(levels, blocks.levels - 1).astype(np.int64)
    beside = 0.5 * (1 << coarse)[:, None] + (reach + 0.1)  # and rounding
    to_edges = np.diag(spacing / spacing.min())
    return tile_ranges(low - beside, high + beside, frame, to_edges, picture, tile)
