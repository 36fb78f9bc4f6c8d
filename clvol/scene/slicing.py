"""[slicing]: settings of the method of that name."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Table, Whole

MOST_SLICES = 2**20


class Slicing(Table):
    """Slices of the volume drawn one over the other, as textures are (Kraus 2003, section 4).

    ``geometry`` is the shape of the slices. "object-aligned": planes of voxels, of the stack that faces the view most;
    "object-aligned-interpolated": such planes at any distance, interpolated between those of voxels; "view-aligned":
    planes parallel to the picture; "shells": spheres around the eye. ``slices`` is their number from one end of the
    volume to the other; None: all planes of voxels, or ``integration.step`` apart. ``accumulate`` is the precision
    that a pixel is kept in between slices. With ``opacity_correction`` a slice counts for as much of the ray as lies
    between slices; without, for the slices' distance, whatever the angle.
    """

    geometry: Literal["object-aligned", "object-aligned-interpolated", "view-aligned", "shells"] = Field(
        "view-aligned",
        title="Planes of voxels, such planes interpolated, planes parallel to the picture, or spheres around the eye.",
        description="'object-aligned', 'object-aligned-interpolated', 'view-aligned' or 'shells'",
    )
    slices: Whole | None = Field(
        None, ge=2, le=MOST_SLICES,
        title="Number of slices; without it, all planes of voxels, or slices a step apart.",
        description=f"a whole number from 2 to {MOST_SLICES}",
        examples=[256],
    )
    accumulate: Literal["float32", "half", "uint8"] = Field(
        "float32",
        title="Precision of a pixel between one slice and the next.",
        description="'float32', 'half' or 'uint8'",
    )
    opacity_correction: bool = Field(
        True,
        title="Whether a slice's opacity is that of the ray between two slices, or of the slices' distance.",
        description="true or false",
    )

    @classmethod
    def table_name(cls) -> str:
        return "slicing"
