"""Where the rays of one picture's tiles go, and the gaps between them are filled: on one device, or on several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from clvol.errors import ClvolError
from clvol.integrators.tiles.engine import RayEngine
from clvol.integrators.tiles.geometry import Resolution, TileGrid
from clvol.integrators.tiles.join import Joiner
from clvol.integrators.tiles.launch import CastRays, cast_rays
from clvol.integrators.tiles.work import RayWork
from clvol.opencl.context import DeviceArray, shared_array
from clvol.schedule.crew import Team

_ITEM = 64  # rays that devices share as one: whole packets, so that all packets are those of one device
SPEED, LAUNCH = 1e8, 1e-3  # samples per second and seconds per package, as a first guess
_FIRST_COST = 64 * 100.0  # samples of an item, as a first guess


class Canvas(Protocol):
    """A picture of ``grid``, at first without content."""

    def cast(self, work: RayWork, progress: Callable[[int], None] | None = None) -> CastRays:
        """Casts the rays of ``work``. ``progress(rays done)`` is called now and then."""
        ...

    def join(self, resolution: Resolution, tiles: np.ndarray) -> None:
        """Fills the gaps in ``tiles`` (numbers)."""
        ...

    def read(self) -> np.ndarray:
        """float32 [height, width, 4]: the current picture."""
        ...

    def read_depths(self) -> np.ndarray | None:
        """float32 [height, width]; None for a picture without."""
        ...


class DeviceCanvas:
    """A ``Canvas`` on the device of ``engine``. ``view``: ``View`` [1] of the whole picture."""

    def __init__(self, engine: RayEngine, view: np.ndarray, grid: TileGrid, depth: bool) -> None:
        self._engine, self._view, self._depth = engine, view, depth
        context, shape = engine.context, (grid.height, grid.width)
        self._image = context.empty(np.float32, (*shape, 4))
        self._depths = context.empty(np.float32, shape if depth else (1,))
        self._joiner = Joiner(context, grid, depth)

    def cast(self, work: RayWork, progress: Callable[[int], None] | None = None) -> CastRays:
        engine = self._engine
        packets = engine.packets(self._depth)
        return cast_rays(engine.context, packets, self._view, work, self._image, self._depths, progress)

    def join(self, resolution: Resolution, tiles: np.ndarray) -> None:
        self._joiner.join(resolution, tiles, self._image, self._depths)

    def read(self) -> np.ndarray:
        return self._engine.context.read(self._image)

    def read_depths(self) -> np.ndarray | None:
        return self._engine.context.read(self._depths) if self._depth else None


class SharedCanvas:
    """A ``Canvas`` whose rays are shared by devices, each with a copy of the picture; the host has what counts.

    ``engines``: the same scene on each device of ``team``. ``ready(device)`` is called before its first rays, by its
    own thread. ``on_loss(device, error)`` is called for one that fails; the error of the last one is raised. Rays
    of a device that is lost are cast by others, on copies that do not have them yet, so that what they change in the
    picture is the same.
    """

    def __init__(
        self, engines: Sequence[RayEngine], team: Team, ready: Callable[[int], None],
        on_loss: Callable[[int, BaseException], None], view: np.ndarray, grid: TileGrid, depth: bool,
    ) -> None:  # fmt: skip
        self._engines, self._team, self._ready, self._on_loss = engines, team, ready, on_loss
        self._grid, self._depth = grid, depth
        shape = grid.height, grid.width
        self._rgba = np.zeros((*shape, 4), np.float32)
        self._depths = np.zeros(shape if depth else (1, 1), np.float32)
        self._parts = [_Part(engine, view, grid, depth) for engine in engines]
        self._is_ready = [False] * len(engines)
        self._has_content = False

    def cast(self, work: RayWork, progress: Callable[[int], None] | None = None) -> CastRays:
        count = work.count
        changes = np.zeros(count, np.float32)
        counts: list[np.ndarray] = []
        samples = 0

        def take(items: np.ndarray, found: _Found) -> None:
            nonlocal samples
            rays = _rays_of(items, count)
            self._rgba.reshape(-1, 4)[work.pixels[rays]] = found.rgba
            if found.depths is not None:
                self._depths.reshape(-1)[work.pixels[rays]] = found.depths
            changes[rays] = found.cast.changes
            samples += found.cast.samples
            if found.cast.counts is not None:
                counts.append(found.cast.counts)

        report = None if progress is None else lambda items: progress(min(items * _ITEM, count))
        if count:
            hands = [_Hand(self, device, work) for device in range(len(self._engines))]
            costs = np.full(-(-count // _ITEM), _FIRST_COST)
            self._team.run(hands, costs, take, report, self._on_loss)
        self._has_content = True
        return CastRays(changes, samples, np.concatenate(counts) if counts else None)

    def begin(self, device: int) -> None:
        """Makes ``device`` ready to cast rays on a copy of the current picture. Called by its thread."""
        if not self._is_ready[device]:
            self._ready(device)
            self._is_ready[device] = True
        if self._has_content:
            self._parts[device].write(self._rgba, self._depths)

    def part(self, device: int) -> _Part:
        return self._parts[device]

    def join(self, resolution: Resolution, tiles: np.ndarray) -> None:
        while True:
            device = self._team.free_device()
            try:
                self._parts[device].join(resolution, tiles, self._rgba, self._depths)
                return
            except (ClvolError, MemoryError) as error:
                self._team.leave_out(device, error, self._on_loss)

    def read(self) -> np.ndarray:
        return self._rgba.copy()

    def read_depths(self) -> np.ndarray | None:
        return self._depths.copy() if self._depth else None


class _Found:
    """What a device found for some rays: their pixels, and what casting them took."""

    def __init__(self, rgba: np.ndarray, depths: np.ndarray | None, cast: CastRays) -> None:
        self.rgba, self.depths, self.cast = rgba, depths, cast


class _Part:
    """A copy of the picture on one device."""

    def __init__(self, engine: RayEngine, view: np.ndarray, grid: TileGrid, depth: bool) -> None:
        self._engine, self._view, self._grid, self._depth = engine, view.copy(), grid, depth
        self._arrays: tuple[DeviceArray, DeviceArray] | None = None
        self._joiner: Joiner | None = None

    @property
    def _device_arrays(self) -> tuple[DeviceArray, DeviceArray]:
        """Image and depths, made by the first call: other threads than the device's own must not wait for it."""
        if self._arrays is None:
            context, shape = self._engine.context, (self._grid.height, self._grid.width)
            shapes = (*shape, 4), shape if self._depth else (1, 1)
            image, depths = (context.output(np.float32, s, shared_array(s, np.float32)) for s in shapes)
            self._arrays = image, depths
        return self._arrays

    def write(self, rgba: np.ndarray, depths: np.ndarray) -> None:
        for array, values in zip(self._device_arrays, (rgba, depths)):
            self._engine.context.write(array, values)

    def cast(self, work: RayWork) -> _Found:
        engine, context = self._engine, self._engine.context
        image, depths = self._device_arrays
        cast = cast_rays(context, engine.packets(self._depth), self._view, work, image, depths)
        rgba = context.take(image).reshape(-1, 4)[work.pixels]
        return _Found(rgba, context.take(depths).reshape(-1)[work.pixels] if self._depth else None, cast)

    def join(self, resolution: Resolution, tiles: np.ndarray, rgba: np.ndarray, depths: np.ndarray) -> None:
        """Fills the gaps of the picture ``rgba`` with ``depths``, which are changed."""
        context = self._engine.context
        if self._joiner is None:
            self._joiner = Joiner(context, self._grid, self._depth)
        self.write(rgba, depths)
        self._joiner.join(resolution, tiles, *self._device_arrays)
        for array, values in zip(self._device_arrays, (rgba, depths)):
            found = context.take(array)
            np.copyto(values, found)


class _Hand:
    """A device in a job whose items are ``_ITEM`` rays of ``work`` each."""

    def __init__(self, canvas: SharedCanvas, device: int, work: RayWork) -> None:
        self._canvas, self._device, self._work = canvas, device, work

    def begin(self) -> None:
        self._canvas.begin(self._device)

    def work(self, items: np.ndarray) -> tuple[np.ndarray, _Found]:
        rays = _rays_of(items, self._work.count)
        found = self._canvas.part(self._device).cast(RayWork(self._work.pixels[rays], self._work.tiles[rays]))
        first = np.arange(0, len(rays), _ITEM) // found.cast.rays_an_item
        return np.add.reduceat(found.cast.samples_by_item, first, dtype=np.float64) + 1.0, found


def _rays_of(items: np.ndarray, count: int) -> np.ndarray:
    """The numbers of the rays of ``items``, of ``count`` rays in all."""
    rays = (items[:, None] * _ITEM + np.arange(_ITEM)).ravel()
    return rays[rays < count]
