"""Pictures of several rays per pixel, from any method that renders lattices and lists of pixels.

First every pixel gets a ray through its middle; those that differ from a neighbour, or may hide something, then get
``samples`` rays, whose mean they become. Refined pixels whose rays differ make their neighbours compare again, in two
more rounds at most. Lists of rays are shared by devices like pictures, and a pixel is the same, bit for bit, however
it came into a list: pictures do not depend on devices or tiles, nor refined pixels on how many are refined.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from clvol.device.view import EVERY_PIXEL, PixelLattice, PixelList, Pixels, picture_height, ray_frame
from clvol.integrators.base import FrameData, Progress
from clvol.render.supersampling.edges import Edges
from clvol.render.supersampling.pattern import Pattern, pattern
from clvol.render.supersampling.pixel_filter import FILTERS, FilteredPicture
from clvol.render.supersampling.thin import hidden
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene

_MOST_ROUNDS = 2  # in which neighbours of refined pixels compare again
_MOST_RAYS = 1 << 21  # of a list
_FIRST_RAYS = 1 << 14  # of the first list of a picture for a given time
_SHARE_OF_TIME = 0.5  # for the rays through the middles, of such a picture
_LIST_SECONDS = 0.1  # that its lists take, about


class Source(Protocol):
    """What casts rays: a ``Prepared``, or devices that share them."""

    def render(
        self, camera: Camera, width: int, height: int, progress: Progress | None = None, depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData: ...  # fmt: skip

    @property
    def visible_cells(self) -> tuple[np.ndarray, int] | None: ...


@dataclass
class _Counts:
    """What all pictures and lists took."""

    samples: int = 0
    rays: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    notes: dict[str, Any] = field(default_factory=dict)

    def add(self, data: FrameData) -> None:
        self.samples += data.samples
        self.rays += data.rays
        for name, count in data.counters.items():
            self.counters[name] = self.counters.get(name, 0) + count
        self.notes = {**data.notes, **self.notes}  # of the whole picture, where there is one


def rendered(
    source: Source, resolved: ResolvedScene, camera: Camera, width: int, height: int,
    progress: Progress | None = None, depth: bool = True,
) -> FrameData:  # fmt: skip
    """The whole picture, with as many rays per pixel as the scene asks for."""
    if resolved.image.samples == 1:
        return source.render(camera, width, height, progress, depth)
    return supersampled(source, resolved, camera, width, height, progress, depth)


def supersampled(
    source: Source, resolved: ResolvedScene, camera: Camera, width: int, height: int,
    progress: Progress | None = None, depth: bool = True,
    for_seconds: Callable[[float], FrameData] | None = None, seconds: float | None = None,
) -> FrameData:  # fmt: skip
    """The picture with ``image.samples`` rays per pixel (more than 1), of all pixels or those at edges.

    ``notes["supersampling"]``: "samples", "refined_pixels", "share_of_pixels", "rounds" (pixels refined in each).
    ``seconds``: pixels are refined, those that differ most first, until so many have passed since the call;
    ``for_seconds(s)`` renders the picture of one ray per pixel for that time.
    """
    image = resolved.image
    made = _Picture(source, resolved, camera, width, height, progress, depth)
    if seconds is not None:
        return made.for_time(for_seconds, seconds)
    if image.refine == "all" or image.edge_threshold == 0.0:
        return made.everywhere()
    return made.graded() if image.refine == "graded" else made.at_edges()


class _Picture:
    def __init__(
        self, source: Source, resolved: ResolvedScene, camera: Camera, width: int, height: int,
        progress: Progress | None, depth: bool,
    ) -> None:  # fmt: skip
        self._source, self._resolved, self._camera = source, resolved, camera
        self._width, self._height, self._depth = width, height, depth
        self._progress = progress
        image = resolved.image
        self._pattern: Pattern = pattern(image.samples, image.sample_pattern)
        self._half = pattern(max(image.samples // 2, 2), image.sample_pattern)
        self._filter = image.pixel_filter
        self._counts = _Counts()
        self._edges = Edges(image.edge_threshold, resolved.background, resolved.display, self._footprint())

    def _footprint(self) -> tuple[float, float]:
        """(a, b): a pixel is a + b depth wide in the world."""
        camera = self._camera
        if camera.projection == "orthographic":
            return picture_height(camera) / self._height, 0.0
        return 0.0, 2.0 * float(np.tan(np.radians(camera.fov_degrees) / 2.0)) / self._height

    # ---- rays

    def _render(self, lattice: Pixels, report: Progress | None, cells: int) -> FrameData:
        """Rays of a pattern: pixels of the view at ``cells`` times the size."""
        size = self._width * cells, self._height * cells
        data = self._source.render(self._camera, *size, report, self._depth, lattice)
        self._counts.add(data)
        return data

    def _cast(
        self, pixels: np.ndarray, report: Progress | None, of: Pattern | None = None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """float32 [n, rays, 4] and depths float32 [n, rays] of ``pixels`` (numbers, int64 [n]): those of the pattern
        ``of``, by default the picture's."""
        of = of or self._pattern
        cells, places = of.cells, np.array(of.places, np.int32)
        row, column = np.divmod(pixels.astype(np.int32), np.int32(self._width))
        rows = (row[:, None] * np.int32(cells) + places[:, 1]).ravel()
        columns = (column[:, None] * np.int32(cells) + places[:, 0]).ravel()
        data = self._render(PixelList(rows, columns, cells, of.covers), report, cells)
        rgba = data.rgba.reshape(-1, 4)[: len(rows)].reshape(len(pixels), len(places), 4)
        if data.depth is None:
            return rgba, None
        return rgba, data.depth.ravel()[: len(rows)].reshape(len(pixels), len(places))

    def _part(self, done: float, share: float) -> Progress | None:
        """A progress function for a part of the picture: ``share`` of it, after ``done``."""
        progress = self._progress
        if progress is None:
            return None
        return lambda k, n: progress(round(1000 * (done + share * k / max(n, 1))), 1000)

    # ---- all pixels

    def everywhere(self) -> FrameData:
        """Every pixel has all rays of the pattern."""
        height, width, made = self._height, self._width, self._pattern
        filtered = FilteredPicture(self._filter, height, width)
        depths = np.full((height, width), np.inf, np.float32) if self._depth else None
        share = 1.0 / len(made.places)
        for k, ((column, row), offset) in enumerate(zip(made.places, made.offsets())):
            lattice = PixelLattice(made.cells, column, row, alone=True, covers=made.covers)
            data = self._render(lattice, self._part(k * share, share), made.cells)
            filtered.add(data.rgba, offset)
            if depths is not None and data.depth is not None:
                np.minimum(depths, data.depth, out=depths)
        return self._frame(filtered.take(), depths, [width * height])

    # ---- pixels at edges

    def at_edges(self) -> FrameData:
        """Pixels that differ from a neighbour, or may hide something, have all rays of the pattern."""
        first = self._source.render(
            self._camera, self._width, self._height, self._part(0.0, 0.5), self._depth, EVERY_PIXEL
        )
        self._counts.add(first)
        refined = _Refined(first, self._width, self._height, self._edges, bool(FILTERS[self._filter][1]))
        wanted = np.flatnonzero(self._wanted(first).ravel())
        rounds: list[int] = []
        while len(wanted):
            done = 0.5 + 0.5 * (1.0 - 0.5 ** len(rounds))
            for part in self._lists(wanted):
                refined.put(part, *self._cast(part, self._part(done, 0.0)))
            rounds.append(len(wanted))
            if len(rounds) > _MOST_ROUNDS:
                break
            wanted = refined.asked_again(wanted)
        self._report_all()
        return self._frame(*self._joined(refined), rounds)

    def graded(self) -> FrameData:
        """As ``at_edges``: pixels are the mean of the ray through their middle and of all rays of the pattern, or of
        one of half as many where they differ by little."""
        first = self._source.render(
            self._camera, self._width, self._height, self._part(0.0, 0.5), self._depth, EVERY_PIXEL
        )
        self._counts.add(first)
        refined = _Refined(first, self._width, self._height, self._edges, keep=False, with_middle=True)
        grades = self._edges.grade(first.rgba, first.depth)
        grades[self._hidden(first)] = 2
        rounds: list[int] = []
        wanted, few = np.flatnonzero(grades.ravel() == 2), np.flatnonzero(grades.ravel() == 1)
        while len(wanted) or len(few):
            done = 0.5 + 0.5 * (1.0 - 0.5 ** len(rounds))
            for pixels, of in ((wanted, self._pattern), (few, self._half)):
                for part in self._lists(pixels):
                    refined.put(part, *self._cast(part, self._part(done, 0.0), of))
            rounds.append(len(wanted) + len(few))
            if len(rounds) > _MOST_ROUNDS:
                break
            wanted, few = refined.asked_again(np.concatenate([wanted, few])), few[:0]
        self._report_all()
        return self._frame(refined.means(), refined.depth, rounds)

    def _hidden(self, first: FrameData) -> np.ndarray:
        """bool [height, width]: pixels that may hide something thinner than they are; of a single pixel, that one."""
        cells = self._source.visible_cells
        if self._width * self._height == 1:  # there is nothing to compare it with
            return np.ones((1, 1), bool)
        if cells is None:
            return np.zeros((self._height, self._width), bool)
        grid = self._resolved.volume.grid
        frame = ray_frame(self._camera, grid, self._width, self._height)
        return hidden(*cells, grid, frame, first.rgba[..., 3])

    def _wanted(self, first: FrameData) -> np.ndarray:
        """bool [height, width]: pixels to refine, by the picture of one ray per pixel."""
        return self._edges.find(first.rgba, first.depth) | self._hidden(first)

    def _lists(self, pixels: np.ndarray) -> Iterator[np.ndarray]:
        """``pixels`` (numbers) in lists of bounded length, neighbours close together: in blocks of 4 by 4."""
        row, column = np.divmod(pixels, self._width)
        block = (row >> 2) * (self._width // 4 + 1) + (column >> 2)
        ordered = pixels[np.argsort(block * 16 + (row & 3) * 4 + (column & 3))]
        length = max(_MOST_RAYS // len(self._pattern.places), 1)
        for k in range(0, len(ordered), length):
            yield ordered[k : k + length]

    def _joined(self, refined: _Refined) -> tuple[np.ndarray, np.ndarray | None]:
        """The picture in which refined pixels are means of their rays; of the others, the one ray stands for all."""
        if not FILTERS[self._filter][1]:
            return refined.means(), refined.depth
        filtered = FilteredPicture(self._filter, self._height, self._width)
        for k, offset in enumerate(self._pattern.offsets()):
            filtered.add(refined.picture_of(k), offset)
        return filtered.take(), refined.depth

    # ---- for a given time

    def for_time(self, for_seconds: Callable[[float], FrameData] | None, seconds: float) -> FrameData:
        """As ``at_edges``, until ``seconds`` have passed since the call."""
        start = perf_counter()
        assert for_seconds is not None
        first = for_seconds(_SHARE_OF_TIME * seconds)
        self._counts.add(first)
        refined = _Refined(first, self._width, self._height, self._edges, bool(FILTERS[self._filter][1]))
        found = np.flatnonzero(self._wanted(first).ravel())
        wanted = found[np.argsort(-self._edges.contrast(first.rgba).ravel()[found], kind="stable")]
        count, rate, done = max(_FIRST_RAYS // len(self._pattern.places), 1), 0.0, 0
        while done < len(wanted) and (left := seconds - (perf_counter() - start)) > 0:
            if rate:
                count = int(min(rate * min(left, _LIST_SECONDS), len(wanted)))
            part, begun = wanted[done : done + max(count, 64)], perf_counter()
            for each in self._lists(part):
                refined.put(each, *self._cast(each, None))
            rate, done = len(part) / max(perf_counter() - begun, 1e-6), done + len(part)
        self._report_all()
        return self._frame(*self._joined(refined), [done] if done else [])

    def _report_all(self) -> None:
        if self._progress is not None:
            self._progress(1000, 1000)

    def _frame(self, rgba: np.ndarray, depths: np.ndarray | None, rounds: list[int]) -> FrameData:
        counts, total = self._counts, sum(rounds)
        counts.notes["supersampling"] = {
            "samples": len(self._pattern.places),
            "refined_pixels": total,
            "share_of_pixels": total / (self._width * self._height),
            "rounds": rounds,
        }
        return FrameData(rgba, depths, counts.samples, counts.rays, counts.counters, notes=counts.notes)


class _Refined:
    """A picture of one ray per pixel, some pixels of which have got more. ``keep``: whether their rays are kept.
    ``with_middle``: whether the one ray counts as one of them."""

    def __init__(
        self, first: FrameData, width: int, height: int, edges: Edges, keep: bool, with_middle: bool = False
    ) -> None:
        self._with_middle = with_middle
        self._size, self._edges, self._keep = (width, height), edges, keep
        self._one = first.rgba
        self._mean = np.array(first.rgba).reshape(-1, 4)
        self.depth = None if first.depth is None else np.array(first.depth)
        self._done = np.zeros(width * height, bool)
        self._differ = np.zeros(width * height, bool)  # pixels whose own rays do
        self._parts: list[tuple[np.ndarray, np.ndarray]] = []

    def put(self, pixels: np.ndarray, rgba: np.ndarray, depths: np.ndarray | None) -> None:
        """``rgba`` [n, rays, 4] and ``depths`` [n, rays] of ``pixels`` (numbers): a pixel is as deep as its nearest
        ray."""
        self._done[pixels] = True
        if self._keep:
            self._parts.append((pixels, rgba))
        rays = [rgba[:, k] for k in range(rgba.shape[1])]
        if self._with_middle:
            rays.append(self._one.reshape(-1, 4)[pixels])
        total = np.zeros((len(pixels), 4))
        low = high = self._edges.shown(rays[0])
        for k, ray in enumerate(rays):
            total += ray
            shown = low if k == 0 else self._edges.shown(ray)
            low, high = np.minimum(low, shown), np.maximum(high, shown)
        self._mean[pixels] = total / len(rays)
        self._differ[pixels] = self._edges.differ(low, high)
        if self.depth is not None and depths is not None:
            flat, nearest = self.depth.reshape(-1), depths.min(axis=1)
            flat[pixels] = np.minimum(nearest, flat[pixels]) if self._with_middle else nearest

    def means(self) -> np.ndarray:
        """float32 [height, width, 4]."""
        return self._mean.reshape(self._one.shape)

    def picture_of(self, ray: int) -> np.ndarray:
        """float32 [height, width, 4]: the pixels' rays of this number; of pixels with one ray, that one."""
        found = np.array(self._one).reshape(-1, 4)
        for pixels, rgba in self._parts:
            found[pixels] = rgba[:, ray]
        return found.reshape(self._one.shape)

    def asked_again(self, before: np.ndarray) -> np.ndarray:
        """Pixels (numbers) not refined yet that differ from a neighbour among ``before``, the pixels refined last,
        whose own rays differ."""
        (width, height), edges = self._size, self._edges
        asking = before[self._differ[before]]
        mean = edges.shown(self._mean[asking])
        row, column = np.divmod(asking, width)
        found = np.zeros(width * height, bool)
        for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            y, x = row + dy, column + dx
            other = np.clip(y, 0, height - 1) * width + np.clip(x, 0, width - 1)
            at = np.flatnonzero((y >= 0) & (y < height) & (x >= 0) & (x < width) & ~self._done[other])
            other = other[at]
            found[other[edges.differ(mean[:, at], edges.shown(self._one.reshape(-1, 4)[other]))]] = True
        return np.flatnonzero(found)
