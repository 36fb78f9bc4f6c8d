"""Maps of distances for oracles, found on the device (cl/oracle_cells.cl).

A distance d is right at a place where everything nearer than d can do with samples d apart. So with the set of cells that
are bad for samples h apart, for each h of a row of scales, the distance is the largest of min(h, way to that set). It grows by no more
than the way from one place to another, which the march relies on (cl/pyramid.h, freshness).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.render.pyramid.oracles.base import Asked

BINS = 2048  # of values, for what an error of a value shows
_WIDEST = 0.05  # of the value range: bins go on beyond it by so much, for interpolated values
_SPARE = 4  # bytes: a 32-bit gather of the last byte must stay inside


@dataclass(frozen=True, eq=False)
class CellStatistics:
    """``values`` float32 [scales + 2, z, y, x] on the device: lowest and highest value of each cell, then by scale the
    largest deviation of a value from one that is interpolated between samples so far apart.
    ``scales`` [n]: in smallest edges."""

    values: DeviceArray
    scales: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        return self.values.shape[1:]


def cell_statistics(asked: Asked) -> CellStatistics:
    """Of all cells of ``asked``'s map."""
    context, volume, scales = asked.context, asked.volume, asked.scales
    # Along an axis with longer edges half a scale may be less than a lattice unit.
    halves = scales[:, None] / 2.0 / np.asarray(asked.edges)
    whole = np.maximum(np.rint(halves), 1).astype(np.int32)
    shares = np.minimum(halves / whole, 1.0).astype(np.float32)
    shape = asked.shape
    out = context.empty(np.float32, (len(scales) + 2, *shape))
    size = (*volume.size, 0)
    kernel = _kernel(
        asked, "cell_statistics",
        "in volume V1, value size int4, value shift int32, in halves int32, in shares float32, "
        f"{_MAPPED}, out statistics float32", len(scales),
    )  # fmt: skip
    kernel(
        context.queue, shape[::-1], None, volume=volume.plain(), size=size, shift=asked.shift,
        halves=context.upload(_fours(whole)), shares=context.upload(_fours(shares)),
        statistics=out, **_mapped(asked),
    )  # fmt: skip
    return CellStatistics(out, scales)


def bad_for_error(asked: Asked) -> DeviceArray:
    """uint8 [z, y, x]: bit s is set where samples ``scales[s]`` apart may show more than epsilon that is wrong."""
    found, context = asked.statistics, asked.context
    low, high = asked.volume.value_range
    margin = _WIDEST * (high - low) or 1.0
    first, last = low - margin, high + margin
    shown = np.stack([segment_colors(asked, first, last, scale) for scale in found.scales])
    slopes = np.abs(np.diff(shown, axis=1))
    tops = np.maximum(shown[:, 1:], shown[:, :-1])
    bottoms = np.minimum(shown[:, 1:], shown[:, :-1])
    out = context.empty(np.uint8, found.shape)
    tables = [context.upload(_sparse(table)) for table in (slopes, tops, -bottoms)]
    rows, n = tables[0].shape[1:3]
    kernel = _kernel(
        asked, "bad_scales",
        "in statistics float32, in slopes float32, in tops float32, in minus_bottoms float32, "
        "value n int32, value rows int32, value first float32, value per_value float32, "
        "value epsilon float32, out bad uint8", len(found.scales),
    )  # fmt: skip
    kernel(
        context.queue, (int(np.prod(found.shape)),), None, statistics=found.values,
        slopes=tables[0], tops=tables[1], minus_bottoms=tables[2], n=n, rows=rows, first=first,
        per_value=n / (last - first), epsilon=asked.epsilon, bad=out,
    )  # fmt: skip
    return out


def segment_colors(asked: Asked, first: float, last: float, edges: float) -> np.ndarray:
    """float32 [BINS + 1, 4]: premultiplied colour and opacity of a segment of one value, ``edges`` long, at the ends of
    even bins from ``first`` to ``last``."""
    values = np.linspace(first, last, BINS + 1)
    function = asked.function
    with np.errstate(divide="ignore", over="ignore"):
        depth = -np.log1p(-function.opacity(values)) * (edges * asked.opacity_edges)
    opacity = -np.expm1(-depth)
    return np.column_stack([function.color(values) * opacity[:, None], opacity]).astype(np.float32)


def bad_opacity_gradients(asked: Asked) -> DeviceArray:
    """uint8 [z, y, x]: 1 where the opacity (of a smallest edge) changes by more than epsilon over a smallest edge."""
    context, volume = asked.context, asked.volume
    low, high = volume.value_range
    last = high if high > low else low + 1.0
    opacity = segment_colors(asked, low, last, 1.0)[:, 3]
    out = context.empty(np.uint8, asked.shape)
    kernel = _kernel(
        asked, "steep_opacity",
        f"in volume V1, value size int4, value shift int32, {_MAPPED}, in opacity float32, value n int32, "
        "value first float32, value per_value float32, value edges float4, "
        "value threshold float32, out bad uint8",
    )  # fmt: skip
    kernel(
        context.queue, asked.shape[::-1], None, volume=volume.plain(), size=(*volume.size, 0),
        shift=asked.shift, opacity=context.upload(opacity), n=BINS + 1, first=low,
        per_value=BINS / (last - low), edges=(*asked.edges, 1.0), threshold=asked.epsilon, bad=out,
        **_mapped(asked),
    )  # fmt: skip
    return out


