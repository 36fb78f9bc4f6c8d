"""[depth_cue]: colours fade with their distance from the eye."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, model_validator

from clvol.scene.camera import Camera
from clvol.scene.table import COLOR, Color, Fraction, Number, Table, wrong

if TYPE_CHECKING:
    from clvol.volume import Grid

_FARTHEST = 1e300
_DISTANCE = "a finite world distance from the eye"
_Distance = Annotated[Number, Field(ge=-_FARTHEST, le=_FARTHEST)]


class DepthCue(Table):
    """Colours fade between the world distances ``start`` and ``end`` from the eye.

    At ``end`` they have covered the share ``strength`` of the way to ``color``, which is in the colour space of the
    transfer function. ``start`` and ``end`` default to the distances of the volume's nearest and farthest corner.
    """

    start: _Distance | None = Field(
        None,
        title="World distance at which fading starts; by default the nearest corner of the volume.",
        description=_DISTANCE,
        examples=[200.0],
    )
    end: _Distance | None = Field(
        None,
        title="World distance at which fading is complete; by default the farthest corner of the volume.",
        description=_DISTANCE,
        examples=[400.0],
    )
    strength: Fraction = Field(
        1.0,
        title="How far colours have faded at the end; 1 is all the way.",
        description="a number from 0 to 1",
    )
    color: Color = Field(
        (0.0, 0.0, 0.0),
        title="Colour that distant parts fade to, in the colour space of the transfer function.",
        description=COLOR,
    )

    @classmethod
    def table_name(cls) -> str:
        return "depth_cue"

    @model_validator(mode="after")
    def _ends_after_its_start(self) -> DepthCue:
        if self.start is not None and self.end is not None and not self.start < self.end:
            raise wrong("end", self.end, f"a distance beyond the start, {self.start}")
        return self

    def complete(self, camera: Camera, grid: Grid) -> DepthCue:
        """A copy with start and end filled in; if that would leave no length between them, they are about one voxel
        edge apart.
        """
        distances = np.clip(corner_distances(camera, grid), -0.5 * _FARTHEST, 0.5 * _FARTHEST)
        start, end = self.start, self.end
        given = [abs(x) for x in (start, end) if x is not None]
        edge = max(grid.smallest_edge, 1e-6 * max([float(np.abs(distances).max()), *given]))
        if start is None:
            start = float(distances.min())
            start = start if end is None or start < end else end - edge
        if end is None:
            end = float(distances.max())
            end = end if start < end else start + edge
        return self.model_copy(update={"start": start, "end": end})


def corner_distances(camera: Camera, grid: Grid) -> np.ndarray:
    """World distances, float64 [8], of the domain's corners along rays.

    They are measured from the eye of a perspective camera, or from the plane through the position of an orthographic
    one (negative behind it).
    """
    offsets = grid.world_corners() - np.asarray(camera.position, np.float64)
    if camera.projection == "orthographic":
        return offsets @ camera.basis()[0]
    return np.linalg.norm(offsets, axis=1)
