"""Warnings of settings that are probably mistakes, with the reason and what to set. No picture depends on them.

Each check is a proof: it warns only if the numbers of the scene leave no doubt. Warnings that need the picture are in
clvol/render/picture_warnings.py.
"""

from __future__ import annotations

import math

import numpy as np

from clvol.errors import ClvolWarning
from clvol.features.findings import Findings
from clvol.features.geometry import box_apart, mesh_holds, nearest_distance
from clvol.features.values import reachable
from clvol.scene.camera import Camera
from clvol.scene.clip import Clip, MeshClip
from clvol.scene.resolve import ResolvedScene, default_opacity_unit
from clvol.transfer import PRESETS, TransferFunction
from clvol.volume import Grid
from clvol.volume.triples import difference, dot

BLANK = 1e-3  # opacity below which nothing is visible
_FAINT = 0.02  # largest opacity of any ray below which the unit is probably a mistake
_NARROW = 0.01  # share of a range that counts as a tiny part of it
_LEAST_HOUNSFIELD_SPAN = 100.0
_SOLID = -math.log(1e-3)  # optical depth that lets nothing through
_TRANSLUCENT = 0.9  # higher opacities may be meant to be opaque


def scene_warnings(resolved: ResolvedScene) -> list[ClvolWarning]:
    """All warnings of a scene except those of the camera."""
    with np.errstate(all="ignore"):  # numbers near the limits of double precision prove nothing
        return _scene_warnings(resolved)


def _scene_warnings(resolved: ResolvedScene) -> list[ClvolWarning]:
    found = Findings(resolved)
    if not found.has_values:
        what = "none of its voxels is a finite number: nothing is visible"
        return [ClvolWarning("volume", what, "set volume.nan to a number, or use another volume")]
    warnings = [_preset(resolved)]
    if found.blank:
        warnings.append(_blank(resolved) if warnings == [None] else None)
    elif warnings == [None] and found.emits and not resolved.transfer_layers and resolved.glow is None:
        warnings.append(_narrow_data(resolved) or _narrow_function(resolved))
        if found.projection is None:
            warnings += [_unit_too_large(resolved, found), _unit_too_small(resolved)]
    warnings += [_clip(clip, number, resolved.volume.grid) for number, clip in enumerate(resolved.clips)]
    return [warning for warning in warnings if warning is not None]


def camera_warning(camera: Camera, grid: Grid, width: int, height: int) -> ClvolWarning | None:
    """A warning if no ray of ``camera`` (complete) can hit the volume on ``grid``."""
    if _sees_centre(camera, grid, width / height):
        return None
    corners = np.asarray(grid.world_corners(), np.float64) - np.asarray(camera.position)
    forward, right, up = camera.basis()
    advice = "set camera.target to a place in the volume, or leave [camera] out to see all of it"
    ahead = corners @ forward
    if (ahead < 0).all():
        what = "looks away from the volume, all of which lies behind it: nothing is visible"
        return ClvolWarning("camera", what, advice)
    if camera.projection == "orthographic":
        half = np.full(len(ahead), 0.5 * camera.height_of_view())
    else:
        half = ahead * math.tan(math.radians(camera.fov_degrees) / 2)
    aspect = width / height
    sides = (
        ("to the right of", corners @ right, aspect), ("to the left of", -(corners @ right), aspect),
        ("above", corners @ up, 1.0), ("below", -(corners @ up), 1.0),
    )  # fmt: skip
    for place, beyond, share in sides:
        if (beyond > half * share).all():
            what = f"does not see the volume, which lies {place} the picture: nothing is visible"
            return ClvolWarning("camera", what, advice)
    return None


def _sees_centre(camera: Camera, grid: Grid, aspect: float) -> bool:
    """Whether the centre of the volume is in the picture, of which nothing more needs to be found out then."""
    forward, right, up = camera.axes()
    place = difference(grid.in_floats.centre, camera.eye())
    ahead = dot(place, forward)
    if camera.projection == "orthographic":
        half = 0.5 * camera.height_of_view()
    else:
        half = ahead * math.tan(math.radians(camera.fov_degrees) / 2)
    return ahead > 0 and abs(dot(place, right)) < half * aspect and abs(dot(place, up)) < half


def largest_depth(resolved: ResolvedScene) -> float:
    """An upper bound of the optical depth along any ray due to the transfer function; inf where it is opaque."""
    with np.errstate(all="ignore"):
        return float(_extinctions(resolved).max() * diagonal(resolved.volume.grid))


def diagonal(grid: Grid) -> float:
    return float(np.linalg.norm(np.ptp(grid.world_corners(), axis=0)))


# ---- the transfer function -------------------------------------------------------------------------


