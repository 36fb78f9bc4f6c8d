"""Fills in the ``View`` of a frame (cl/view.h): the numbers of its rays, its picture and its volume."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clvol.device.footprint import footprint_of
from clvol.device.levels import SeenLevels
from clvol.device.view import RayFrame
from clvol.errors import RenderError
from clvol.features.kernels import filter_terms
from clvol.transfer.step_opacity import step_opacity

if TYPE_CHECKING:
    from clvol.integrators.raycast.caster import Raycaster

# Of float32.
_LARGEST, _SMALLEST = float(np.finfo(np.float32).max), float(np.finfo(np.float32).smallest_subnormal)
# Members of a ``View`` that values or a unit of length may push beyond float32.
_FINITE = ("step", "stop_opacity", "first_value", "nodes_per_value", "last_node", "warp_bins")
_VECTORS = ("plane_origin", "plane_du", "plane_dv", "ray_forward", "ray_du", "ray_dv")


def frame_view(caster: Raycaster, frame: RayFrame, width: int, height: int) -> np.ndarray:
    """``View`` [1] of a picture of ``width`` by ``height`` pixels with the rays of ``frame``.

    RenderError where camera or units leave the range of float32.
    """
    known = _volume_part(caster)
    deepest = 0.0 if caster.resolved.coherence.mode == "off" else _deepest(caster, frame)
    vectors = frame.origin, frame.du, frame.dv, frame.forward, frame.ray_du, frame.ray_dv
    numbers = [number for vector in vectors for number in vector.tolist()]
    numbers += [*frame.lens, *frame.centre, frame.distance, frame.unit, deepest]
    if not (known.is_finite and frame.unit > _SMALLEST and all(abs(number) <= _LARGEST for number in numbers)):
        where = f"{caster.resolved.origin}: camera"
        raise RenderError(where, "numbers beyond float32", "a camera and units nearer to 1")
    view = known.view.copy()
    view.view(np.float32)[_places(caster.view_dtype)] = numbers
    view["image"], view["tile"] = (width, height), caster.tile
    if isinstance(caster.volume, SeenLevels):
        _set_footprint(view[0], caster, caster.volume, frame)
    return view


def _set_footprint(row: np.void, caster: Raycaster, volume: SeenLevels, frame: RayFrame) -> None:
    """What a pixel covers, and the levels from which it is taken."""
    resolved = caster.resolved
    found = footprint_of(frame, resolved.volume, resolved.integration.level_bias)
    row["footprint"] = (*found.slope, found.constant)
    row["footprints"] = 2.0**volume.first, 2.0**volume.last


@lru_cache
def _places(dtype: np.dtype) -> np.ndarray:
    """Where the numbers of a frame's rays are among the float32 numbers of a ``View``."""
    lengths = {**dict.fromkeys(_VECTORS, 3), "tangent": 2, "centre": 2}
    lengths |= dict.fromkeys(("plane_distance", "edge_length", "deepest"), 1)
    assert dtype.fields is not None
    return np.concatenate([dtype.fields[name][1] // 4 + np.arange(n) for name, n in lengths.items()])


def _deepest(caster: Raycaster, frame: RayFrame) -> float:
    """Edges from the reference plane to the farthest corner of the volume, with a margin."""
    farthest = 0.0
    axes = frame.origin.tolist(), frame.forward.tolist(), caster.resolved.volume.grid.spacing, caster.volume.size
    for origin, forward, spacing, size in zip(*axes):
        to_edges = spacing / frame.unit
        along = to_edges * (to_edges * forward)  # of unit length in edges
        farthest += max(-origin * along, (size - 1 - origin) * along)
    return min(max(1.001 * farthest + 1.0, 0.0), _LARGEST)


def volume_view(caster: Raycaster) -> np.ndarray:
    """``View`` [1] with the members that do not depend on the camera."""
    return _volume_part(caster).view.copy()


class VolumePart(NamedTuple):
    """What ``View`` says of a scene whatever the camera, kept from frame to frame. ``source``: the objects that it was
    made from. ``is_finite``: whether all of it lies within float32."""

    source: tuple[object, ...]
    view: np.ndarray
    is_finite: bool


def _volume_part(caster: Raycaster) -> VolumePart:
    volume = caster.volume
    source = (
        caster.resolved, volume, caster.nodes, caster.gate, caster.spans, caster.step_units, caster.pieces,
        caster.map_cells, caster.map_shift, caster.octant_cells, caster.view_dtype,
        volume.values, volume.size, volume.stride, volume.switches, volume.view_fields,
    )  # fmt: skip
    known = caster.volume_part
    if known is None or any(a is not b for a, b in zip(known.source, source)):
        view = np.zeros(1, caster.view_dtype)
        row = view[0]
        with np.errstate(over="ignore", under="ignore"):
            _describe_volume(caster, row)
        finite = all(np.isfinite(row[name]).all() for name in _FINITE) and row["step"] > 0
        known = caster.volume_part = VolumePart(source, view, bool(finite))
    return known


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
    row["stop_opacity"] = 1.0 - caster.resolved.integration.early_termination
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
    if isinstance(volume, SeenLevels):
        for k, level in enumerate(volume.levels):
            row["level_scales"][k][:3] = [0.5**halvings for halvings in level.halvings]
            row["level_sizes"][k] = (*level.size, level.first)
    row["piece_columns"], row["function_floats"], row["piece_count"] = caster.pieces


def parts_of_cell(step: float) -> int:
    """The number of parts into which quadrature by cells divides the piece of a ray in each cell: about 1 / ``step``,
    one or an even number (Gauss's points come in pairs)."""
    return 1 if step > 0.75 else 2 * max(1, round(0.5 / step))
