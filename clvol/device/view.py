"""From a camera and a grid to the numbers that one frame's kernel launch needs.

All of it is done in double precision here; the kernel gets the picture's rays relative to a plane
that touches the volume, so that neither a far eye nor a large origin costs float32 any digits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clvol.scene.camera import Camera
from clvol.schedule.tiles import TILE
from clvol.volume import Grid
from clvol.volume.grid import GridFloats
from clvol.volume.triples import Triple, added, difference, dot, scaled


@dataclass(frozen=True, eq=False)
class RayFrame:
    """The rays of a picture, in lattice coordinates (float64).

    Pixel (column, row) at u = column - ``centre[0]``, v = row - ``centre[1]`` has the ray through
    ``origin`` + u ``du`` + v ``dv`` in direction (``forward`` + u ``ray_du`` + v ``ray_dv``) / |.|, the norm
    taken in world space: sqrt(1 + (u ``lens[0]``)^2 + (v ``lens[1]``)^2). The eye lies ``distance``
    times that norm before the origin's plane. Lengths along rays are in units of the smallest voxel
    edge, ``unit`` world lengths: the world's scale never meets float32. ``pixel``: side of the square that a ray stands
    for, in distances between rays.
    """

    origin: np.ndarray
    du: np.ndarray
    dv: np.ndarray
    forward: np.ndarray
    ray_du: np.ndarray
    ray_dv: np.ndarray
    lens: tuple[float, float]
    centre: tuple[float, float]
    distance: float
    unit: float
    pixel: float = 1.0


@dataclass(frozen=True)
class PixelLattice:
    """Every ``spacing``-th pixel of a picture's rows and columns, from (``column``, ``row``) on.

    The sparse picture of a lattice has exactly the rays of those pixels. ``alone``: the pixels between are of no
    interest, so that methods whose pixels depend on their neighbours make a picture of these pixels alone.
    ``covers``: side, in pixels of the full picture, of the square that a ray stands for.
    """

    spacing: int = 1
    column: int = 0
    row: int = 0
    alone: bool = False
    covers: float = 1.0

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Pixels (width, height) of the sparse picture of one of ``width`` by ``height``."""
        return (
            max(0, -(-(width - self.column) // self.spacing)),
            max(0, -(-(height - self.row) // self.spacing)),
        )

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns of the full picture that are on the lattice."""
        return np.s_[self.row :: self.spacing, self.column :: self.spacing]

    def count(self, width: int, height: int) -> int:
        """Pixels of the sparse picture."""
        across, down = self.size(width, height)
        return across * down

    def pixels(self, width: int, height: int) -> np.ndarray:
        """int64 [n, 2]: (row, column) in the full picture, row by row of the sparse one."""
        rows, columns = np.meshgrid(
            np.arange(self.row, height, self.spacing),
            np.arange(self.column, width, self.spacing),
            indexing="ij",
        )
        return np.stack([rows.ravel(), columns.ravel()], axis=1)


EVERY_PIXEL = PixelLattice()


@dataclass(frozen=True, eq=False)
class PixelList:
    """Some pixels of a picture: their ``rows`` and ``columns``, int32 [n] each. ``spacing``: they are taken from as
    many by as many lattices of this spacing, each a picture by itself. ``covers``: as in ``PixelLattice``.

    Their picture consists of tiles of ``TILE`` by ``TILE`` that lie below each other; pixel k of the list is pixel k
    of its rows, one after the other. What follows the last one is undefined.
    """

    rows: np.ndarray
    columns: np.ndarray
    spacing: int = 1
    covers: float = 1.0

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Pixels (width, height) of the list's picture."""
        return TILE, TILE * -(-len(self.rows) // TILE**2)

    def count(self, width: int, height: int) -> int:
        """Pixels of the list."""
        return len(self.rows)

    def places(self) -> np.ndarray:
        """int32 [pixels of the list's picture, 2]: column and row of each, and -1 behind the last one."""
        found = np.full((TILE * self.size(0, 0)[1], 2), -1, np.int32)
        found[: len(self.rows), 0], found[: len(self.rows), 1] = self.columns, self.rows
        return found


Pixels = PixelLattice | PixelList
"""The pixels of a picture that are rendered."""


def picture_height(camera: Camera) -> float:
    """World height of the picture of an orthographic ``camera`` (complete)."""
    if camera.height is None:
        raise ValueError("an orthographic camera without a height")
    return camera.height


def ray_frame(
    camera: Camera, grid: Grid, width: int, height: int, lattice: PixelLattice = EVERY_PIXEL
) -> RayFrame:
    """The rays of ``camera`` (complete) for a picture of ``width`` by ``height`` square pixels, or
    for the sparse picture of ``lattice``: then the pixels of RayFrame are the lattice's."""
    forward, right, up = camera.axes()
    of_grid = grid.in_floats
    eye = camera.eye()
    reach = sum(abs(dot(forward, column)) * half for column, half in zip(of_grid.columns, of_grid.half))
    # The plane touches the domain from the front, or holds an eye that is nearer: a ray meets it no
    # farther from the view's axis than it meets the domain, however wide the view.
    distance = max(dot(difference(of_grid.centre, eye), forward) - reach, 0.0)
    # eye + distance * forward - centre is formed so that a far eye cancels before it is rounded.
    offset = added(difference(eye, of_grid.centre), scaled(distance, forward))
    # An axis of one voxel is held twice.
    origin = [x + 0.5 * (n == 1) for x, n in zip(added(_lattice(of_grid, offset), of_grid.middle), grid.size)]

    if camera.projection == "orthographic":
        pixel, tangent = picture_height(camera) / height, 0.0
        ray_du = ray_dv = (0.0, 0.0, 0.0)
        du, dv = scaled(pixel, right), scaled(-pixel, up)
    else:
        tangent = 2.0 * math.tan(math.radians(camera.fov_degrees) / 2.0) / height
        ray_du, ray_dv = scaled(tangent, right), scaled(-tangent, up)
        du, dv = scaled(distance, ray_du), scaled(distance, ray_dv)
    every, unit = lattice.spacing, grid.smallest_edge
    return RayFrame(
        origin=np.array(origin),
        du=np.array(scaled(every, _lattice(of_grid, du))),
        dv=np.array(scaled(every, _lattice(of_grid, dv))),
        forward=np.array(_lattice(of_grid, scaled(unit, forward))),
        ray_du=np.array(_lattice(of_grid, scaled(unit * every, ray_du))),
        ray_dv=np.array(_lattice(of_grid, scaled(unit * every, ray_dv))),
        lens=(every * tangent, every * tangent),
        centre=(
            ((width - 1) / 2.0 - lattice.column) / every,
            ((height - 1) / 2.0 - lattice.row) / every,
        ),
        distance=distance / unit,
        unit=unit,
        pixel=lattice.covers / every,
    )


def _lattice(grid: GridFloats, vector: Triple) -> Triple:
    """The world ``vector`` in lattice units."""
    x, y, z = grid.linear
    return dot(x, vector), dot(y, vector), dot(z, vector)
