"""Pictures whose rays start where those of the picture before first contributed (cl/coherence.h)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.device.view import EVERY_PIXEL, RayFrame
from clvol.features import STEPPINGS
from clvol.integrators.base import FrameData, Progress
from clvol.integrators.raycast.measured_gain import LEAST_PIXELS, MeasuredGain
from clvol.integrators.raycast.picture import WholePicture
from clvol.integrators.raycast.reprojection import MARGIN, MOVE, Move, plan_move
from clvol.integrators.raycast.same_starts import Facts
from clvol.opencl.arguments import INT4, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.tiles import TILE

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster
    from clvol.scene.camera import Camera

COHERENT_ARGUMENTS = (
    reads("starts", np.float32, "width", "height"),
    writes("kept", np.float32, "width", "height"),
    writes("tallies", np.uint32, "tiles", 4),
)
_REUSED, _HOLES, _LATE, _AUDITED = range(4)  # as in cl/coherence.h
_PAUSE, _LONGEST_PAUSE = 8, 64  # pictures from the hull after one with late starts: at first, and at most
LATE_BEFORE = "starts were late"
_NOTHING = 0x7F800000  # the bits of infinity
NOTHING_REUSED: dict[str, Any] = {
    "reused_starts": 0, "holes": 0, "late_starts": 0, "samples_saved": 0, "reinitialised": True,
}  # fmt: skip
_UNSUPPORTED = (
    ("STEP_CELLS", "steps follow the data"),
    ("MINIFICATION", "levels"),
    ("QUADRATURE", "quadrature by cells"),
    ("COMPOSITING", "a projection"),
    ("SLICES", "slices"),
    ("WORKERS", "the pyramid"),
    ("BRICKS", "codes that stay on the device"),
    ("GLOW", "associated colours"),
    ("CURVED_RAYS", "continuous refraction"),
)


class LateStarts:
    """After late starts pictures are rendered from the hull for a while, longer each time."""

    def __init__(self) -> None:
        self._pause = self._rests = 0  # the last pause in pictures, and what is left of it

    def found(self) -> None:
        self._pause = self._rests = min(max(2 * self._pause, _PAUSE), _LONGEST_PAUSE)

    def rests(self) -> str | None:
        """Why nothing is kept of the next picture, either; the last one before starts are taken again is kept."""
        if self._rests <= 1:
            return None
        self._rests -= 1
        return LATE_BEFORE

    def starts_from_hull(self) -> bool:
        """Whether the next picture, which is kept, does."""
        self._rests -= (ends := self._rests > 0)
        return ends


class History:
    """What is kept of the last picture of a volume on one device.

    The array "kept" as in cl/coherence.h; ``frame``, ``size`` and ``facts`` of the picture that it belongs to. None
    before the first picture, and after one that was not completed.
    """

    def __init__(self) -> None:
        self.frame: RayFrame | None = None
        self.size = (0, 0)
        self.facts: Facts | None = None
        self.audits = 0  # so far
        self.gain, self.late = MeasuredGain(), LateStarts()
        self.number = 0  # of the picture, if it was shared
        self._shared: History | None = None
        self._arrays: dict[str, DeviceArray] = {}

    def forget(self) -> None:
        self.frame = self.facts = None

    @property
    def of_shared(self) -> History:
        """That of pictures that are shared with other devices."""
        if self._shared is None:
            self._shared = History()
        return self._shared

    def array(self, name: str, shape: tuple[int, ...], make: Callable[[], DeviceArray]) -> DeviceArray:
        """The array ``name`` that is used for every picture of one size."""
        if name not in self._arrays or self._arrays[name].shape != shape:
            self._arrays[name] = make()
        return self._arrays[name]

    def nearest(self, context: DeviceContext, shape: tuple[int, int]) -> tuple[DeviceArray, DeviceArray]:
        """int32 arrays of ``shape``: one in which nothing is known, and one that is made so for the next picture."""
        names = ("nearest", "nearest, too")[:: 1 if self.audits % 2 else -1]
        made = [
            self.array(name, shape, lambda: context.upload(np.full(shape, _NOTHING, np.int32), writable=True))
            for name in names
        ]
        return made[0], made[1]

    def move_to(self, caster: Raycaster, frame: RayFrame, size: tuple[int, int], facts: Facts) -> Move | str:
        """How places move from the last picture to this one, or why rays start at the hull."""
        if self.late.starts_from_hull():
            return LATE_BEFORE
        if self.frame is None or self.facts is None:
            return "another size" if self.size not in ((0, 0), size) else "the first picture"
        reason = facts.reason_afresh(self.facts)
        if reason is not None:
            return reason
        return plan_move(self.frame, frame, self.size, size, visible_bounds(caster), caster.resolved.coherence.splat)


def unsupported(resolved: ResolvedScene, switches: Mapping[str, int]) -> str | None:
    """Why pictures of a scene with these switches do not take starts from others; None if they may."""
    if resolved.image.ray_spacing > 1:
        return "image.ray_spacing"
    if switches.get("BLOCKS"):
        if resolved.compression.decode == "resident":
            return "codes that stay on the device"
        if resolved.multiresolution.tiles:
            return "multiresolution.tiles"
        if not switches.get("WORKERS") and switches["STEPPING"] != STEPPINGS["full"]:
            return "steps that begin anew in each block"
    return next((reason for switch, reason in _UNSUPPORTED if switches.get(switch)), None)


def refused(resolved: ResolvedScene, switches: Mapping[str, int]) -> dict[str, Any] | None:
    """What is said of coherence where pictures do not take starts from others; None if they may."""
    reason = unsupported(resolved, switches)
    return None if reason is None else {"mode": "off" if switches.get("WORKERS") else "cells", "reason": reason}


def arrays_to_warm_up(caster: Raycaster, tiles: int) -> dict[str, DeviceArray]:
    """What a launch without pixels takes in addition."""
    if caster.resolved.coherence.mode != "reproject" or unsupported(caster.resolved, caster.switches):
        return {}
    context = caster.context
    return {"starts": caster.no_array, "kept": caster.no_array, "tallies": context.empty(np.uint32, (tiles, 4))}


def warm_up_reprojection(context: DeviceContext) -> None:
    """Launches the kernels of ``reproject``, for a picture of a tile of which nothing is known."""
    history, size = History(), (TILE, TILE)
    history.array("kept", size, lambda: context.upload(np.full(size, np.inf, np.float32), writable=True))
    nowhere = Move(np.zeros(MOVE, np.float32), (0, 0, 0, 0), np.zeros((1, 1), np.uint8))
    reproject(context, history, nowhere, size, 1.0, 1)
    context.finish()


def visible_bounds(caster: Raycaster) -> tuple[np.ndarray, np.ndarray]:
    """Lattice points (x, y, z): corners of a box around all cells in which anything can be seen."""
    layout, last = caster.volume.cell_layout, np.asarray(caster.volume.size) - 1
    box = []
    for axis in (2, 1, 0):
        seen = np.flatnonzero(caster.shown.any(axis=tuple({0, 1, 2} - {axis})))
        box.append((seen[0] * layout.edge + layout.first, (seen[-1] + 1) * layout.edge + layout.first))
    low, high = np.array(box, np.float64).T
    return np.clip(low, 0, last), np.minimum(high, last)


class CoherentPicture(WholePicture):
    """A picture on one device that keeps where its rays first contributed. ``starts``: where they may start; ``kept``:
    where that is written."""

    def __init__(
        self, caster: Raycaster, camera: Camera, width: int, height: int, depth: bool, starts: DeviceArray,
        kept: DeviceArray,
    ) -> None:  # fmt: skip
        super().__init__(caster, camera, width, height, depth, EVERY_PIXEL)
        self.starts, self.kept = starts, kept

    @property
    def frame(self) -> RayFrame:
        return self._stages[0].frame

    def _allocate(self, stage: Any, arrays: Any = None) -> None:
        super()._allocate(stage, arrays)
        tallies = self._context.output(np.uint32, (stage.tiles, 4))
        stage.outputs |= {"starts": self.starts, "kept": self.kept, "tallies": tallies}

    def tallies(self) -> np.ndarray:
        """uint32 [tiles, 4]: see cl/coherence.h."""
        return self._context.take(self._stages[0].outputs["tallies"])

    def render_again(self, data: FrameData, starts: DeviceArray) -> FrameData:
        """``data``, this picture, rendered again from other ``starts``."""
        stage, context = self._stages[0], self._context
        stage.outputs["starts"] = starts
        self._launch(stage, None, None)
        more = int(context.take(stage.outputs["samples"]).sum(dtype=np.uint64))
        rgba = context.take(stage.outputs["image"])
        depth = None if data.depth is None else context.take(stage.outputs["depths"])
        return replace(data, rgba=rgba, depth=depth, samples=data.samples + more)


def render_from_history(
    caster: Raycaster, history: History, camera: Camera, width: int, height: int, progress: Progress | None, depth: bool
) -> FrameData:
    """A picture whose rays start where ``history`` says. Its notes have "coherence"."""
    refusal = refused(caster.resolved, caster.switches)
    if refusal is not None:
        data = WholePicture(caster, camera, width, height, depth, EVERY_PIXEL).render(progress)
        return replace(data, notes={**data.notes, "coherence": refusal})
    begun, measured = perf_counter(), width * height >= LEAST_PIXELS
    reason = history.late.rests()
    if reason is None and measured:
        reason = history.gain.turn()
    if reason is not None:
        history.forget()
        data = WholePicture(caster, camera, width, height, depth, EVERY_PIXEL).render(progress)
        if measured:
            history.gain.took(perf_counter() - begun, reused=False)
        return replace(data, notes={**data.notes, "coherence": NOTHING_REUSED | {"mode": "cells", "reason": reason}})
    context, size, shape = caster.context, (width, height), (height, width)
    hull = history.array("hull", shape, lambda: context.upload(np.full(shape, np.inf, np.float32)))
    if history.size != size:
        history.forget()
    kept = history.array("kept", shape, lambda: context.empty(np.float32, shape))
    facts = Facts.of(caster.resolved, caster.volume.contents)
    picture = CoherentPicture(caster, camera, width, height, depth, hull, kept)
    found = history.move_to(caster, picture.frame, size, facts)
    reused = isinstance(found, Move)
    audit = caster.resolved.coherence.audit
    if isinstance(found, Move):
        picture.starts = reproject(context, history, found, size, step_back(caster), audit)
    history.forget()  # until this picture is complete
    data = picture.render(progress)
    tallies = picture.tallies()
    sums = [int(total) for total in tallies.sum(axis=0, dtype=np.int64)]
    notes = {
        "mode": "reproject", "reused_starts": sums[_REUSED], "holes": sums[_HOLES] if reused else 0,
        "late_starts": sums[_LATE],
        "samples_saved": sums[_AUDITED] * (audit - 1) - (data.samples - sums[_AUDITED]) if reused else 0,
        "reinitialised": not reused, "reason": found if isinstance(found, str) else None,
    }  # fmt: skip
    if sums[_LATE]:
        # What the audit found at some pixels may be at others, too.
        data = picture.render_again(data, hull)
        history.late.found()
        history.gain.lost()
    elif measured and reused:
        history.gain.took(perf_counter() - begun, reused=True)
    history.frame, history.size, history.facts = picture.frame, size, facts
    return replace(data, notes={**data.notes, "coherence": notes})


def step_back(caster: Raycaster) -> float:
    """Edges before the nearest place at which a ray starts: ceil(D / h) steps, D the diagonal of a voxel (Klein et al.
    2005, section 4.1)."""
    grid, step = caster.resolved.volume.grid, caster.resolved.integration.step
    diagonal = float(np.linalg.norm(grid.spacing)) / grid.smallest_edge
    return float(np.ceil(diagonal / step) * step)


def reproject(
    context: DeviceContext, history: History, move: Move, size: tuple[int, int], back: float, audit: int,
    kept: DeviceArray | None = None,
) -> DeviceArray:  # fmt: skip
    """float32 [height, width]: the starts of a picture of ``size`` (width, height), from what is ``kept`` of the
    picture before; None: what ``history`` has kept. One packet of ``audit`` is marked."""
    width, height = size
    stride, rows = -(-(width + 2 * MARGIN) // TILE) * TILE + TILE, height + 2 * MARGIN
    make = context.empty
    starts = history.array("starts", (height, width), lambda: make(np.float32, (height, width)))
    kept = kept or history.array("kept", (height, width), lambda: make(np.float32, (height, width)))
    nearest, following = history.nearest(context, (rows, stride))
    numbers, inside = context.upload(move.numbers), context.upload(move.inside)
    golden = _coprime(audit)
    chosen = np.array([audit, history.audits * golden % audit, golden, 0], np.int32)

    def run(name: str, items: int, *declared: Any, **given: Any) -> None:
        kernel = context.kernel("reproject.cl", name, declared, {"MARGIN": MARGIN})
        kernel(context.queue, (items,), (1,) if context.is_cpu else None, move=numbers, size=extent, **given)

    extent = np.array([width, height, stride, rows], np.int32)
    of_move, of_size = reads("move", np.float32, MOVE), value("size", INT4)
    run("project_kept", rows, reads("kept", np.float32, height, width),
        writes("nearest", np.int32, rows, stride), writes("next", np.int32, rows, stride), of_move, of_size,
        kept=kept, nearest=nearest, next=following)  # fmt: skip
    run("find_starts", move.inside.size, reads("nearest", np.int32, rows, stride),
        reads("inside", np.uint8, *move.inside.shape), writes("starts", np.float32, height, width), of_move, of_size,
        value("window", INT4), value("back", np.float32), value("audit", INT4),
        nearest=nearest, inside=inside, starts=starts, window=np.array(move.window, np.int32), back=back,
        audit=chosen)  # fmt: skip
    history.audits += 1
    return starts


def _coprime(n: int) -> int:
    """A number that has no factor in common with ``n``, near its golden section: multiples of it are far apart."""
    at = max(round(n * 0.6180339887), 1)
    while np.gcd(at, n) != 1:
        at += 1
    return at
