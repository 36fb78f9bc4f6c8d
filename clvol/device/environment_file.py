"""Environment maps from OpenEXR files, by latitude and longitude, as a cube or as a mirror ball.

A cube is a vertical strip of six square faces, +x -x +y -y +z -z from the top, each as OpenGL's
cube maps have them (OpenGL 4.6 sec. 8.13, table 8.19): with M the direction's largest component,

    face  +x  -x  +y  -y  +z  -z
    sc    -z  +z  +x  +x  +x  -x
    tc    -y  -y  +z  -z  -y  -y

a texel's column is (sc / |M| + 1) / 2 and its row (tc / |M| + 1) / 2 of the face, row 0 the first.

A mirror ball is OpenGL's sphere map (OpenGL 4.6 compatibility profile sec. 12.1.3; Haeberli and Segal 1993): a square
with the ball as its inscribed disc, seen from afar along -z, +y up. At (u, v) from -1 to 1 (v up) the ball's normal is
n = (u, v, sqrt(1 - u^2 - v^2)), which mirrors r = 2 n.z n - (0, 0, 1). Each texel of the disc has the same solid angle.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from clvol.device.environment import LARGEST_ROWS, RadianceMap
from clvol.errors import SceneError, UsageError
from clvol.image import exr
from clvol.volume.memory import DEFAULT_SHARE, available_memory

LAYOUTS = ("latlong", "cube", "sphere")
_FILES = "an OpenEXR file with channels R, G, B"
# Axis and sign of M, sc and tc of each face.
_FACES = (
    ((0, 1), (2, -1), (1, -1)), ((0, -1), (2, 1), (1, -1)), ((1, 1), (0, 1), (2, 1)),
    ((1, -1), (0, 1), (2, -1)), ((2, 1), (0, 1), (1, -1)), ((2, -1), (0, -1), (1, -1)),
)  # fmt: skip


def load_radiance(
    path: str | Path,
    layout: str = "latlong",
    intensity: float = 1.0,
    rotation_degrees: float = 0.0,
    memory_cap: int | None = None,
) -> RadianceMap:
    """The file's radiance times ``intensity``, turned about +y (``RadianceMap``); a cube of n x n
    faces becomes 2 n rows of latitude, a mirror ball of n x n texels n rows. ``memory_cap``: bytes that reading may
    take; 75 % of the available memory where it is None. SceneError names the file and the problem."""
    where = str(path)
    if memory_cap is None:
        memory_cap = int(DEFAULT_SHARE * available_memory())
    texels = _read(where, memory_cap)
    height, width = texels.shape[:2]
    got = f"is {width} x {height} texels (width x height)"
    if layout == "latlong" and (width != 2 * height or height < 2):
        raise SceneError(where, got, 'twice as wide as high (or layout = "cube" or "sphere")')
    if layout == "cube" and height != 6 * width:
        raise SceneError(where, got, "six square faces, one below the other")
    if layout == "sphere":
        if height != width:
            raise SceneError(where, got, "a square around a mirror ball")
        texels = _with_rim(texels)
    bad = int(np.count_nonzero(~np.all(np.isfinite(texels) & (texels >= 0.0), axis=-1)))
    if bad:
        what = f"{bad} of {width * height} texels are negative or not finite"
        raise SceneError(where, what, "radiance of 0 or more")
    with np.errstate(over="ignore"):
        texels = texels * np.float32(intensity)
    if not np.all(np.isfinite(texels)):
        raise SceneError(where, f"radiance times intensity {intensity} overflows", "32-bit floats")
    if layout == "cube":
        texels = latlong_of_cube(texels)
    if layout == "sphere":
        texels = latlong_of_ball(texels)
    return RadianceMap(texels, float(np.radians(rotation_degrees)))


def _read(where: str, memory_cap: int) -> np.ndarray:
    """float32 [height, width, 3]."""
    try:
        with open(where, "rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise SceneError(where, f"cannot be read ({error.strerror})", _FILES) from None
    if magic != b"\x76\x2f\x31\x01":
        raise SceneError(where, "is not an OpenEXR file", _FILES)
    try:
        channels = exr.channels(where, memory_cap)
    except UsageError as error:
        raise SceneError(error.where, error.what, error.expected) from None
    except MemoryError:
        raise
    except Exception as error:  # the library raises exceptions of many kinds on damaged files
        raise SceneError(where, f"cannot be read ({error})", _FILES) from None
    there = ", ".join(sorted(channels)) or "none"
    if any(name not in channels for name in "RGB"):
        raise SceneError(where, f"the channels are {there}", "R, G, B")
    planes = [channels[name] for name in "RGB"]
    if any(plane.ndim != 2 or plane.shape != planes[0].shape for plane in planes):
        raise SceneError(where, "its channels differ in size", _FILES)
    return np.stack(planes, axis=-1).astype(np.float32)


# --- cubes


def latlong_of_cube(strip: np.ndarray) -> np.ndarray:
    """float32 [2 n, 4 n, 3] from faces [6 n, n, 3]: a texel is the mean of 2 x 2 bilinear look-ups.
    Where a cube's texels are smallest, at its corners, those are half a texel of the result
    wide."""
    n = strip.shape[1]
    padded = _with_borders(strip)

    def places(directions: np.ndarray) -> list[np.ndarray]:
        face, s, t = cube_coordinates(directions)
        return [face * (n + 2) + 0.5 + t * n, 0.5 + s * n]

    return _latlong(padded, 2 * n, places)


def _latlong(texels: np.ndarray, wanted: int, places: Callable[[np.ndarray], list[np.ndarray]]) -> np.ndarray:
    """float32 [rows, 2 rows, 3] with ``wanted`` rows, or LARGEST_ROWS: a texel is the mean of 2 x 2 bilinear look-ups,
    or of more where rows are fewer than wanted. ``places``: row and column in ``texels`` of directions [..., 3]."""
    from scipy.ndimage import map_coordinates

    rows = min(wanted, LARGEST_ROWS)
    result = np.empty((rows, 2 * rows, 3), np.float32)
    samples = 2 * max(1, -(-wanted // rows))  # an edge
    psi = (np.arange(2 * rows * samples) + 0.5) * (np.pi / (rows * samples)) - np.pi
    block = max(1, 2**19 // (psi.size * samples))  # rows; bounds memory
    for first in range(0, rows, block):
        last = min(first + block, rows)
        theta = (np.arange(first * samples, last * samples) + 0.5) * (np.pi / (rows * samples))
        sine = np.sin(theta)[:, None]
        y = np.broadcast_to(np.cos(theta)[:, None], (theta.size, psi.size))
        directions = np.stack([sine * np.sin(psi), y, -sine * np.cos(psi)], axis=-1)
        at = places(directions)
        for k in range(3):
            seen = map_coordinates(texels[..., k], at, np.float64, 1, "nearest")
            shape = (last - first, samples, 2 * rows, samples)
            result[first:last, :, k] = seen.reshape(shape).mean(axis=(1, 3))
    return result


def cube_coordinates(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Face 0..5, s and t in [0, 1] (column and row over the face's edge) of ``directions`` [...,
    3]."""
    largest = np.argmax(np.abs(directions), axis=-1)
    component = np.take_along_axis(directions, largest[..., None], -1)[..., 0]
    face = 2 * largest + (component < 0.0)
    table = np.array(_FACES)  # [face, M or sc or tc, axis or sign]
    coordinates = []
    for k in (1, 2):
        axis, sign = table[face, k, 0], table[face, k, 1]
        along = np.take_along_axis(directions, axis[..., None], -1)[..., 0]
        coordinates.append(0.5 * (sign * along / np.abs(component) + 1.0))
    return face, coordinates[0], coordinates[1]


