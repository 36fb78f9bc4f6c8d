"""Values and gradients at lattice points: by the kernels' functions, and by definition in numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import ndimage

from clvol import Volume
from clvol.device.arguments import view_argument
from clvol.device.gradients import precompute
from clvol.device.volume import DeviceVolume
from clvol.features import FILTERS, GRADIENTS
from clvol.opencl.arguments import FLOAT4, RAW, reads, value, writes
from clvol.opencl.structs import view_dtype

_SOURCE = Path(__file__).with_name("gradient_points.cl")
TYPES = (np.uint8, np.int8, np.uint16, np.int16, np.float32, np.float64)


def rough(shape, dtype=np.uint8, low=0, high=255, seed=6):
    """Noise, which no other reconstruction of the same voxels agrees with."""
    return np.random.default_rng(seed).integers(low, high + 1, shape).astype(dtype)


def lattice_points(shape, count=512, seed=3):
    """float32 [count, 3] (x, y, z): random, on lattice planes, at voxels and at the domain's corners."""
    size = np.maximum(shape[::-1], 2) - 1.0
    rng = np.random.default_rng(seed)
    at = rng.random((count, 3)) * size
    on_plane = rng.random((count, 3)) < np.linspace(0, 1, count)[:, None] ** 3
    at[on_plane] = np.round(at)[on_plane]
    at[:8] = np.stack(np.meshgrid(*([0.0, n] for n in size)), -1).reshape(8, 3)
    return at.astype(np.float32)


def evaluate(context, volume, gradient, at, *, filter="linear", operator="central", lanes=16):
    """The kernels' gradients float64 [n, 3] (value a lattice unit) and values [n] at points ``at``
    [n, 3], and the device volume. ``gradient``: a name in GRADIENTS."""
    volume = volume if isinstance(volume, Volume) else Volume(volume)
    resident = DeviceVolume(context, volume)
    codes, scale = context.upload(np.zeros(1, np.uint32)), np.zeros(4, np.float32)
    if gradient == "precomputed":
        codes, scale = precompute(context, resident, operator)
    bits = resident.switches["VOXEL_BITS"]
    view = np.zeros(1, view_dtype(bits))
    view["size"][0, :3], (view["row_stride"], view["slice_stride"]) = resident.size, resident.stride
    view["upper"][0, :3] = np.asarray(resident.size) - 1
    view["voxel_gain"] = resident.values.gain
    if bits == 64:
        view["voxel_bias_double"], view["voxel_gain_double"] = resident.values.bias, resident.values.gain
    switches = {**resident.switches, "LANES": lanes, "FILTER": FILTERS[filter],
                "GRADIENT": GRADIENTS[gradient]}  # fmt: skip
    kernel = context.kernel(
        str(_SOURCE), "gradient_points",
        (
            reads("volume", RAW), reads("gradients", np.uint32), view_argument(bits), value("scale", FLOAT4),
            reads("at", np.float32, 3, "n"), value("n", np.int32), writes("out", np.float32, 4, "n"),
        ),
        switches,
    )  # fmt: skip
    n = len(at)
    out = context.empty(np.float32, (4, n))
    kernel(context.queue, (n // lanes,), (1,), volume=resident.voxels, gradients=codes,
           view=context.upload(view), scale=scale, at=context.upload(at.T.astype(np.float32)), n=n,
           out=out)  # fmt: skip
    found = context.read(out).astype(np.float64)
    return found[:3].T, found[3], resident


def voxel_gradients(array, operator):
    """float64 [nz, ny, nx, 3]: derivatives along x, y, z at the voxels, by definition."""
    array = np.asarray(array, np.float64)
    parts = []
    for axis in (2, 1, 0):
        part = array
        if array.shape[axis] == 1:
            parts.append(np.zeros(array.shape))
            continue
        if operator == "sobel":
            for other in {0, 1, 2} - {axis}:
                part = ndimage.convolve1d(part, [0.25, 0.5, 0.25], axis=other, mode="nearest")
        parts.append(np.gradient(part, axis=axis, edge_order=1))
    return np.stack(parts, -1)


def at_points(field, at):
    """``field`` [nz, ny, nx, ...] interpolated trilinearly at ``at`` [n, 3] (x, y, z), float64."""
    total = 0.0
    for corner in np.ndindex(2, 2, 2):
        weight, index = 1.0, []
        for axis, bit in zip((2, 1, 0), corner):
            n = field.shape[2 - axis]
            base = np.clip(np.floor(at[:, axis]), 0, max(n - 2, 0)).astype(int)
            f = at[:, axis].astype(np.float64) - base
            weight = weight * (f if bit else 1 - f)
            index.append(np.minimum(base + bit, n - 1))
        total = total + weight.reshape(-1, *[1] * (field.ndim - 3)) * field[tuple(index)]
    return total


def b_spline(d):
    d = np.abs(d)
    return np.where(d < 1, 2 / 3 - d**2 + d**3 / 2, np.clip(2 - d, 0, None) ** 3 / 6)


def catmull_rom(d):
    """The kernel of Keys 1981 with a = -1/2."""
    d = np.abs(d)
    outer = np.where(d < 2, 2 - 4 * d + 2.5 * d**2 - 0.5 * d**3, 0.0)
    return np.where(d < 1, 1 - 2.5 * d**2 + 1.5 * d**3, outer)


SPLINES = {"cubic": b_spline, "catmull-rom": catmull_rom}


def spline_at(array, at, filter):
    """The field of a filter of 64 voxels at ``at`` [n, 3] float64, the outermost voxels held beyond."""
    field = np.asarray(array, np.float64)
    weights = []
    for axis, n in zip((0, 1, 2), field.shape[::-1]):
        cell = np.clip(np.floor(at[:, axis]), 0, max(n - 2, 0)).astype(int)
        taps = cell[:, None] + np.arange(-2, 4)
        weights.append((np.clip(taps, 0, n - 1), SPLINES[filter](at[:, axis, None] - taps)))
    (ix, wx), (iy, wy), (iz, wz) = weights
    voxels = field[iz[:, :, None, None], iy[:, None, :, None], ix[:, None, None, :]]
    return np.einsum("nkji,nk,nj,ni->n", voxels, wz, wy, wx)
