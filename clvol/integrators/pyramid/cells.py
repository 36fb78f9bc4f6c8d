"""Maps of distances for oracles, found on the device (cl/oracle_cells.cl).

For each h of a series of scales (1, 2, 4 ... edges) there is a set of cells that are bad for samples h apart. The distance
at a position is the minimum over h of h / 2 + the way to that set: h / 2 inside the set, which is fine enough, and more
farther away. So from one position to another it grows by at most the way between them, which the march relies on
(cl/pyramid.h, freshness).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from clvol.device.voxel_boxes import BOX_ARGUMENTS
from clvol.integrators.pyramid.layout import BRICK, MAP_SPARE, map_bytes, padded_row
from clvol.opencl.arguments import FLOAT4, INT4, Argument, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext

if TYPE_CHECKING:
    from clvol.integrators.pyramid.oracle import Asked

BINS = 2048  # bins of values in the tables of colours
_WIDEST = 0.05  # share of the value range by which bins extend beyond it, for interpolated values
_FAR = 65535
_VOXELS = ("size.z", "size.y", "size.x")  # shapes of arrays, by arguments of the kernels
_CELLS = ("cells.z", "cells.y", "stride")


def voxels_bad_for_error(asked: Asked) -> DeviceArray:
    """uint8 [z, y, x] per voxel: bit s is set where samples ``asked.scales[s]`` apart may cause an error above epsilon."""
    context, volume, scales = asked.context, asked.volume, asked.scales
    # Along an axis with longer edges half a scale may be less than a lattice unit.
    halves = scales[:, None] / 2.0 / np.asarray(asked.edges)
    whole = np.maximum(np.rint(halves), 1).astype(np.int32)
    shares = np.minimum(halves / whole, 1.0).astype(np.float32)
    low, high = volume.value_range
    margin = _WIDEST * (high - low) or 1.0
    first, last = low - margin, high + margin
    shown = np.stack([segment_colors(asked, first, last, scale) for scale in scales])
    slopes = np.abs(np.diff(shown, axis=1))
    tops = np.maximum(shown[:, 1:], shown[:, :-1])
    bottoms = np.minimum(shown[:, 1:], shown[:, :-1])
    tables = [context.upload(_sparse(table)) for table in (slopes, tops, -bottoms)]
    rows, n = tables[0].shape[1:3]
    nx, ny, nz = volume.size
    out = context.empty(np.uint8, (nz, ny, nx))
    kernel = _kernel(
        asked, "bad_voxels",
        *BOX_ARGUMENTS, value("size", INT4), reads("halves", np.int32, len(scales), 4),
        reads("shares", np.float32, len(scales), 4), *_mapped_arguments(asked), *_tables(len(scales)),
        reads("steepest", np.float32, len(scales)), value("n", np.int32), value("rows", np.int32),
        value("first", np.float32), value("per_value", np.float32), value("epsilon", np.float32),
        writes("bad", np.uint8, *_VOXELS), scales=len(scales),
    )  # fmt: skip
    arrays = {
        "halves": context.upload(_fours(whole)), "shares": context.upload(_fours(shares)),
        "slopes": tables[0], "tops": tables[1], "minus_bottoms": tables[2],
        "steepest": context.upload(slopes.max(axis=(1, 2))), "bad": out,
    }  # fmt: skip
    for box in volume.boxes((int(whole[:, 1].max()), int(whole[:, 2].max()))):
        kernel(
            context.queue, box.launch, None, size=(*volume.size, 0), n=n, rows=rows, first=first,
            per_value=n / (last - first), epsilon=asked.epsilon, **arrays, **box.arguments, **_mapped(asked),
        )  # fmt: skip
    return out


def segment_colors(asked: Asked, first: float, last: float, edges: float) -> np.ndarray:
    """float32 [BINS + 1, 4]: premultiplied colour and opacity of segments of one value, ``edges`` long, for the ends of
    even bins from ``first`` to ``last``."""
    values = np.linspace(first, last, BINS + 1)
    function = asked.function
    with np.errstate(divide="ignore", over="ignore"):
        depth = -np.log1p(-function.opacity(values)) * (edges * asked.opacity_edges)
    opacity = -np.expm1(-depth)
    return np.column_stack([function.color(values) * opacity[:, None], opacity]).astype(np.float32)


def voxels_of_steep_opacity(asked: Asked) -> DeviceArray:
    """uint8 [z, y, x] per voxel: 1 where the opacity of a path one smallest edge long changes by more than epsilon per
    smallest edge."""
    context, volume = asked.context, asked.volume
    low, high = volume.value_range
    last = high if high > low else low + 1.0
    opacity = segment_colors(asked, low, last, 1.0)[:, 3]
    nx, ny, nz = volume.size
    out = context.empty(np.uint8, (nz, ny, nx))
    kernel = _kernel(
        asked, "steep_voxels",
        *BOX_ARGUMENTS, value("size", INT4), *_mapped_arguments(asked), reads("opacity", np.float32, "n"),
        value("n", np.int32), value("first", np.float32), value("per_value", np.float32), value("edges", FLOAT4),
        value("threshold", np.float32), writes("bad", np.uint8, *_VOXELS),
    )  # fmt: skip
    on_device = context.upload(opacity)
    for box in volume.boxes((1, 1)):
        kernel(
            context.queue, box.launch, None, size=(*volume.size, 0), opacity=on_device, n=BINS + 1, first=low,
            per_value=BINS / (last - low), edges=(*asked.edges, 1.0), threshold=asked.epsilon, bad=out,
            **box.arguments, **_mapped(asked),
        )  # fmt: skip
    return out


def cells_of_voxels(asked: Asked, voxels: DeviceArray) -> DeviceArray:
    """The bits of the cells [z, y, x] of ``asked``'s map, whose rows are padded: a cell has the bits of all voxels at its
    corners or inside."""
    context, (nz, ny, nx) = asked.context, asked.shape
    out = padded_cells(asked)
    kernel = _kernel(
        asked, "bad_cells",
        reads("voxels", np.uint8, *_VOXELS), value("size", INT4), value("shift", np.int32), value("cells", INT4),
        value("stride", np.int32), writes("bad", np.uint8, *_CELLS),
    )  # fmt: skip
    kernel(
        context.queue, (ny, nz), None, voxels=voxels, size=(*asked.volume.size, 0),
        shift=asked.shift, cells=(nx, ny, nz, 0), stride=out.shape[2], bad=out,
    )  # fmt: skip
    return out


def padded_cells(asked: Asked) -> DeviceArray:
    """uint8 [z, y, x] for the cells of ``asked``'s map, with padded rows; uninitialised."""
    nz, ny, nx = asked.shape
    return asked.context.empty(np.uint8, (nz, ny, padded_row(nx)))


