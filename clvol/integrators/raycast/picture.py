"""A picture that a ray caster renders, whole, or some tiles at a time beside other devices.

There are one or two stages: with the scene's ``image.ray_spacing`` the rays of its lattice are cast first, and then
those of all pixels that cannot be interpolated between them (for a lattice or a list of pixels all rays are cast).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.device.tile_effects import cells_over_tiles, expected_costs, tiles_that_see
from clvol.device.view import EVERY_PIXEL, PixelLattice, PixelList, Pixels, RayFrame, ray_frame
from clvol.integrators.base import FrameData, PartOfPicture, PictureArrays, Progress
from clvol.opencl.context import DeviceArray
from clvol.schedule.tiles import TILE, tiling
from clvol.volume.voxel_layout import CELL_SHIFT

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.scene.camera import Camera

TilesDone = Callable[[int], None]
_OVERLAP = 3.0  # tiles that a cell counts for, over those that it covers
_MANY_TILES = 32  # of a list: shorter ones say little of what a tile takes
_A_TILE = 100.0  # samples that cost as much as beginning a tile


@dataclass
class _Stage:
    """A pass over the tiles of a picture of ``size``. ``outputs``: what its kernel writes and reads, by name."""

    kernel: str
    frame: RayFrame
    view: np.ndarray
    size: tuple[int, int]
    tiles: int
    outputs: dict[str, DeviceArray] = field(default_factory=dict)
    seen: np.ndarray | None = None  # bool [tiles]: those that may see a surface, once it was needed


class _Picture:
    """The stages of a picture, and launches over their tiles."""

    def __init__(
        self, caster: Raycaster, camera: Camera, width: int, height: int, depth: bool, lattice: Pixels
    ) -> None:
        self._caster, self._context, self._depth = caster, caster.context, depth
        self.notes: dict[str, Any] = {}
        self._listed = lattice if isinstance(lattice, PixelList) else None
        spacing = caster.resolved.image.ray_spacing
        picture = (width, height)
        if isinstance(lattice, PixelList) or spacing == 1 or lattice != EVERY_PIXEL:
            kernel = "raycast" if self._listed is None else "listed_rays"
            self._stages = [self._stage(kernel, camera, picture, lattice)]
            return
        coarse = self._stage("raycast", camera, picture, PixelLattice(spacing))
        last = self._stage("fill_between_rays", camera, picture, EVERY_PIXEL)
        last.view["ray_spacing"], last.view["lattice"] = spacing, coarse.size
        self._stages = [coarse, last]

    def _stage(self, kernel: str, camera: Camera, picture: tuple[int, int], lattice: Pixels) -> _Stage:
        caster, size = self._caster, lattice.size(*picture)
        of_rays = PixelLattice(covers=lattice.covers) if isinstance(lattice, PixelList) else lattice
        frame = ray_frame(camera, caster.resolved.volume.grid, *picture, of_rays)
        view = caster.frame_view(frame, *of_rays.size(*picture))
        return _Stage(kernel, frame, view, size, tiling(*size, *caster.tile).count)

    def _allocate(self, stage: _Stage, arrays: PictureArrays | None = None) -> None:
        """The arrays that the stage's kernel writes; ``arrays``: of a picture that is shared."""
        context, (width, height) = self._context, stage.size
        rgba, depths = (None, None) if arrays is None else (arrays.rgba, arrays.depth)
        stage.outputs["image"] = context.output(np.float32, (height, width, 4), rgba)
        stage.outputs["depths"] = self._caster.no_array
        if self._depth:
            stage.outputs["depths"] = context.output(np.float32, (height, width), depths)
            if self._caster.volume.in_front is not None:
                context.write(stage.outputs["depths"], self._caster.volume.in_front)
        stage.outputs["samples"] = context.output(np.uint32, (stage.tiles,))
        if self._listed is not None:
            stage.outputs["listed"] = context.upload(self._listed.places())
        if stage.kernel == "fill_between_rays":
            coarse = self._stages[0].outputs
            stage.outputs |= {"coarse": coarse["image"], "coarse_depths": coarse["depths"]}
            stage.outputs["rays"] = context.output(np.uint32, (stage.tiles,))

    def _launch(
        self, stage: _Stage, tiles: np.ndarray | None, progress: TilesDone | None
    ) -> tuple[np.ndarray | None, dict[str, int]]:
        """As ``_launch_group``, in the groups that the caster renders them in."""
        tallies: list[np.ndarray] = []
        counts: dict[str, int] = {}
        done = 0
        for group in self._caster.groups(stage.frame, stage.size, tiles):
            report = None if progress is None else lambda more, before=done: progress(before + more)
            tally, named = self._launch_group(stage, group, report)
            if group is not tiles:  # what this group needs is replaced by what the next one needs
                self._context.finish()
            tallies += [] if tally is None else [tally]
            counts = {name: counts.get(name, 0) + count for name, count in named.items()}
            done += stage.tiles if group is None else len(group)
        return np.concatenate(tallies) if tallies else None, counts

    def _launch_group(
        self, stage: _Stage, tiles: np.ndarray | None, progress: TilesDone | None
    ) -> tuple[np.ndarray | None, dict[str, int]]:
        """Enqueues ``tiles``, or all; those that can see no surface in kernels without surfaces. Returns the tallies
        and how many tiles were of either kind."""
        caster = self._caster
        plain = caster.without_surfaces
        if plain is None or stage.kernel != "raycast":
            return self._run(caster, stage, tiles, progress), {}
        if stage.seen is None:
            where = caster.volume.size, stage.frame, caster.effects.space.matrix, stage.size, caster.tile
            stage.seen = tiles_that_see(caster.surface_cells, *where)
        seen = stage.seen
        wanted = np.arange(stage.tiles) if tiles is None else tiles
        done, counts, tallies = 0, {}, []
        for engine, chosen, name in (
            (caster, wanted[seen[wanted]], "tiles_with_surfaces"),
            (plain, wanted[~seen[wanted]], "tiles_without_surfaces"),
        ):
            counts[name] = len(chosen)
            if len(chosen):
                report = None if progress is None else lambda more, before=done: progress(before + more)
                tallies.append(self._run(engine, stage, chosen, report))
                done += len(chosen)
        known = [tally for tally in tallies if tally is not None]
        return np.concatenate(known) if known else None, counts

    def _run(
        self, engine: Raycaster, stage: _Stage, tiles: np.ndarray | None, progress: TilesDone | None
    ) -> np.ndarray | None:
        tally = engine.launches(
            stage.kernel, stage.view, stage.tiles, self._depth, progress, stage.outputs, tiles, stage.size
        )
        return None if tally is None else self._context.take(tally)[: None if tiles is None else len(tiles)]


