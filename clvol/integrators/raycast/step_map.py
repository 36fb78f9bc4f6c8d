"""Steps that follow the data: how many steps a ray's segment may have, wherever it begins.

A segment of n steps through cells of curvature S, slope G and values from low to high is wrong by at most what
``clvol.transfer.step_bounds`` says. It is allowed where that is at most ``step_error`` per voxel edge at a step of one
edge; at other steps the bound is proportional to the step's square, as the error of even steps is, so that pictures
converge with the step all the same.

Whether a scene is rendered that way is decided on a sample of its volume (``follows_data``), on the host: looking up
the map at each sample costs a quarter of a frame, which segments have to save first.
"""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from clvol.device.memory import value_map
from clvol.device.transfer_lookup import segment_classification
from clvol.device.volume import DeviceVolume
from clvol.encoding.coded_volume import UndecodedVolume
from clvol.features import effects
from clvol.features.refuse import PLAIN
from clvol.features.values import shows
from clvol.opencl.arguments import INT4, RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.scene.resolve import ResolvedScene
from clvol.transfer import TransferFunction
from clvol.transfer.step_bounds import most_steps
from clvol.volume import Volume
from clvol.volume.lazy import LazyVolume
from clvol.volume.series import StepVolume

CELL_SHIFT = 2  # CELL of cl/cell_curvature.cl is 1 << this
MOST = 8  # steps of one segment
_WORTH = 2.5  # mean number of steps, in cells that show something, from which on the map saves more than it costs
_SAMPLED = 12  # cells along each axis that are looked at to decide
_TYPICAL_ERROR = 1e-3  # of that decision, which must not depend on a setting that changes without compiling

_KEPT = 64  # functions of a volume whose decision is known

_samples: WeakKeyDictionary[Volume, np.ndarray] = WeakKeyDictionary()
_gains: WeakKeyDictionary[Volume, dict[tuple[TransferFunction, bool], bool]] = WeakKeyDictionary()


def follows_data(resolved: ResolvedScene, function: TransferFunction | None = None) -> bool:
    """Whether the ray caster's steps follow the data of the scene, with ``function`` in place of its own."""
    return resolved.integration.step_error > 0 and is_smooth(resolved, function)


def is_smooth(resolved: ResolvedScene, function: TransferFunction | None = None) -> bool:
    """Whether steps can follow the data of the scene, with ``function`` in place of its own, and gain by it.

    They can in scenes of emission and absorption alone, of whole volumes of finite values and up to 32 bits, under the
    linear filter, where that is expected to save about half of the samples.
    """
    integration, volume = resolved.integration, resolved.volume
    if integration.filter != "linear" or integration.quadrature != "steps":
        return False
    if integration.classification == "pre" or integration.compositing != "over":
        return False
    if isinstance(volume, LazyVolume) and (isinstance(volume, UndecodedVolume) or not volume.is_read):
        return False
    if volume.dtype.itemsize > 4 or volume.nan_count or volume.inf_count:
        return False
    if resolved.animation.cycle or value_map(volume).gain != 1.0:
        return False
    if any(e.called_for and e.name not in PLAIN for e in effects(resolved)):
        return False
    function = function or resolved.transfer_function
    midpoints = segment_classification(integration, (function,)) == "post"
    kept = _gains.setdefault(volume, {})
    if (function, midpoints) not in kept:
        while len(kept) >= _KEPT:
            del kept[next(iter(kept))]
        kept[function, midpoints] = _gains_by_steps(volume, function, midpoints)
    return kept[function, midpoints]


def _gains_by_steps(volume: Volume, function: TransferFunction, midpoints: bool) -> bool:
    """Whether cells that show something allow steps that are long enough."""
    cells = sampled_cells(volume.widest if isinstance(volume, StepVolume) else volume)
    nodes = np.linspace(*volume.value_range, 257)
    visible = shows(function, cells[:, 2], cells[:, 3])
    if not visible.any():
        return False
    edge = volume.grid.smallest_edge
    steps = most_steps(cells[visible], function, nodes, edge, 1.0, _TYPICAL_ERROR, MOST, midpoints, per_step=True)
    return float(np.mean(steps)) >= _WORTH


def step_map(
    context: DeviceContext, resolved: ResolvedScene, volume: DeviceVolume, function: TransferFunction, nodes: np.ndarray
) -> np.ndarray:
    """uint8 [z, y, x], 1 to 8: steps that a segment may have that begins in a cell of 4^3 lattice points. ``function``
    over the values that kernels compute with, and its ``nodes``."""
    bounds = volume.keep("bounds of cells", lambda: cell_bounds(context, volume))
    integration = resolved.integration
    step = integration.step
    allowed = most_steps(
        bounds.reshape(-1, 4), function, nodes, step * resolved.volume.grid.smallest_edge, step,
        integration.step_error * step**3, MOST, segment_classification(integration, (function,)) == "post",
        per_step=True,
    )  # fmt: skip
    return _within_reach(allowed.reshape(bounds.shape[:3]), step)