def upload_cells(asked: Asked, bad: np.ndarray) -> DeviceArray:
    """As ``padded_cells``, filled with bits [z, y, x] from the host."""
    nx = bad.shape[2]
    return asked.context.upload(np.pad(bad, ((0, 0), (0, 0), (0, padded_row(nx) - nx))))


def distance_map(asked: Asked, bad: DeviceArray, scales: Iterable[float]) -> DeviceArray:
    """uint8 in the layout of cl/oracle_layout.h: at each cell the minimum over ``scales`` of scale / 2 + the way to
    the cells that have the scale's bit in ``bad``, at most ``asked.reach``."""
    found = _map_of(asked, asked.reach)
    for bit, scale in enumerate(scales):
        _move_distances(asked, bad, bit, found, scale / 2.0, asked.reach, raises=False)
    return found


def raise_to_ways(asked: Asked, bad: DeviceArray, bit: int, found: DeviceArray) -> None:
    """Raises distances of the map ``found`` to at least 1 / 2 + the way to the cells that have the bit."""
    _move_distances(asked, bad, bit, found, 0.5, asked.reach, raises=True)


def way_map(asked: Asked, bad: DeviceArray, reach: float, unit: float) -> DeviceArray:
    """As ``distance_map``, but only the ways to the cells whose bit 0 is set."""
    found = _map_of(asked, 0.0)
    _move_distances(asked, bad, 0, found, 0.0, reach, raises=True, unit=unit)
    return found


def _map_of(asked: Asked, distance: float) -> DeviceArray:
    code = distance_codes(np.array(distance))
    codes = np.full(map_bytes(asked.shape), code, np.uint8)
    return asked.context.upload(codes, writable=True)


def _move_distances(
    asked: Asked,
    bad: DeviceArray,
    bit: int,
    found: DeviceArray,
    base: float,
    most: float,
    *,
    raises: bool,
    unit: float = 0.25,
) -> None:
    """Raises or lowers the map ``found`` to ``base`` + the way to the cells with the bit, at most ``most``, which is less than
    256 units: squares of ways are counted in squares of ``unit``, up to 2^16."""
    context, (nz, ny, nx) = asked.context, asked.shape
    cells, stride = (nx, ny, nz, 0), bad.shape[2]
    near, spare = (context.empty(np.uint16, bad.shape) for _ in range(2))
    start = _kernel(
        asked, "start_near", reads("bad", np.uint8), value("bits", np.uint32),
        value("stride", np.int32), writes("near", np.uint16),
    )  # fmt: skip
    step = _kernel(
        asked, "near_pass",
        reads("source", np.uint16, *_CELLS), writes("target", np.uint16, *_CELLS), value("cells", INT4),
        value("stride", np.int32), value("axis", np.int32), value("window", np.int32), reads("gaps", np.uint16, "window"),
    )  # fmt: skip
    move = _kernel(
        asked, "move_distances",
        reads("near", np.uint16, *_CELLS), value("cells", INT4), value("stride", np.int32), value("base", np.float32),
        value("most", np.float32), value("unit", np.float32), value("raises", np.int32), writes("map", np.uint8),
    )  # fmt: skip
    start(context.queue, (ny * nz,), None, bad=bad, bits=1 << bit, stride=stride, near=near)
    for axis, edge in enumerate(asked.edges):
        gaps = squared_gaps(edge * (1 << asked.shift), most - base, unit)
        step(
            context.queue, (ny, nz), None, source=near, target=spare, cells=cells,
            stride=stride, axis=axis, window=len(gaps) - 1, gaps=context.upload(gaps),
        )  # fmt: skip
        near, spare = spare, near
    move(
        context.queue, (ny, nz), None, near=near, cells=cells, stride=stride, base=base, most=most,
        unit=unit, raises=int(raises), map=found,
    )  # fmt: skip