def _preset(resolved: ResolvedScene) -> ClvolWarning | None:
    """A warning of a preset for Hounsfield units if the values are not Hounsfield units."""
    chosen = resolved.chosen or {}
    if "warning" in chosen:
        advice = "set another preset, or leave [transfer_function] out to have one chosen from the volume"
        return ClvolWarning("transfer_function.preset", chosen["warning"], advice)
    if chosen.get("recognised"):
        return None
    name = chosen.get("preset") if chosen.get("scale") == "hounsfield" else None
    name = name or _hounsfield_preset(resolved.transfer_function)
    if name is None:
        return None
    low, high = resolved.data_range
    if low < 0 < high and high - low >= _LEAST_HOUNSFIELD_SPAN:
        return None
    if low >= 0:
        reason = "no voxel is below 0, as air (-1000) and fat are"
    elif high <= 0:
        reason = "no voxel is above 0, as muscle and bone are"
    else:
        reason = "they differ by less than air, water and bone do"
    what = (
        f"{name!r} is for Hounsfield units, but the voxels lie between {low:g} and {high:g}: {reason}, "
        "so that other things show than it says"
    )
    shift = "volume.offset to what makes Hounsfield units of them (often -1000 or -1024), or "
    advice = f"set {shift if low >= 0 and high > 1000 else ''}transfer_function.preset to another one, as 'surface'"
    return ClvolWarning("transfer_function.preset", what, advice)


def _hounsfield_preset(function: TransferFunction) -> str | None:
    for name, preset in PRESETS.items():
        points = [(value, opacity) for value, opacity, _ in preset.points]
        if preset.scale == "hounsfield" and points == list(zip(function.values, function.opacities)):
            return name
    return None


def _blank(resolved: ResolvedScene) -> ClvolWarning:
    """A warning if nothing of the volume, of fields or of iso-surfaces is visible."""
    function, (low, high) = resolved.transfer_function, resolved.data_range
    voxels = f"the voxels lie between {low:g} and {high:g}"
    if low == high:
        voxels = f"all voxels are {low:g}"
    if resolved.isosurfaces and not function.opacities.any():
        values = ", ".join(f"{surface.value:g}" for surface in resolved.isosurfaces)
        what = f"no surface has both an opacity and a value that occurs ({values}), {voxels}: nothing is visible"
        return ClvolWarning("isosurface", what, f"set isosurface.value between {low:g} and {high:g}")
    if not function.opacities.any():
        what = "all its opacities are 0: nothing is visible"
        return ClvolWarning("transfer_function", what, "set an opacity above 0 in transfer_function.points")
    first, last = function.values[[0, -1]]
    if first > high or last < low:
        what = f"its points lie between {first:g} and {last:g}, but {voxels}: nothing is visible"
    else:
        shown = _shown(function)
        what = f"it shows values {shown}, but {voxels}: nothing is visible"
    advice = f"set transfer_function.points to values between {low:g} and {high:g}"
    if low == high:
        advice = f"set an opacity above 0 at the value {low:g} in transfer_function.points"
    return ClvolWarning("transfer_function", what, advice)


def _shown(function: TransferFunction) -> str:
    """The values that have opacity, in words."""
    visible = np.flatnonzero(function.opacities > 0)
    first, last = visible[0], visible[-1]
    low = None if first == 0 else function.values[first - 1]
    high = None if last == len(function.values) - 1 else function.values[last + 1]
    if low is None and high is None:
        return "of any size"
    if low is None:
        return f"below {high:g}"
    return f"above {low:g}" if high is None else f"between {low:g} and {high:g}"


def _narrow_data(resolved: ResolvedScene) -> ClvolWarning | None:
    """A warning if all voxels lie in a tiny part of the function, where it hardly changes."""
    function, (low, high) = resolved.transfer_function, resolved.data_range
    first, last = function.values[[0, -1]]
    span = last - first
    if not (span > 0 and low >= first and high <= last and high - low < _NARROW * span and high > low):
        return None
    inside = (function.values >= low) & (function.values <= high)
    opacities = np.concatenate([function.opacity(np.array([low, high])), function.opacities[inside]])
    colors = np.concatenate([function.color(np.array([low, high])), function.colors[inside]])
    changes = max(np.ptp(opacities), np.ptp(colors, axis=0).max())
    of_all = max(np.ptp(function.opacities), np.ptp(function.colors, axis=0).max())
    if changes >= _NARROW * of_all:
        return None
    what = (
        f"its points lie between {first:g} and {last:g}, but the voxels between {low:g} and {high:g}: "
        "they all look the same"
    )
    return ClvolWarning(
        "transfer_function", what, f"set transfer_function.points to values between {low:g} and {high:g}"
    )