def distances_to_bad(asked: Asked, bad: DeviceArray, bits: int, most: float) -> DeviceArray:
    """float32 [z, y, x]: the way, in smallest edges, from each cell to the nearest one of ``bad`` with one of ``bits``; larger than
    ``most`` where there is none so near."""
    context, shape = asked.context, bad.shape
    near, spare = (context.empty(np.float32, shape) for _ in range(2))
    count = (int(np.prod(shape)),)
    start = _kernel(asked, "start_near", "in bad uint8, value bits uint32, out out float32")
    start(context.queue, count, None, bad=bad, bits=bits, out=near)
    kernel = _kernel(
        asked, "near_pass",
        "in source float32, out target float32, value cells int4, value axis int32, value window int32, value cell float32",
    )  # fmt: skip
    for axis, edge in enumerate(asked.edges):
        cell = edge * (1 << asked.shift)
        window = int(np.ceil(most / cell)) + 1
        kernel(
            context.queue, shape[::-1], None, source=near, target=spare,
            cells=(*shape[::-1], 0), axis=axis, window=window, cell=cell,
        )  # fmt: skip
        near, spare = spare, near
    return near


def distances_by_scale(asked: Asked, bad: DeviceArray, scales: np.ndarray) -> DeviceArray:
    """float32 [z, y, x]: at each cell the largest of min(scale, way to the cells whose bit says that they are bad for it)."""
    context, shape = asked.context, bad.shape
    distances = context.upload(np.zeros(shape, np.float32))
    widen = _kernel(
        asked, "widen_distance", "in squares float32, value most float32, out distances float32"
    )
    for bit, scale in enumerate(scales):
        squares = distances_to_bad(asked, bad, 1 << bit, float(scale))
        widen(
            context.queue, (int(np.prod(shape)),), None, squares=squares, most=scale,
            distances=distances,
        )  # fmt: skip
    return distances


def distance_map(asked: Asked, distances: DeviceArray) -> DeviceArray:
    """The map as kernels read it (cl/oracle_map.h), uint8 [cells + a few]."""
    context, count = asked.context, int(np.prod(distances.shape))
    out = context.empty(np.uint8, (count + _SPARE,))
    kernel = _kernel(asked, "distance_bytes", "in distances float32, out bytes uint8")
    kernel(context.queue, (count,), None, distances=distances, bytes=out)
    return out


def upload_distances(context: DeviceContext, distances: np.ndarray) -> DeviceArray:
    """The same from an array on the host, float [z, y, x]."""
    codes = np.append(distance_codes(distances).ravel(), np.zeros(_SPARE, np.uint8))
    return context.upload(codes)


def distance_codes(distances: np.ndarray) -> np.ndarray:
    """uint8: distances in edges (0 or more) as bytes, rounded down to four binary digits."""
    words = np.maximum(np.asarray(distances, np.float32), 0).view(np.int32) >> 19
    return np.clip(words - ((127 - 4) << 4), 0, 255).astype(np.uint8)


def decoded_distances(codes: np.ndarray) -> np.ndarray:
    """float64: what bytes stand for (cl/oracle_map.h)."""
    words = (np.asarray(codes, np.int32) + ((127 - 4) << 4)) << 19
    return np.where(codes == 0, 0.0, words.view(np.float32).astype(np.float64))


_MAPPED = "value bias {real}, value gain {real}"


def _mapped(asked: Asked) -> dict[str, float]:
    values = asked.volume.values
    return {"bias": values.bias, "gain": values.gain}


def _kernel(asked: Asked, name: str, declared: str, scales: int = 1):
    switches = {
        key: asked.volume.switches[key] for key in ("VOXEL_BITS", "VOXEL_SIGNED", "VOXEL_SCALED")
    }
    real = "float64" if switches["VOXEL_BITS"] == 64 else "float32"
    declared = declared.replace("{real}", real)
    return asked.context.kernel("oracle_cells.cl", name, declared, {**switches, "SCALES": scales})


def _fours(rows: np.ndarray) -> np.ndarray:
    """[n, 3] as [n, 4]."""
    return np.pad(rows, ((0, 0), (0, 1)))


def _sparse(table: np.ndarray) -> np.ndarray:
    """[..., rows, n, 4] of ``table`` [s, n, 4]: in row k the largest of 2^k entries from each on, which must all be there."""
    rows = [table]
    while 2 ** len(rows) <= table.shape[1]:
        half = 2 ** (len(rows) - 1)
        last = rows[-1]
        rows.append(np.concatenate([np.maximum(last[:, :-half], last[:, half:]), last[:, -half:]], axis=1))
    return np.ascontiguousarray(np.stack(rows, axis=1))