def squared_gaps(cell: float, most: float, unit: float) -> np.ndarray:
    """uint16: squares of the gaps between cells that are 0, 1, 2 ... apart, each ``cell`` edges long, in squares of ``unit``,
    rounded down, for gaps below ``most``."""
    count = int(np.ceil(most / cell)) + 2
    gaps = np.maximum(np.arange(count) - 1, 0) * cell
    return np.minimum(np.floor((gaps / unit) ** 2), _FAR).astype(np.uint16)


def upload_distances(context: DeviceContext, distances: np.ndarray) -> DeviceArray:
    """A map from distances on the host, float [z, y, x], in smallest edges."""
    shape = distances.shape
    codes = np.pad(distance_codes(distances), [(0, -n % BRICK) for n in shape])
    bricks = codes.reshape(_in_bricks(shape)).transpose(0, 2, 4, 1, 3, 5)
    return context.upload(np.append(bricks.ravel(), np.zeros(MAP_SPARE, np.uint8)))


def read_distances(context: DeviceContext, found: DeviceArray, shape: tuple[int, int, int]) -> np.ndarray:
    """float64 [z, y, x]: the distances, in smallest edges, of a map of ``shape`` cells."""
    nz, ny, nx = shape
    bricks = context.read(found)[:-MAP_SPARE].reshape(np.take(_in_bricks(shape), (0, 2, 4, 1, 3, 5)))
    codes = bricks.transpose(0, 3, 1, 4, 2, 5).reshape([n + -n % BRICK for n in shape])
    return decoded_distances(codes[:nz, :ny, :nx])


def _in_bricks(shape: tuple[int, int, int]) -> list[int]:
    return [n for cells in shape for n in (-(-cells // BRICK), BRICK)]


def distance_codes(distances: np.ndarray) -> np.ndarray:
    """uint8: distances in edges (0 or more) as bytes, rounded down to four binary digits."""
    words = np.maximum(np.asarray(distances, np.float32), 0).view(np.int32) >> 19
    return np.clip(words - ((127 - 4) << 4), 0, 255).astype(np.uint8)


def decoded_distances(codes: np.ndarray) -> np.ndarray:
    """float64: the distances that bytes stand for (cl/oracle.h)."""
    words = (np.asarray(codes, np.int32) + ((127 - 4) << 4)) << 19
    return np.where(codes == 0, 0.0, words.view(np.float32).astype(np.float64))


def _tables(scales: int) -> tuple[Argument, ...]:
    return tuple(reads(name, np.float32, scales, "rows", "n", 4) for name in ("slopes", "tops", "minus_bottoms"))


def _mapped_arguments(asked: Asked) -> tuple[Argument, ...]:
    """MAP_PARAMETERS of cl/oracle_cells.cl."""
    real = np.float64 if asked.volume.switches["VOXEL_BITS"] == 64 else np.float32
    return value("bias", real), value("gain", real)


def _mapped(asked: Asked) -> dict[str, float]:
    values = asked.volume.values
    return {"bias": values.bias, "gain": values.gain}


def _kernel(asked: Asked, name: str, *arguments: Argument, scales: int = 1):
    switches = {
        key: asked.volume.switches[key] for key in ("VOXEL_BITS", "VOXEL_SIGNED", "VOXEL_SCALED")
    }
    return asked.context.kernel("oracle_cells.cl", name, arguments, {**switches, "SCALES": scales})


def _fours(rows: np.ndarray) -> np.ndarray:
    """[n, 3] as [n, 4]."""
    return np.pad(rows, ((0, 0), (0, 1)))


def _sparse(table: np.ndarray) -> np.ndarray:
    """[..., rows, n, 4] from ``table`` [s, n, 4]: entry i of row k is the maximum of the 2^k entries from i on, which must
    all exist."""
    rows = [table]
    while 2 ** len(rows) <= table.shape[1]:
        half = 2 ** (len(rows) - 1)
        last = rows[-1]
        rows.append(np.concatenate([np.maximum(last[:, :-half], last[:, half:]), last[:, -half:]], axis=1))
    return np.ascontiguousarray(np.stack(rows, axis=1))