class WholePicture(_Picture):
    """A picture on one device."""

    def render(self, progress: Progress | None, chosen: np.ndarray | None = None) -> FrameData:
        """``progress(tiles done, all)`` is called after each launch. ``chosen``: the tiles (numbers) that are rendered,
        of a picture of one stage; the pixels of others, and the rays, are undefined then."""
        context, begun = self._context, perf_counter()
        every = [stage.tiles for stage in self._stages]
        tallies: list[np.ndarray] = []
        tile_counts: dict[str, int] = {}
        for number, stage in enumerate(self._stages):
            self._allocate(stage)
            before = sum(every[:number])
            report = None if progress is None else lambda done, before=before: progress(before + done, sum(every))
            tally, counts = self._launch(stage, chosen, report)
            tallies += [] if tally is None else [tally]
            tile_counts |= counts
        last = self._stages[-1]
        rays = self._stages[0].size[0] * self._stages[0].size[1]
        if self._listed is not None:
            rays = len(self._listed.rows)
        if len(self._stages) > 1:
            rays += int(context.take(last.outputs["rays"]).sum(dtype=np.uint64))
            context.take(self._stages[0].outputs["image"])
            if self._depth:
                context.take(self._stages[0].outputs["depths"])
        own = slice(None) if chosen is None else chosen
        names = ("image", "depths") if self._depth else ("image",)
        arrays = [last.outputs[name] for name in names] + [stage.outputs["samples"] for stage in self._stages]
        rgba, *others = context.take_all(arrays)
        distances = others.pop(0) if self._depth else None
        taken = sum(int(samples[own].sum(dtype=np.uint64)) for samples in others)
        if len(self._stages) == 1 and (self._listed is None or last.tiles >= _MANY_TILES):
            self._caster.took(last.kernel, last.tiles, perf_counter() - begun)
        counters = {}
        if tallies:
            counters = {**self._caster.counted(np.concatenate(tallies)), **tile_counts}
        return FrameData(rgba, distances, taken, rays, counters)


