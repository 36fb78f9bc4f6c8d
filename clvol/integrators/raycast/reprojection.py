"""What the places that rays of one picture met are in the next one (cl/reproject.cl): the change of camera, and how far
around a pixel what it sees may have been in the picture before.

A pixel may start at the nearest place that was splat on it (Klein et al., IEEE Visualization 2005, section 4), unless
something shows now that was hidden. Whatever a new ray meets, at X, lay in the old picture on a ray that had met
something at Y first, or X itself. X and Y are on one old ray, so in the new picture Y is nearer than X, and within the
parallax between the nearest and the farthest depth at which anything can be visible. The farther X is from Y in the new
picture, the farther it is behind Y, too: small moves show little that is close behind Y. So a pixel may start at the
nearest of all places within the splat and that parallax, each moved back by as many edges as X must be behind it there;
that is no later than X, up to what is thinner than a pixel of the old picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.device.view import RayFrame
from clvol.schedule.tiles import TILE

MOVE = 28  # numbers of a move
MARGIN = 64  # pixels around the picture, and of the largest window (cl/reproject.cl)
_GRID = 9  # rays per side by which parallax is bounded
_SLACK = 1.1  # over what these rays show
_LEAST_DISTANCE = 0.5  # edges from an eye to anything that may be visible
_LEAST_SPLAT = 3  # so that each pixel has those around it, and no place near means nothing to see
_SAME = 0.05  # pixels that do not count
_NEVER = 1e6  # edges per pixel where nothing moves
_CORNERS = np.indices((2, 2, 2)).reshape(3, 8).T  # of a box: whether at its upper end


@dataclass(frozen=True, eq=False)
class Move:
    """``numbers`` float32 [28] and ``window`` (x0, x1, y0, y1), as cl/reproject.cl takes them. ``inside`` uint8 [rows,
    columns]: tiles all of whose rays were in the old view."""

    numbers: np.ndarray
    window: tuple[int, int, int, int]
    inside: np.ndarray


def change_of_camera(old: RayFrame, new: RayFrame) -> np.ndarray:
    """float64 [3, 6]: coefficients of 1, u, v, s, s u, s v that give, for the place at depth ``s`` (edges) behind the
    old reference plane on the ray of the old pixel (``u``, ``v``), from the centre, the depth behind the new plane,
    and the new pixel from the new centre times its depth behind the eye (perspective) or by itself."""
    axes = (new.ray_du, new.ray_dv) if is_perspective(new) else (new.du, new.dv)
    sources = [old.origin - new.origin, old.du, old.dv, old.forward, old.ray_du, old.ray_dv]
    return np.linalg.solve(np.stack([new.forward, *axes], axis=1), np.stack(sources, axis=1))


def is_perspective(frame: RayFrame) -> bool:
    return frame.lens[0] != 0.0


def _lines(coefficients: np.ndarray, old: RayFrame, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """float64 [2, 3, n]: of the rays of old pixels what ``coefficients`` give at the old reference plane, and per edge
    behind it."""
    terms = np.stack([np.ones_like(x), x - old.centre[0], y - old.centre[1]])
    return (coefficients.reshape(3, 2, 3) @ terms).swapaxes(0, 1)


def _on_lines(lines: np.ndarray, new: RayFrame, s: float | np.ndarray) -> np.ndarray:
    """float64 [2, n]: new pixel coordinates of places at depth ``s`` on ``lines``; NaN for those behind the new eye."""
    depth, across, down = lines[0] + s * lines[1]
    from_eye = np.where(new.distance + depth > 0, new.distance + depth, np.nan) if is_perspective(new) else 1.0
    return np.stack([across / from_eye + new.centre[0], down / from_eye + new.centre[1]])


def moved(coefficients: np.ndarray, old: RayFrame, new: RayFrame, x, y, s) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """New pixel coordinates (x, y) and depth behind the new reference plane of places at depth ``s`` behind the old
    plane on the rays of the old pixels (``x``, ``y``), all of one shape. NaN for what is behind the new eye."""
    lines = _lines(coefficients, old, np.ravel(x), np.ravel(y))
    s = np.ravel(s) if np.ndim(s) else s
    new_x, new_y = _on_lines(lines, new, s)
    depth = lines[0, 0] + s * lines[1, 0]
    return new_x.reshape(np.shape(x)), new_y.reshape(np.shape(x)), depth.reshape(np.shape(x))


def plan_move(
    old: RayFrame,
    new: RayFrame,
    old_size: tuple[int, int],
    new_size: tuple[int, int],
    bounds: tuple[np.ndarray, np.ndarray],
    splat: int,
) -> Move | str:
    """The move between two pictures (sizes: width, height), or why rays must start at the hull. ``bounds``: lattice
    points (x, y, z), the corners of a box around all that can be visible. ``splat``: pixels."""
    if is_perspective(old) != is_perspective(new):
        return "another projection"
    coefficients = change_of_camera(old, new)
    corners = np.where(_CORNERS, bounds[1], bounds[0])
    x, y, depths = _seen(old, corners)
    _, _, new_depths = _seen(new, corners)
    near, far = depths.min(), depths.max()
    new_near, new_far = new_depths.min(), new_depths.max()
    for frame, nearest in ((old, near), (new, new_near)):
        if is_perspective(frame) and frame.distance + nearest < _LEAST_DISTANCE:
            return "the eye is inside"
    # All rays of the old picture that see anything: their nearest and farthest places, seen by the new camera, and
    # those of the pixels beside them.
    left, right = np.clip([x.min(), x.max()], 0, old_size[0] - 1)
    top, bottom = np.clip([y.min(), y.max()], 0, old_size[1] - 1)
    columns, rows = np.linspace(left, right, _GRID), np.linspace(top, bottom, _GRID)
    at_x = (np.repeat(columns, _GRID)[:, None] + [0, 1, 0]).ravel()
    at_y = (np.tile(rows, _GRID)[:, None] + [0, 0, 1]).ravel()
    lines = _lines(coefficients, old, at_x, at_y)
    seen = np.stack([_on_lines(lines, new, s) for s in (near, far)]).reshape(2, 2, -1, 3).swapaxes(0, 1)
    parallax = seen[:, 0, ..., 0] - seen[:, 1, ..., 0]
    if not np.isfinite(seen).all():
        return "motion"
    zoom = float(np.abs(seen[..., 1:] - seen[..., :1]).max())
    size = max(int(np.ceil(splat * zoom - _SAME)), splat)
    window: list[int] = []
    for along in parallax:
        low, high = min(_SLACK * along.min(), 0.0), max(_SLACK * along.max(), 0.0)
        if max(-low, high) <= max((splat - 1) / 2, _SAME):
            low = high = 0.0  # the splat covers it
        window += [int(np.floor(low)) - size + 1, int(np.ceil(high))]
    if max(map(abs, window)) > MARGIN:
        return "motion"
    behind = _edges_behind(lines[:, :, ::3], new, (near, far))
    if behind is None:
        return "motion"
    numbers = np.zeros(MOVE, np.float32)
    numbers[:18] = coefficients.ravel()
    numbers[18] = new.distance if is_perspective(new) else -1.0
    numbers[19:27] = *old.centre, *new.centre, size, size >= _LEAST_SPLAT, *behind
    # A ray is half a pixel, at most, beside the one whose place is taken: that much less it is beyond the splat.
    numbers[27] = 0.5 if splat > 1 else 1.0
    tiles = tuple(-(-n // TILE) for n in new_size[::-1])
    if x.min() > 0 and y.min() > 0 and x.max() < old_size[0] - 1 and y.max() < old_size[1] - 1:
        inside = np.ones(tiles, np.uint8)
    else:
        inside = _tiles_inside(new, old, new_size, old_size, (new_near, new_far))
    return Move(numbers, (window[0], window[1], window[2], window[3]), inside)


def _edges_behind(lines: np.ndarray, new: RayFrame, depths: tuple[float, float]) -> np.ndarray | None:
    """float64 [2]: edges, at least, by which a place is farther behind the new reference plane than another one on the
    same old ray for each pixel, of columns and of rows, between them in the new picture: halves, since a sum of both is
    taken for the larger one. ``lines``: of old rays. None where a place farther behind the old plane is nearer to the
    new one."""
    at_plane, along = lines
    if along[0].min() <= 0:
        return None
    rates = np.zeros(2)
    for s in depths:  # the rate of a homography is largest at one of them
        if not is_perspective(new):
            rate = along[1:] / along[0]
        else:
            from_eye = new.distance + at_plane[0] + s * along[0]
            rate = (along[1:] * from_eye - (at_plane[1:] + s * along[1:]) * along[0]) / (from_eye**2 * along[0])
        rates = np.maximum(rates, np.abs(rate).max(axis=1))
    return np.minimum(0.5 / np.maximum(_SLACK * rates, 1e-30), _NEVER)


def _seen(frame: RayFrame, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixel coordinates x and y, and depths behind the reference plane, of lattice points [n, 3]."""
    axes = (frame.ray_du, frame.ray_dv) if is_perspective(frame) else (frame.du, frame.dv)
    s, across, down = np.linalg.solve(np.stack([frame.forward, *axes], axis=1), (places - frame.origin).T)
    from_eye = np.maximum(frame.distance + s, 1e-6) if is_perspective(frame) else 1.0
    return across / from_eye + frame.centre[0], down / from_eye + frame.centre[1], s


def _tiles_inside(
    new: RayFrame, old: RayFrame, new_size: tuple[int, int], old_size: tuple[int, int], depths: tuple[float, float]
) -> np.ndarray:
    """``Move.inside``: what a tile's rays see between ``depths`` is convex, also in the old picture."""
    back = change_of_camera(new, old)
    x, y = (np.append(np.arange(0, n, TILE), n) - 0.5 for n in new_size)
    corners_x, corners_y = np.meshgrid(x, y)
    fits = np.ones(corners_x.shape, bool)
    for s in depths:
        old_x, old_y, _ = moved(back, new, old, corners_x, corners_y, s)
        with np.errstate(invalid="ignore"):
            fits &= (old_x >= -0.5) & (old_x <= old_size[0] - 0.5) & (old_y >= -0.5) & (old_y <= old_size[1] - 0.5)
    return (fits[1:, 1:] & fits[1:, :-1] & fits[:-1, 1:] & fits[:-1, :-1]).astype(np.uint8)
