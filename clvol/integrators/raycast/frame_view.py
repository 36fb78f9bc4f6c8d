"""Fills in the ``View`` of a frame (cl/view.h): the numbers of its rays, its picture and its volume."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clvol.device.view import RayFrame
from clvol.errors import RenderError
from clvol.features.kernels import filter_terms
from clvol.transfer.step_opacity import step_opacity

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster

_VECTORS = ("plane_origin", "plane_du", "plane_dv", "ray_forward", "ray_du", "ray_dv")
# Members of a ``View``, beside its vectors, that a camera or a unit of length may push beyond float32.
_FINITE = (
    "tangent", "centre", "step", "plane_distance", "stop_opacity", "edge_length",
    "first_value", "nodes_per_value", "last_node", "warp_bins",
)  # fmt: skip


def frame_view(caster: Raycaster, frame: RayFrame, width: int, height: int) -> np.ndarray:
    """``View`` [1] of a picture of ``width`` by ``height`` pixels with the rays of ``frame``.

    RenderError where camera or units leave the range of float32.
    """
    row = (view := np.zeros(1, caster.view_dtype))[0]
    sources = (frame.origin, frame.du, frame.dv, frame.forward, frame.ray_du, frame.ray_dv)
    with np.errstate(over="ignore", under="ignore"):
        for name, source in zip(_VECTORS, sources):
            row[name][:3] = source
        row["tangent"], row["centre"] = frame.lens, frame.centre
        _describe_volume(caster, row)
        row["plane_distance"], row["edge_length"] = frame.distance, frame.unit
        row["deepest"] = 0.0 if caster.resolved.coherence.mode == "off" else _deepest(caster, frame)
        row["stop_opacity"] = 1.0 - caster.resolved.integration.early_termination
    finite = [np.isfinite(row[name]).all() for name in (*_VECTORS, *_FINITE)]
    if not all(finite) or not min(row["step"], row["edge_length"]) > 0:
        where = f"{caster.resolved.origin}: camera"
        raise RenderError(where, "numbers beyond float32", "a camera and units nearer to 1")
    row["image"], row["tile"] = (width, height), caster.tile
    return view


def _deepest(caster: Raycaster, frame: RayFrame) -> float:
    """Edges from the reference plane to the farthest corner of the volume, with a margin."""
    to_edges = np.asarray(caster.resolved.volume.grid.spacing) / frame.unit
    along = to_edges * (to_edges * frame.forward)  # of unit length in edges
    corners = np.stack([-frame.origin, np.asarray(caster.volume.size) - 1 - frame.origin])
    farthest = float((corners * along).max(axis=0).sum())
    return max(1.001 * farthest + 1.0, 0.0)


def volume_view(caster: Raycaster) -> np.ndarray:
    """``View`` [1] with the members that do not depend on the camera."""
    view = np.zeros(1, caster.view_dtype)
    _describe_volume(caster, view[0])
    return view


def _describe_volume(caster: Raycaster, row: np.void) -> None:
    """Fills in the members of a ``View`` that do not depend on the camera."""
    volume, nodes, step = caster.volume, caster.nodes, caster.resolved.integration.step
    bins = 0.0 if nodes.warp is None else nodes.warp.size - 1.0
    row["step"] = step
    row["first_value"], row["nodes_per_value"] = nodes.first, nodes.per_value
    row["last_node"], row["warp_bins"] = nodes.last_coordinate, bins
    row["upper"][:3] = np.asarray(volume.size) - 1
    row["gate_low"], row["gate_high"] = caster.gate
    row["shows_above"], row["shows_below"] = caster.spans
    row["step_units"] = caster.step_units
    terms, row["opacity_limit"] = step_opacity(float(row["step_units"]))
    row["opacity_terms"], row["opacity_more"] = terms[:4], terms[4:]
    weights = filter_terms(caster.resolved.integration)
    if weights is not None:
        row["filter_terms"] = weights.reshape(-1, 4)
    row["cell_parts"] = parts_of_cell(step)
    row["ray_tolerance"] = caster.resolved.image.ray_tolerance
    if volume.switches["VOXEL_BITS"] == 64:
        row["voxel_bias_double"], row["voxel_gain_double"] = volume.values.bias, volume.values.gain
    else:
        row["voxel_gain"] = volume.values.gain
    row["size"][:3] = volume.size
    row["row_stride"], row["slice_stride"] = volume.stride
    for name, numbers in volume.view_fields.items():
        row[name][:3] = numbers
    row["cells"][:3], row["cell_shift"] = caster.map_cells, caster.map_shift
    row["octant_cells"] = caster.octant_cells
    row["piece_columns"], row["function_floats"], row["piece_count"] = caster.pieces


def parts_of_cell(step: float) -> int:
    """The number of parts into which quadrature by cells divides the piece of a ray in each cell: about 1 / ``step``,
    one or an even number (Gauss's points come in pairs)."""
    return 1 if step > 0.75 else 2 * max(1, round(0.5 / step))
