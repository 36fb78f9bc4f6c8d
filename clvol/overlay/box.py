"""The edges of the volume's box; the volume covers those that lie behind it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clvol.overlay.canvas import Canvas, Inks, Point
from clvol.scene.camera import Camera

if TYPE_CHECKING:
    from clvol.overlay.description import Description

# Two corners whose numbers differ in one bit share an edge; the face (axis, side) has the corners with that bit.
EDGES = [(k, k | 1 << axis) for axis in range(3) for k in range(8) if not k >> axis & 1]
FACES = [(axis, side) for axis in range(3) for side in range(2)]
_NEAREST = 1e-3  # of the distance to the target: what is nearer to the eye is cut off


def draw_box(canvas: Canvas, description: Description, opacity: np.ndarray, size: float) -> None:
    """The twelve edges: those of faces that are turned away are covered by the volume, since they are behind it; all
    others are in front of it."""
    corners = np.array(description.corners)
    turned = facing(corners, description.camera)
    width = max(1.0, 0.09 * size)
    inks = canvas.inks(0, 0, canvas.width, canvas.height)
    hidden: list[tuple[Point, Point]] = []
    visible: list[tuple[Point, Point]] = []
    for edge in EDGES:
        line = projected(corners[list(edge)], description.camera, canvas.width, canvas.height)
        if line is None:
            continue
        (visible if any(turned[face] for face in _faces_of(edge)) else hidden).append(line)
    canvas.strokes(hidden, width, inks.ink, 0.7, behind=opacity)
    canvas.outlined(visible, width, Inks(inks.ink, inks.halo))


def _faces_of(edge: tuple[int, int]) -> list[tuple[int, int]]:
    first, second = edge
    return [(axis, first >> axis & 1) for axis in range(3) if first >> axis & 1 == second >> axis & 1]


def facing(corners: np.ndarray, camera: Camera) -> dict[tuple[int, int], bool]:
    """Whether each face (axis, side) of the box with the ``corners`` [8, 3] is turned towards the camera."""
    forward = camera.basis()[0]
    centre = corners.mean(axis=0)
    found = {}
    for axis, side in FACES:
        own = corners[[k for k in range(8) if k >> axis & 1 == side]]
        one, other = own[1] - own[0], own[2] - own[0]
        normal = np.cross(one, other)
        if normal @ (own.mean(axis=0) - centre) < 0:
            normal = -normal
        towards = -forward if camera.projection == "orthographic" else np.array(camera.position) - own.mean(axis=0)
        found[axis, side] = bool(normal @ towards > 0)
    return found


def projected(ends: np.ndarray, camera: Camera, width: int, height: int) -> tuple[Point, Point] | None:
    """The line between two world positions [2, 3] in pixels; None where all of it is behind the eye."""
    forward, right, up = camera.basis()
    away = ends - np.asarray(camera.position, np.float64)
    x, y, z = away @ right, away @ up, away @ forward
    if camera.projection == "orthographic":
        scale = np.full(2, height / camera.height_of_view())
    else:
        nearest = _NEAREST * math.dist(camera.position or (0, 0, 0), camera.target or (0, 0, 0))
        if (z < nearest).all():
            return None
        if (z < nearest).any():
            part = (nearest - z[0]) / (z[1] - z[0])
            cut = ends[0] + part * (ends[1] - ends[0])
            ends = np.array([cut, ends[1]] if z[0] < nearest else [ends[0], cut])
            away = ends - np.asarray(camera.position, np.float64)
            x, y, z = away @ right, away @ up, np.maximum(away @ forward, nearest)
        scale = height / (2.0 * math.tan(math.radians(camera.fov_degrees) / 2) * z)
    columns = np.clip(0.5 * width + scale * x, -1e6, 1e6)
    rows = np.clip(0.5 * height - scale * y, -1e6, 1e6)
    return (float(columns[0]), float(rows[0])), (float(columns[1]), float(rows[1]))
