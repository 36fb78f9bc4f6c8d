"""Classification tables, built on the device by cl/preintegrate.cl."""

from __future__ import annotations

import numpy as np

from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.transfer.function import TransferFunction

# Slice 0: premultiplied colour and opacity of whole segments. Slices 1, 2, 3: mean colour and optical
# depth of segments of length h, h/2, h/4, for the last, shorter piece of each ray.
SLICES = 4
SHORT_SLICES = 2  # SHORT_SLICES of cl/composite_lengths.h
_ARGUMENTS = "in control {real}, in nodes {real}, in pieces int32, in units {real}, value n int32"
_LARGEST_COMPOSED = 512  # nodes; beyond it the intermediate cells would take more memory than is right


def preintegrated_table(
    context: DeviceContext,
    function: TransferFunction,
    nodes: np.ndarray,
    length: float,
    slices: int = SLICES,
) -> DeviceArray:
    """float32 [slices, n + 2, n + 2, 4] for segments of world ``length`` (P4 sec. 8) and shorter."""
    n = nodes.size
    lengths = length / 2.0 ** np.maximum(np.arange(slices) - 1, 0)
    table = context.empty(np.float32, (slices, n + 2, n + 2, 4))
    size = (n + 2, n + 2, slices)
    steps = np.diff(nodes)
    even = steps.max() <= steps.min() * (1 + 1e-9)
    if even and n <= _LARGEST_COMPOSED:
        cells = context.empty(_real(context), (slices - 1, n - 1, n - 1, 8))
        spans = (n - 1, n - 1, slices - 1)
        _build(context, "cell_segments", function, nodes, lengths[1:], spans, cells=cells)
        _build(context, "compose_table", function, nodes, lengths, size, cells=cells, table=table)
    else:
        _build(context, "preintegrate_table", function, nodes, lengths, size, table=table)
    return table


def depths_table(
    context: DeviceContext, function: TransferFunction, nodes: np.ndarray, length: float
) -> DeviceArray:
    """float32 [n + 2, n + 2, 4]: (mean colour times optical depth, optical depth) of segments of world
    ``length``, which both scale with the length of shorter ones (the colour nearly)."""
    table = context.read(preintegrated_table(context, function, nodes, length, slices=2))[1]
    table[..., :3] *= table[..., 3:]
    return context.upload(table)


def length_slices(doublings: int, by_chords: bool) -> int:
    """Slices that ``length_tables`` has."""
    return 2 * doublings + 2 + SHORT_SLICES if by_chords else doublings + 2


def length_tables(
    context: DeviceContext,
    function: TransferFunction,
    nodes: np.ndarray,
    length: float,
    doublings: int,
    by_chords: bool,
) -> DeviceArray:
    """For segments of any lengths (cl/composite_lengths.h), ``length`` the world length of a step.

    ``by_chords``: float32 [slices, n + 2, n + 2, 4], by the values at both ends: premultiplied colours of
    segments of 1, 2, ..., 2^doublings steps; then (mean colour times optical depth, optical depth), which
    both scale with the length, of the same lengths, the longest first, of a half and of a quarter of
    a step. Else float32 [slices, n + 2, 4], by one value: premultiplied colours likewise, then
    (emission, extinction) over one step.
    """
    arguments = context, function, nodes
    if not by_chords:
        colors = [
            context.read(constant_table(*arguments, length * 2.0**k))[0] for k in range(doublings + 1)
        ]
        point = context.read(constant_table(*arguments, length, "extinction_table"))
        return context.upload(np.stack([*colors, point]))
    longest, count = length * 2.0**doublings, doublings + 1 + SHORT_SLICES
    table = context.read(preintegrated_table(*arguments, longest, count + 1))[1:]
    colors = table[doublings::-1].copy()
    colors[..., 3] = -np.expm1(-colors[..., 3])
    colors[..., :3] *= colors[..., 3:]
    table[..., :3] *= table[..., 3:]
    return context.upload(np.concatenate([colors, table]))


def constant_table(
    context: DeviceContext,
    function: TransferFunction,
    nodes: np.ndarray,
    length: float,
    kernel: str = "classify_table",
) -> DeviceArray:
    """For segments of constant value and world ``length``: "classify_table" gives float32 [2, n + 2, 4],
    premultiplied colours, then mean colours and optical depths; "extinction_table" float32
    [n + 2, 4], emission and extinction, both times ``length``."""
    slices = 2 if kernel == "classify_table" else 1
    table = context.empty(np.float32, (slices, nodes.size + 2, 4)[2 - slices :])
    lengths = np.full(slices, length)
    _build(context, kernel, function, nodes, lengths, (nodes.size + 2, slices), table=table)
    return table


def _real(context: DeviceContext) -> np.dtype:
    return np.dtype(np.float64 if context.has_double else np.float32)


def _build(
    context: DeviceContext,
    name: str,
    function: TransferFunction,
    nodes: np.ndarray,
    lengths: np.ndarray,
    size: tuple[int, ...],
    **arrays: DeviceArray,
) -> None:
    real = _real(context)
    control = control_points(function, nodes)
    pieces = np.searchsorted(control[:, 0], nodes, side="right") - 1
    # All but the last array are read.
    intents = ["in"] * (len(arrays) - 1) + ["out"]
    declared = _ARGUMENTS + "".join(
        f", {intent} {key} {array.dtype}" for intent, (key, array) in zip(intents, arrays.items())
    )
    kernel = context.kernel(
        "preintegrate.cl", name, declared.format(real=real), {"WITH_DOUBLE": context.has_double}
    )
    kernel(
        context.queue,
        size,
        None,
        control=context.upload(control.astype(real)),
        nodes=context.upload(nodes.astype(real)),
        pieces=context.upload(pieces.astype(np.int32)),
        units=context.upload((lengths / function.opacity_unit).astype(real)),
        n=nodes.size,
        **arrays,
    )


def control_points(function: TransferFunction, nodes: np.ndarray) -> np.ndarray:
    """Rows (value, opacity, 1 - opacity, red, green, blue), with the end points repeated beyond
    the first and last node, so that every node lies between two rows."""
    margin = max(nodes[-1] - nodes[0], 1e-300)
    ends = []
    for k, value in ((0, min(nodes[0], function.values[0]) - margin),
                     (-1, max(nodes[-1], function.values[-1]) + margin)):  # fmt: skip
        ends.append([value, function.opacities[k], 1.0 - function.opacities[k], *function.colors[k]])
    body = np.column_stack(
        [function.values, function.opacities, 1.0 - function.opacities, function.colors]
    )
    return np.vstack([ends[:1], body, ends[1:]])