def cell_bounds(context: DeviceContext, volume: DeviceVolume) -> np.ndarray:
    """float32 [z, y, x, 4]: the largest curvature (value per voxel^2) and slope (value per voxel), the lowest and the
    highest value of each cell."""
    nx, ny, nz = volume.size
    shape = tuple(((n - 1) >> CELL_SHIFT) + 1 for n in (nz, ny, nx))
    kernel = context.kernel(
        "cell_curvature.cl",
        "cell_curvature",
        (
            reads("volume", RAW, "size.x", "size.y", "size.z"),
            value("size", INT4),
            writes("cells", np.float32, *shape, 2),
        ),
        {name: volume.switches[name] for name in ("VOXEL_BITS", "VOXEL_SIGNED")},
    )
    cells = context.empty(np.float32, (*shape, 2))
    kernel(context.queue, shape[1::-1], None, volume=volume.plain(), size=(nx, ny, nz, 0), cells=cells)
    bounds = np.empty((*shape, 4), np.float32)
    bounds[..., :2] = context.read(cells)
    for k, extreme in enumerate(volume.min_max(CELL_SHIFT)):  # a last lattice point alone is in the cell before
        bounds[..., 2 + k] = np.pad(extreme, [(0, n - m) for n, m in zip(shape, extreme.shape)], mode="edge")
    return bounds


def upload_steps(context: DeviceContext, steps: np.ndarray) -> DeviceArray:
    """The map as kernels read it: 32-bit loads of the last cells stay inside the buffer."""
    return context.upload(np.append(steps.ravel(), np.zeros(4, np.uint8)))


def _within_reach(allowed: np.ndarray, voxels: float) -> np.ndarray:
    """The most steps of which all cells allow as many that a segment may reach. ``voxels``: the most that a step passes
    along any axis."""
    out = np.ones_like(allowed)
    for count in range(2, int(allowed.max()) + 1):
        free = allowed >= count
        for _ in range(int(np.ceil(count * voxels / (1 << CELL_SHIFT)))):
            free = _eroded(free)
        out[free] = count
    return out


def _eroded(free: np.ndarray) -> np.ndarray:
    """Cells of ``free`` all of whose neighbours, diagonal ones too, are in it; beyond the volume all is free."""
    for axis in range(3):
        kept = free.copy()
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        kept[tuple(behind)] &= free[tuple(ahead)]
        kept[tuple(ahead)] &= free[tuple(behind)]
        free = kept
    return free


def sampled_cells(volume: Volume) -> np.ndarray:
    """float64 [n, 4]: curvature, slope, lowest and highest value of some cells, evenly over the volume; found once."""
    if volume not in _samples:
        _samples[volume] = _sampled_cells(volume)
    return _samples[volume]


def known_cells(volume: Volume) -> np.ndarray | None:
    """What ``sampled_cells`` has found of ``volume``; None if it was not called."""
    return _samples.get(volume)


def remember_cells(volume: Volume, cells: np.ndarray) -> None:
    """Takes ``cells`` for those that ``sampled_cells`` finds: another process has."""
    _samples[volume] = cells


def _sampled_cells(volume: Volume) -> np.ndarray:
    """float64 [n, 4]: curvature, slope, lowest and highest value of some cells, evenly over the volume."""
    data, edge = volume.data, (1 << CELL_SHIFT) + 3  # a lattice point more on either side, and the upper face
    starts = [np.unique(np.linspace(0, max(n - edge, 0), _SAMPLED).astype(int)) for n in data.shape]
    index = [np.minimum(start[:, None] + np.arange(edge), n - 1) for start, n in zip(starts, data.shape)]
    places = [np.expand_dims(each, [k for k in range(6) if k not in (a, a + 3)]) for a, each in enumerate(index)]
    # The cells as the last axis: what is looked for in each is then found in many at once.
    boxes = data[tuple(places)].astype(np.float64).reshape(-1, edge**3).T.copy().reshape(edge, edge, edge, -1)
    n = 1 << CELL_SHIFT
    inner = slice(1, n + 1)

    def part(z: int, y: int, x: int) -> np.ndarray:
        shifted = [slice(inner.start + s, inner.stop + s) for s in (z, y, x)]
        return boxes[tuple(shifted)]

    v, vx, vy, vz = part(0, 0, 0), part(0, 0, 1), part(0, 1, 0), part(1, 0, 0)
    second = [vx - 2 * v + part(0, 0, -1), vy - 2 * v + part(0, -1, 0), vz - 2 * v + part(-1, 0, 0)]
    mixed = [part(0, 1, 1) - vx - vy + v, part(1, 1, 0) - vy - vz + v, part(1, 0, 1) - vz - vx + v]

    def most(parts: list[np.ndarray]) -> np.ndarray:
        return np.max([np.abs(part).reshape(n**3, -1).max(axis=0) for part in parts], axis=0)

    whole = boxes[1 : n + 2, 1 : n + 2, 1 : n + 2].reshape((n + 1) ** 3, -1)
    low, high = whole.min(axis=0), whole.max(axis=0)
    return np.stack([most(second) + 2 * most(mixed), most([vx - v, vy - v, vz - v]), low, high], axis=1)