def cube_directions(face: int, s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """The directions (any length) at s, t of ``face``: the inverse, also beyond the face's
    edges."""
    (major, sign), (axis_s, sign_s), (axis_t, sign_t) = _FACES[face]
    s, t = np.broadcast_arrays(s, t)
    directions = np.empty((*s.shape, 3))
    directions[..., major] = sign
    directions[..., axis_s] = sign_s * (2.0 * s - 1.0)
    directions[..., axis_t] = sign_t * (2.0 * t - 1.0)
    return directions


def _with_borders(strip: np.ndarray) -> np.ndarray:
    """Faces [6 (n + 2), n + 2, 3] with the neighbouring faces' nearest texels around them."""
    n = strip.shape[1]
    faces = strip.reshape(6, n, n, 3)
    padded = np.empty((6, n + 2, n + 2, 3), strip.dtype)
    padded[:, 1:-1, 1:-1] = faces
    along = (np.arange(n + 2) - 0.5) / n
    low, high = along[0], along[-1]
    edges = [
        ((0, slice(None)), along, low), ((-1, slice(None)), along, high),
        ((slice(None), 0), low, along), ((slice(None), -1), high, along),
    ]  # fmt: skip
    for face in range(6):
        for where, s, t in edges:
            there, u, v = cube_coordinates(cube_directions(face, s, t))
            column, row = (np.clip((f * n).astype(np.int64), 0, n - 1) for f in (u, v))
            padded[face][where] = faces[there, row, column]
    return padded.reshape(6 * (n + 2), n + 2, 3)


# --- mirror balls


def latlong_of_ball(square: np.ndarray) -> np.ndarray:
    """float32 [n, 2 n, 3] from a mirror ball [n, n, 3] (n at least 2 rows), whose texels around the disc are those of
    its rim (``_with_rim``)."""
    n = square.shape[0]

    def places(directions: np.ndarray) -> list[np.ndarray]:
        u, v = ball_coordinates(directions)
        return [(1.0 - v) * (0.5 * n) - 0.5, (u + 1.0) * (0.5 * n) - 0.5]

    return _latlong(square, max(n, 2), places)


def ball_coordinates(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u and v in [-1, 1] of what a mirror ball shows of unit ``directions`` [..., 3]; of -z that of some place of the
    rim."""
    x, y, z = np.moveaxis(directions, -1, 0)
    # The normal is the direction plus +z, of unit length; near -z by what is left of x and y, without cancellation.
    across = np.hypot(x, y)
    share = np.sqrt(0.5 * np.maximum(1.0 - z, 0.0))  # sin of half the angle to +z
    scale = share / np.where(across > 0, across, 1.0)
    return np.where(across > 0, x * scale, share), y * scale


def _with_rim(square: np.ndarray) -> np.ndarray:
    """``square`` [n, n, 3] with the nearest texel of the inscribed disc in place of each texel around it."""
    from scipy.ndimage import distance_transform_edt

    n = square.shape[0]
    centres = (np.arange(n) + 0.5) * (2.0 / n) - 1.0
    outside = centres[:, None] ** 2 + centres**2 > 1.0
    if not outside.any():
        return square
    rows, columns = distance_transform_edt(outside, return_distances=False, return_indices=True)
    return np.ascontiguousarray(square[rows, columns])
