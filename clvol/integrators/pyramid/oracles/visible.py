"""The oracle of empty space."""

from __future__ import annotations

from typing import Any

import numpy as np

from clvol.device.arguments import view_argument
from clvol.device.voxel_boxes import BOX_ARGUMENTS
from clvol.features import FILTER_REACH, overshoot
from clvol.integrators.pyramid.cells import distance_map, padded_cells
from clvol.integrators.pyramid.oracle import Asked, Oracle
from clvol.opencl.arguments import INT4, reads, value, writes
from clvol.opencl.context import DeviceArray
from clvol.transfer.lookup_nodes import visible_cells


class Visible(Oracle):
    """Distance to the nearest cell in which anything can be visible. Only empty space is not sampled densely, so pictures
    equal those of the oracle "minimum", except close to visible space."""

    name = "visible"
    takes_epsilon = False

    def map(self, asked: Asked) -> DeviceArray:
        shown = padded_cells(asked)
        visible_in_cells(asked, shown)
        return distance_map(asked, shown, [1.0])


def visible_in_cells(asked: Asked, cells: DeviceArray, bit: int = 0) -> None:
    """Sets ``bit`` of the cells (as ``padded_cells``) in which anything can be visible. Bit 0 must be set first: it
    clears all others."""
    context, function, nodes = asked.context, asked.function, asked.nodes.values
    nz, ny, nx = asked.shape
    kernel = context.kernel(
        "oracle_visible.cl",
        "visible_cells",
        (
            *BOX_ARGUMENTS,
            reads("warp", np.float32, 2),
            reads("before", np.int32),
            reads("at", np.uint8),
            view_argument(asked.switches["VOXEL_BITS"]),
            value("shift", np.int32),
            value("apron", np.int32),
            value("overshoot", np.float32),
            value("cells", INT4),
            value("stride", np.int32),
            value("bit", np.int32),
            writes("visible", np.uint8, "cells.z", "cells.y", "stride"),
        ),
        {**asked.switches, "LANES": 1},
    )
    before = np.concatenate([[0], np.cumsum(visible_cells(function, nodes))])
    arrays: dict[str, Any] = {
        "warp": asked.warp,
        "before": context.upload(before.astype(np.int32)),
        "at": context.upload((function.opacity(nodes) > 0).astype(np.uint8)),
        "view": context.upload(asked.view),
        "visible": cells,
    }
    apron, edge = FILTER_REACH[asked.filter], 1 << asked.shift
    for box in asked.volume.boxes((apron + 1, apron + 1)):
        own = zip(box.place.begin, box.place.end, (ny, nz))
        launch = tuple(min(-(-end // edge), count) - begin // edge for begin, end, count in own)
        if min(launch) == 0:  # a last box of a single plane has no cells of its own
            continue
        kernel(
            context.queue,
            launch,
            None,
            shift=asked.shift,
            apron=apron,
            overshoot=overshoot(asked.filter),
            cells=(nx, ny, nz, 0),
            stride=cells.shape[2],
            bit=bit,
            **arrays,
            **box.arguments,
        )