def _narrow_function(resolved: ResolvedScene) -> ClvolWarning | None:
    """A warning if the function ends near the beginning of the data, and is opaque beyond."""
    function, (low, high) = resolved.transfer_function, resolved.data_range
    if len(function.values) < 2 or function.values[0] == function.values[-1]:
        return None  # a constant or a step, which applies to all values
    first, last = function.values[[0, -1]]
    covered = max(min(last, high) - max(first, low), 0.0)
    beyond = max(high - last, 0.0) if function.opacities[-1] > 0 else 0.0
    before = max(first - low, 0.0) if function.opacities[0] > 0 else 0.0
    if covered >= _NARROW * (high - low) or beyond + before <= (1 - _NARROW) * (high - low):
        return None
    what = (
        f"its points lie between {first:g} and {last:g}, but the voxels between {low:g} and {high:g}: "
        f"nearly all values have the {'last' if beyond else 'first'} point's colour and opacity"
    )
    return ClvolWarning(
        "transfer_function", what, f"set transfer_function.points to values between {low:g} and {high:g}"
    )


# ---- the opacity unit ------------------------------------------------------------------------------


def _extinctions(resolved: ResolvedScene) -> np.ndarray:
    """Extinctions per world length at the points of the function within the range of the data, and at the ends of the
    range.
    """
    function, (low, high) = resolved.transfer_function, reachable(resolved)
    inside = (function.values >= low) & (function.values <= high)
    opacities = np.concatenate([function.opacities[inside], function.opacity(np.array([low, high]))])
    return -np.log1p(-opacities) / function.opacity_unit


def _unit_too_large(resolved: ResolvedScene, found: Findings) -> ClvolWarning | None:
    if found.surfaces or found.adds or not largest_depth(resolved) < _FAINT:
        return None
    unit, length = resolved.transfer_function.opacity_unit, diagonal(resolved.volume.grid)
    what = (
        f"opacities are for a length of {unit:g}, but the volume is {length:.3g} long in all: at most "
        f"{100 * -math.expm1(-largest_depth(resolved)):.2g} % of the light is absorbed, and next to nothing is visible"
    )
    return ClvolWarning("transfer_function.opacity_unit", what, _set_unit(resolved))


def _unit_too_small(resolved: ResolvedScene) -> ClvolWarning | None:
    """A warning if opacities that are probably meant to be translucent are opaque within a tenth of a voxel."""
    function, edge = resolved.transfer_function, resolved.volume.grid.smallest_edge
    low, high = resolved.data_range
    inside = (function.values >= low) & (function.values <= high)
    largest = max(function.opacities[inside].max(initial=0.0), *function.opacity(np.array([low, high])))
    if not 0 < largest <= _TRANSLUCENT:
        return None
    faint = 0.1 * float(largest)
    if -math.log1p(-faint) * edge / function.opacity_unit < _SOLID:
        return None
    what = (
        f"opacities are for a length of {function.opacity_unit:g}, but a voxel is {edge:g} long: even an "
        f"opacity of {faint:.2g} is opaque within one voxel"
    )
    return ClvolWarning("transfer_function.opacity_unit", what, _set_unit(resolved))


def _set_unit(resolved: ResolvedScene) -> str:
    return f"set transfer_function.opacity_unit to about {default_opacity_unit(resolved.volume.grid):.3g}"


# ---- clips -----------------------------------------------------------------------------------------


def _clip(clip: Clip, number: int, grid: Grid) -> ClvolWarning | None:
    """A warning of a clip that removes the whole volume."""
    corners = np.asarray(grid.world_corners(), np.float64)
    if clip.type == "plane":
        normal = np.asarray(clip.normal)
        normal = normal / np.abs(normal).max()
        removes = ((corners - np.asarray(clip.point)) @ normal < 0).all()
        advice = "turn its normal to the side to keep, or move its point"
    elif clip.type == "box":
        lower, upper = np.asarray(clip.lower), np.asarray(clip.upper)
        removes = bool(((corners >= lower) & (corners <= upper)).all())
        if clip.keep != "outside":
            removes = box_apart(grid, lower, upper)
        advice = "set its lower and upper to a box that meets the volume, or keep to the other side"
    elif isinstance(clip, MeshClip):
        removes = mesh_holds(clip.mesh, grid) if clip.keep == "outside" else box_apart(grid, *clip.mesh.bounds)
        advice = "move it into the volume, in the world coordinates of both, or keep to the other side"
    else:
        centre = np.asarray(clip.center)
        largest = max(np.abs(corners - centre).max(), clip.radius)
        if clip.keep == "outside":
            removes = np.linalg.norm((corners - centre) / largest, axis=1).max() <= clip.radius / largest
        else:
            removes = nearest_distance(centre, grid, largest) > clip.radius / largest
        advice = "set its center and radius to a sphere that meets the volume, or keep to the other side"
    if not removes:
        return None
    low, high = corners.min(axis=0), corners.max(axis=0)
    span = f"{_point(low)} to {_point(high)}"
    what = f"this {clip.type} removes the whole volume, which reaches from {span}: nothing is visible"
    return ClvolWarning(f"clip.{number}", what, advice)


def _point(place: np.ndarray) -> str:
    return "[" + ", ".join(f"{x:.4g}" for x in place) + "]"