class PictureParts(_Picture):
    """A picture that several devices share (``integrators.base.TiledPictureParts``).

    They share the same tiles, also with devices on which a work-item casts one ray (whose own tiles are pixels).
    """

    coherent = False

    @property
    def tile(self) -> tuple[int, int]:
        return (TILE, TILE) if self._caster.tile == (1, 1) else self._caster.tile

    @property
    def sizes(self) -> list[tuple[int, int]]:
        return [stage.size for stage in self._stages]

    @property
    def stages(self) -> list[int]:
        return [tiling(*stage.size, *self.tile).count for stage in self._stages]

    def _own_tiles(self, stage: _Stage, tiles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The device's own tiles that make up ``tiles``, tile after tile, and where each begins in them."""
        if self._caster.tile == self.tile:
            return tiles, np.arange(len(tiles))
        pixels = pixels_of_tiles(tiles, stage.size, self.tile)
        return np.concatenate(pixels), np.cumsum([0, *map(len, pixels[:-1])])

    def expected_costs(self, stage: int) -> np.ndarray:
        """As in the protocol: from the visible cells in front of each tile."""
        this, caster = self._stages[stage], self._caster
        if self._listed is not None:
            return np.full(self.stages[stage], 1e3)
        grid = caster.resolved.volume.grid
        to_edges = np.diag(np.asarray(grid.spacing) / grid.smallest_edge)
        where = caster.shown, caster.volume.size, this.frame, to_edges, this.size, self.tile
        depths = caster.cell_depths()
        cells = cells_over_tiles(*where) / _OVERLAP if depths is None else expected_costs(depths, *where)
        pixels = self.tile[0] * self.tile[1]
        return cells * pixels * (1 << CELL_SHIFT) / caster.resolved.integration.step + _A_TILE

    def begin(self, stage: int, arrays: list[PictureArrays]) -> None:
        self._allocate(self._stages[stage], arrays[stage])
        if stage and not self._context.is_cpu:  # what the other devices have rendered
            before = self._stages[stage - 1].outputs
            self._context.write(before["image"], arrays[stage - 1].rgba.ravel())
            if (depths := arrays[stage - 1].depth) is not None:
                self._context.write(before["depths"], depths.ravel())
        self._arrays = arrays

    def render(self, stage: int, tiles: np.ndarray) -> PartOfPicture:
        this, context, begun = self._stages[stage], self._context, perf_counter()
        own, begins = self._own_tiles(this, tiles)
        tally, counts = self._launch(this, own, None)
        samples = np.add.reduceat(context.read(this.outputs["samples"])[own], begins, dtype=np.uint64)
        if self._listed is None or len(own) >= _MANY_TILES:
            self._caster.took(this.kernel, len(own), perf_counter() - begun)
        if self._listed is not None:
            of_tile = self.tile[0] * self.tile[1]
            rays = int(np.clip(len(self._listed.rows) - tiles * of_tile, 0, of_tile).sum())
        elif this.kernel == "raycast":
            rays = int(_pixels(tiles, this.size, self.tile).sum())
        else:
            rays = int(context.read(this.outputs["rays"])[own].sum(dtype=np.uint64))
        counters = {} if tally is None else {**self._caster.counted(tally), **counts}
        return PartOfPicture(samples + _A_TILE, int(samples.sum(dtype=np.uint64)), rays, counters)

    def end(self, stage: int, tiles: np.ndarray) -> None:
        this, context, arrays = self._stages[stage], self._context, self._arrays[stage]
        pairs = [(this.outputs["image"], arrays.rgba)]
        pairs += [(this.outputs["depths"], arrays.depth)] if arrays.depth is not None else []
        pairs += [(this.outputs["kept"], arrays.kept.now)] if arrays.kept is not None else []
        if context.is_cpu:  # it has written there
            for output, _ in pairs:
                context.take(output)
            return
        width, height = this.size
        across, down = self.tile
        columns = -(-width // across)
        own = np.zeros((-(-height // down), columns), bool)
        own.ravel()[tiles] = True
        mask = np.repeat(np.repeat(own, down, axis=0)[:height], across, axis=1)[:, :width]
        for output, shared in pairs:
            np.copyto(shared, context.read(output), where=mask.reshape(height, width, *[1] * (shared.ndim - 2)))


def pixels_of_tiles(tiles: np.ndarray, size: tuple[int, int], tile: tuple[int, int]) -> list[np.ndarray]:
    """int64 [n]: the numbers of the pixels, row by row of the picture, of each of ``tiles``."""
    (width, height), (across, down) = size, tile
    columns = max(-(-width // across), 1)
    found = []
    for number in tiles:
        left, top = int(number) % columns * across, int(number) // columns * down
        x, y = np.arange(left, min(left + across, width)), np.arange(top, min(top + down, height))
        found.append((y[:, None] * width + x).ravel())
    return found


def _pixels(tiles: np.ndarray, size: tuple[int, int], tile: tuple[int, int]) -> np.ndarray:
    """int64 [n]: numbers of pixels of ``tiles``, of which those at the upper ends are cut off."""
    (width, height), (across, down) = size, tile
    columns = max(-(-width // across), 1)
    left, top = tiles % columns * across, tiles // columns * down
    return np.minimum(across, width - left) * np.minimum(down, height - top)
