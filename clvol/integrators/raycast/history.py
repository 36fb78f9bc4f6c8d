"""Pictures whose rays start where those of the picture before first contributed (cl/coherence.h)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.device.view import EVERY_PIXEL, PixelLattice, RayFrame
from clvol.integrators.base import FrameData, Progress
from clvol.integrators.raycast.picture import WholePicture
from clvol.integrators.raycast.reprojection import MARGIN, Move, plan_move
from clvol.integrators.raycast.same_starts import Facts
from clvol.opencl.arguments import INT4, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.schedule.tiles import TILE, tiling

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.scene.camera import Camera

COHERENT_ARGUMENTS = (reads("starts", np.float32, "width", "height"), writes("kept", np.float32, "width", "height"))
_LATE = 1e-3  # edges that rounding may make
_AROUND = 8  # pixels around a late start that are rendered again
_UNSUPPORTED = (
    ("STEP_CELLS", "steps follow the data"),
    ("QUADRATURE", "quadrature by cells"),
    ("COMPOSITING", "a projection"),
    ("SLICES", "slices"),
    ("BLOCKS", "blocks"),
    ("BRICKS", "codes that stay on the device"),
)


class History:
    """What is kept of the last picture of a volume on one device.

    ``kept`` as in cl/coherence.h; ``frame``, ``size`` and ``facts`` of the picture that it belongs to. None before the
    first picture, and after one that was not completed.
    """

    def __init__(self) -> None:
        self.kept: DeviceArray | None = None
        self.frame: RayFrame | None = None
        self.size = (0, 0)
        self.facts: Facts | None = None
        self.audits = 0  # so far
        self._arrays: dict[str, DeviceArray] = {}

    def forget(self) -> None:
        self.frame = self.facts = None

    def array(self, name: str, shape: tuple[int, ...], make: Callable[[], DeviceArray]) -> DeviceArray:
        """The array ``name`` that is used for every picture of one size."""
        if name not in self._arrays or self._arrays[name].shape != shape:
            self._arrays[name] = make()
        return self._arrays[name]

    def reason_afresh(self, caster: Raycaster, frame: RayFrame, size: tuple[int, int], facts: Facts) -> Move | str:
        """How places move from the last picture to this one, or why rays start at the hull."""
        if self.frame is None or self.facts is None:
            return "the first picture"
        if size != self.size:
            return "another size"
        reason = facts.reason_afresh(self.facts)
        if reason is not None:
            return reason
        return plan_move(self.frame, frame, self.size, size, visible_bounds(caster), caster.resolved.coherence.splat)


def unsupported(caster: Raycaster) -> str | None:
    """Why pictures of this caster do not take starts from others; None if they may."""
    if caster.march.renders_all_pixels:
        return "another method"
    if caster.resolved.image.ray_spacing > 1:
        return "image.ray_spacing"
    return next((reason for switch, reason in _UNSUPPORTED if caster.switches.get(switch)), None)


def visible_bounds(caster: Raycaster) -> tuple[np.ndarray, np.ndarray]:
    """Lattice points (x, y, z): corners of a box around all cells in which anything can be seen."""
    shift, last = caster.volume.cell_shift, np.asarray(caster.volume.size) - 1
    box = []
    for axis in (2, 1, 0):
        seen = np.flatnonzero(caster.shown.any(axis=tuple({0, 1, 2} - {axis})))
        box.append((seen[0] << shift, (seen[-1] + 1) << shift))
    low, high = np.array(box, np.float64).T
    return np.minimum(low, last), np.minimum(high, last)


class CoherentPicture(WholePicture):
    """A picture on one device that keeps where its rays first contributed. ``starts``: where they may start; ``kept``:
    where that is written."""

    def __init__(
        self, caster: Raycaster, camera: Camera, width: int, height: int, depth: bool, lattice: PixelLattice,
        starts: DeviceArray, kept: DeviceArray,
    ) -> None:  # fmt: skip
        super().__init__(caster, camera, width, height, depth, lattice)
        self._more = {"starts": starts, "kept": kept}

    @property
    def frame(self) -> RayFrame:
        return self._stages[0].frame

    def _allocate(self, stage: Any, arrays: Any = None) -> None:
        super()._allocate(stage, arrays)
        stage.outputs |= self._more

    def render_again(self, data: FrameData, tiles: np.ndarray, starts: DeviceArray) -> FrameData:
        """``data``, this picture, with ``tiles`` rendered again from other ``starts``."""
        stage, context = self._stages[0], self._context
        stage.outputs["starts"] = starts
        if self._caster.without_surfaces is not None:
            self._launch(stage, tiles, None)
        else:  # the program that has rendered all of them
            for tile in tiles:
                self._caster.launches(stage.kernel, stage.view, stage.tiles, self._depth, None, stage.outputs,
                                      only=int(tile))  # fmt: skip
        more = int(context.read(stage.outputs["samples"])[tiles].sum(dtype=np.uint64))
        rgba = context.take(stage.outputs["image"])
        depth = None if data.depth is None else context.take(stage.outputs["depths"])
        return replace(data, rgba=rgba, depth=depth, samples=data.samples + more)


def render_from_history(
    caster: Raycaster, history: History, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool
) -> FrameData:
    """A picture whose rays start where ``history`` says. Its notes have "coherence"."""
    context, size = caster.context, (width, height)
    hull, starts, kept = _arrays(caster, history, size)
    facts = Facts.of(caster.resolved)
    picture = CoherentPicture(caster, camera, width, height, depth, EVERY_PIXEL, hull, kept)
    found = history.reason_afresh(caster, picture.frame, size, facts)
    notes: dict[str, Any] = {
        "mode": "reproject", "reused_starts": 0, "holes": 0, "late_starts": 0, "samples_saved": 0,
        "reinitialised": isinstance(found, str), "reason": found if isinstance(found, str) else None,
    }  # fmt: skip
    history.forget()  # until this picture is complete
    if isinstance(found, Move):
        reproject(context, found, kept, starts, size, step_back(caster))
        picture._more["starts"] = starts
    data = picture.render(progress)
    if isinstance(found, Move):
        known = np.isfinite(context.read(starts))
        met = np.isfinite(context.read(kept))
        notes["reused_starts"] = int(np.count_nonzero(known & met))
        notes["holes"] = int(np.count_nonzero(met)) - notes["reused_starts"]
        data = _audit(caster, history, camera, picture, data, (hull, starts, kept), notes)
    history.frame, history.size, history.facts = picture.frame, size, facts
    return replace(data, notes={**data.notes, "coherence": notes})


def step_back(caster: Raycaster) -> float:
    """Edges before the nearest place at which a ray starts: ceil(D / h) steps, D the diagonal of a voxel (Klein et al.
    2005, section 4.1)."""
    grid, step = caster.resolved.volume.grid, caster.resolved.integration.step
    diagonal = float(np.linalg.norm(grid.spacing)) / grid.smallest_edge
    return float(np.ceil(diagonal / step) * step)


def _arrays(
    caster: Raycaster, history: History, size: tuple[int, int]
) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
    """No starts, starts, and what is kept: float32 [height, width]. The last has what it had."""
    context, shape = caster.context, size[::-1]
    if history.kept is None or history.kept.shape != shape:
        history.kept = context.empty(np.float32, shape)
        history.forget()
    kept = history.kept
    hull = history.array("hull", shape, lambda: context.upload(np.full(shape, np.inf, np.float32)))
    return hull, history.array("starts", shape, lambda: context.empty(np.float32, shape)), kept


def reproject(
    context: DeviceContext, move: Move, kept: DeviceArray, starts: DeviceArray, size: tuple[int, int], back: float
) -> None:
    """Fills ``starts`` of a picture of ``size`` (width, height) from what is ``kept`` of the picture before."""
    width, height = size
    stride, rows = width + 2 * MARGIN + TILE, height + 2 * MARGIN
    nearest, widened = (context.empty(np.int32, (rows, stride)) for _ in range(2))
    numbers, inside = context.upload(move.numbers), context.upload(move.inside)
    extent = np.array([width, height, stride, rows], np.int32)
    window = np.array(move.window, np.int32)
    padded = (rows, stride)
    switches = {"MARGIN": MARGIN}

    def run(name: str, items: int, *declared: Any, **given: Any) -> None:
        kernel = context.kernel("reproject.cl", name, declared, switches)
        kernel(context.queue, (items,), None, **given)

    place, of_size = writes("nearest", np.int32, *padded), value("size", INT4)
    run("clear_nearest", rows, place, of_size, nearest=nearest, size=extent)
    run("project_kept", kept.shape[0], reads("kept", np.float32, *kept.shape), place, reads("move", np.float32, 24),
        of_size, value("old_width", np.int32),
        kept=kept, nearest=nearest, move=numbers, size=extent, old_width=kept.shape[1])  # fmt: skip
    run("widen_rows", rows, reads("nearest", np.int32, *padded), writes("widened", np.int32, *padded), of_size,
        value("window", INT4), nearest=nearest, widened=widened, size=extent, window=window)  # fmt: skip
    run("widen_columns", height, reads("widened", np.int32, *padded), reads("inside", np.uint8, *move.inside.shape),
        writes("starts", np.float32, height, width), of_size, value("window", INT4), value("back", np.float32),
        widened=widened, inside=inside, starts=starts, size=extent, window=window, back=back)  # fmt: skip
    context.finish()  # arrays that only these kernels use may be freed


def _audit(
    caster: Raycaster, history: History, camera: Camera, picture: CoherentPicture, data: FrameData,
    arrays: tuple[DeviceArray, DeviceArray, DeviceArray], notes: dict[str, Any],
) -> FrameData:  # fmt: skip
    """Renders one pixel of so many from the hull, each picture others, and what is around those that started late
    again."""
    hull, starts, kept = arrays
    height, width = starts.shape
    spacing = max(round(caster.resolved.coherence.audit**0.5), 1)
    lattice = audited_pixels(history.audits, spacing)
    history.audits += 1
    columns, rows = lattice.size(width, height)
    if not columns or not rows:
        return data
    context = caster.context
    seen = context.empty(np.float32, (rows, columns))
    audit = CoherentPicture(caster, camera, width, height, data.depth is not None, lattice, hull, seen)
    samples = audit.render(None).samples
    first = context.read(seen)
    started = context.read(starts)[lattice.slices]
    late = (first >= 0) & (first < np.where(np.isfinite(started), started, -np.inf) - _LATE)
    notes["late_starts"] = int(np.count_nonzero(late))
    notes["samples_saved"] = int(samples * (width * height / (columns * rows))) - data.samples
    data = replace(data, samples=data.samples + samples)
    if not late.any():
        return data
    tiles = tiling(width, height, *caster.tile)
    y, x = (spacing * at + first for at, first in zip(np.nonzero(late), (lattice.row, lattice.column)))
    again = np.zeros((-(-height // caster.tile[1]), -(-width // caster.tile[0])), bool)
    for top in (-_AROUND, 0, _AROUND):
        for left in (-_AROUND, 0, _AROUND):
            again[np.clip(y + top, 0, height - 1) // caster.tile[1],
                  np.clip(x + left, 0, width - 1) // caster.tile[0]] = True  # fmt: skip
    assert again.size == tiles.count
    return picture.render_again(data, np.flatnonzero(again), hull)


def audited_pixels(number: int, spacing: int) -> PixelLattice:
    """The pixels of audit ``number``: over spacing^2 audits every pixel once, each far from those before."""
    place = number * _coprime(spacing * spacing) % (spacing * spacing)
    return PixelLattice(spacing, place % spacing, place // spacing)


def _coprime(n: int) -> int:
    """A number that has no factor in common with ``n``, near the golden section of it."""
    at = max(round(n * 0.6180339887), 1)
    while np.gcd(at, n) != 1:
        at += 1
    return at
