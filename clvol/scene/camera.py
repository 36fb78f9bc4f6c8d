"""[camera]: where the picture is taken from, and the rays through its pixels."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field, model_validator

from clvol.choice.view import View, axes_of, is_view, named_view
from clvol.errors import SceneError
from clvol.scene.image import ImageSettings
from clvol.scene.table import Length, Number, Table, Vector, wrong
from clvol.volume.triples import Triple, cross, difference, norm, scaled, triple, unit

if TYPE_CHECKING:
    from clvol.volume import Grid

DEFAULT_FOV_DEGREES = 30.0
_DEFAULT_TOWARDS_EYE = (0.55, 0.35, 0.76)  # from the target: a little from the right and above
_MARGIN = 1.05
_PARALLEL = 1e-6  # sine of the angle below which two directions count as parallel


class Camera(Table):
    """A perspective or orthographic view; lengths in world units.

    ``complete`` fills in what is left out: the target is the volume's centre, the whole volume is visible from the
    position, ``up`` is y (z where the view is along y), and the ``height`` of an orthographic view shows the whole
    volume. A perspective view ignores ``height``, an
    orthographic one ``fov_degrees``, so that switching the projection takes one key.
    """

    projection: Literal["perspective", "orthographic"] = Field(
        "perspective",
        title="Kind of projection.",
        description="'perspective' or 'orthographic'",
    )
    position: Vector | None = Field(
        None,
        title="Position of the eye in world units; by default the whole volume is in view.",
        description="three finite numbers [x, y, z]",
        examples=[[600.0, 300.0, 500.0]],
    )
    target: Vector | None = Field(
        None,
        title="World point that the camera looks at; by default the centre of the volume.",
        description="three finite numbers [x, y, z]",
        examples=[[127.5, 127.5, 63.5]],
    )
    up: Vector | None = Field(
        None,
        title="World direction that points up in the picture; by default y, or z where the view is along y.",
        description="three finite numbers [x, y, z], not all 0",
        examples=[[0.0, 1.0, 0.0]],
    )
    fov_degrees: Number = Field(
        DEFAULT_FOV_DEGREES, gt=0, lt=180,
        title="Vertical field of view of a perspective camera, in degrees; ignored by an orthographic one.",
        description="a vertical angle greater than 0 and less than 180",
    )
    height: Length | None = Field(
        None,
        title="Height of an orthographic view in world units; by default the whole volume is in view.",
        description="a finite world length greater than 0",
        examples=[250.0],
    )

    view: str | None = Field(
        None,
        title="Side that the volume is seen from, in place of a position; left and right are the patient's.",
        description="'front', 'back', 'left', 'right', 'top', 'bottom', or up to three that meet, as in 'front-left'",
        examples=["front-left"],
    )

    @classmethod
    def table_name(cls) -> str:
        return "camera"

    @model_validator(mode="after")
    def _not_degenerate(self) -> Camera:
        if self.up is not None and not any(self.up):
            raise wrong("up", list(self.up), "a vector that is not 0")
        if self.view is not None:
            if not is_view(self.view):
                expected = "'front', 'back', 'left', 'right', 'top', 'bottom', or up to three that meet: 'front-left'"
                raise wrong("view", self.view, expected)
            if self.position is not None:
                raise wrong("view", self.view, "either a view or a position")
        if self.position is None or self.target is None:
            return self
        forward = unit(difference(triple(self.target), triple(self.position)))
        if not any(forward):
            raise wrong("position", list(self.position), "a position apart from the target")
        if self.up is not None and _parallel(forward, unit(triple(self.up))):
            raise wrong("up", list(self.up), "a vector that is not parallel to the view")
        return self

    @classmethod
    def default(cls, grid: Grid, image: ImageSettings) -> Camera:
        """A perspective view of 30 degrees with the whole volume in the picture."""
        return cls().complete(grid, image)

    def complete(
        self,
        grid: Grid,
        image: ImageSettings,
        where: str = "scene",
        frame: str = "index",
        chosen: View | None = None,
    ) -> Camera:
        """A copy with everything that was left out filled in so that the whole of ``grid`` is shown.

        ``frame``: that of the volume, for a named view. ``chosen``: a view of the object in the volume, which decides
        what the camera leaves out; its points are in the picture, in place of the whole of ``grid``.

        Raises SceneError, whose ``where`` begins with ``where``, if the result would be degenerate.
        """
        if self.view is not None or chosen is not None:
            return self._directed(grid, image, where, frame, chosen)
        return self._completed(np.asarray(grid.world_corners(), dtype=np.float64), image, where)

    def _directed(
        self, grid: Grid, image: ImageSettings, where: str, frame: str, chosen: View | None
    ) -> Camera:
        """``complete`` where a view, named or chosen, decides on the direction and on what is up."""
        corners = np.asarray(grid.world_corners() if chosen is None else chosen.points, dtype=np.float64)
        up = self.up
        if self.view is not None:
            towards_eye, side_up = named_view(self.view, axes_of(frame) if chosen is None else chosen.axes)
        else:
            assert chosen is not None
            towards_eye, side_up = chosen.towards_eye, chosen.up
        if self.position is not None:
            target = 0.5 * (corners.min(axis=0) + corners.max(axis=0)) if self.target is None else self.target
            towards_eye = np.array(unit(difference(triple(self.position), triple(target))))
        if up is None and not _parallel(unit(triple(towards_eye)), unit(triple(side_up))):
            up = triple(side_up)
        return self.model_copy(update={"up": up, "view": None})._completed(corners, image, where, towards_eye)

    def _completed(
        self, corners: np.ndarray, image: ImageSettings, where: str, towards_eye: Iterable[float] = _DEFAULT_TOWARDS_EYE
    ) -> Camera:
        """``complete`` with the world positions ``corners`` [n, 3] in view, from the direction ``towards_eye``."""
        centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        target = centre if self.target is None else np.array(self.target)
        if self.position is None:
            forward = scaled(-1.0, unit(triple(towards_eye)))
        else:
            forward = unit(triple(target - self.position))
            if not any(forward):
                expected = "a position apart from the target, by default the volume's centre"
                got = f"got {list(self.position)}"
                raise SceneError(f"{where}: camera.position", got, expected)
        up = self.up
        if up is None:
            along_y = _parallel(forward, (0.0, 1.0, 0.0))
            up = (0.0, 0.0, 1.0) if along_y else (0.0, 1.0, 0.0)
        elif _parallel(forward, unit(triple(up))):
            expected = "a vector that is not parallel to the view"
            raise SceneError(f"{where}: camera.up", f"got {list(up)}", expected)

        axes = np.array(_frame(forward, unit(triple(up))))
        aspect = image.width / image.height
        if self.position is None:
            ahead, right, above = axes @ (corners - target).T
            half = math.tan(math.radians(self.fov_degrees) / 2)
            needed = np.maximum(np.abs(above), np.abs(right) / aspect) / half - ahead
            radius = np.linalg.norm(corners - target, axis=1).max()
            position = target - _MARGIN * max(needed.max(), radius) * axes[0]
        else:
            position = np.array(self.position)
        height = self.height
        if height is None and self.projection == "orthographic":
            _, right, above = axes @ (corners - position).T
            height = 2 * _MARGIN * float(np.maximum(np.abs(above), np.abs(right) / aspect).max())
        return Camera(
            projection=self.projection,
            position=tuple(position.tolist()),
            target=tuple(target.tolist()),
            up=up,
            fov_degrees=self.fov_degrees,
            height=height,
        )

    def axes(self) -> tuple[Triple, Triple, Triple]:
        """(forward, right, up): three orthonormal vectors in world axes, as floats.

        Raises SceneError if position, target or up have not been filled in.
        """
        eye, target, up = self.eye(), self._filled_in("target"), self._filled_in("up")
        return _frame(unit(difference(target, eye)), unit(up))

    def eye(self) -> Triple:
        """``position`` as floats; SceneError if it has not been filled in."""
        return self._filled_in("position")

    def _filled_in(self, name: str) -> Triple:
        vector = getattr(self, name)
        if vector is None:
            expected = "a value; Camera.complete(grid, image) fills it in"
            raise SceneError(f"scene: camera.{name}", "missing", expected)
        return triple(vector)

    def basis(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As ``axes``, as float64 arrays [3]."""
        forward, right, up = self.axes()
        return np.array(forward), np.array(right), np.array(up)

    def height_of_view(self) -> float:
        """The height of an orthographic view in world units; SceneError if it has not been filled in."""
        if self.height is None:
            expected = "a value; Camera.complete(grid, image) fills it in"
            raise SceneError("scene: camera.height", "missing", expected)
        return self.height

    def world_rays(self, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Origins and unit directions, both float64 [height, width, 3], through pixel centres.

        Row 0 is on top. Perspective rays start at ``position``, orthographic ones on the plane
        through ``position``. Pixels are square: ``fov_degrees`` or ``height`` spans the rows.
        """
        return self.world_rays_at(width, height, np.arange(height), np.arange(width))

    def world_rays_at(
        self, width: int, height: int, rows: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As ``world_rays``, for the pixels at the crossings of ``rows`` [k] and ``columns`` [l]: [k, l, 3]."""
        return self.world_rays_of(width, height, np.asarray(rows)[:, None], np.asarray(columns)[None, :])

    def world_rays_of(
        self, width: int, height: int, rows: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As ``world_rays``, for the pixels (``rows``, ``columns``), which broadcast to one shape: [..., 3]."""
        forward, right, up = self.basis()
        x = ((np.asarray(columns) + 0.5) / width * 2 - 1) * (width / height)
        y = 1 - (np.asarray(rows) + 0.5) / height * 2
        across = x[..., None] * right + y[..., None] * up
        if self.projection == "orthographic":
            origins = np.asarray(self.position) + 0.5 * self.height_of_view() * across
            return origins, np.broadcast_to(forward, origins.shape).copy()
        directions = forward + math.tan(math.radians(self.fov_degrees) / 2) * across
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(np.array(self.position), directions.shape).copy(), directions



def _parallel(a: Triple, b: Triple) -> bool:
    return norm(cross(a, b)) < _PARALLEL


def _frame(forward: Triple, up: Triple) -> tuple[Triple, Triple, Triple]:
    right = unit(cross(forward, up))
    return forward, right, cross(right, forward)
