"""[slicing]: settings of the method of that name."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Table, Whole

MOST_SLICES = 2**20


class Slicing(Table):
    """Slices of the volume drawn one over the other, as textures are (Engel and Ertl 2002, section 4).

    ``geometry`` is the shape of the slices. "object-aligned": planes of voxels, of the stack that faces the view most;
    "object-aligned-interpolated": such planes at any distance, interpolated between those of voxels; "view-aligned":
    planes parallel to the picture; "shells": spheres around the eye; "half-angle": planes between light and view,
    which the light that casts shadows goes through, slice by slice, as the eye does (Kniss et al. 2003). ``light_at``
    is where in such a slice its light is taken: in the middle, behind half of what the slice absorbs, or at its front,
    as they do. ``slices`` is their number from one end of the volume to the other; None: all planes of voxels, or
    ``integration.step`` apart. ``accumulate`` is the precision that a pixel is kept in between slices. With
    ``opacity_correction`` a slice counts for as much of the ray as lies between slices; without, for the slices'
    distance, whatever the angle.
    """

    geometry: Literal["object-aligned", "object-aligned-interpolated", "view-aligned", "shells", "half-angle"] = Field(
        "view-aligned",
        title="Planes of voxels, or these interpolated; planes across the view, spheres, or planes swept by light.",
        description="'object-aligned', 'object-aligned-interpolated', 'view-aligned', 'shells' or 'half-angle'",
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

    light_at: Literal["middle", "front"] = Field(
        "middle",
        title="Where in a slice of the geometry 'half-angle' its light is taken.",
        description="'middle' or 'front'",
    )

    @property
    def is_half_angle(self) -> bool:
        """Whether slices are swept by the light, too."""
        return self.geometry == "half-angle"

    @classmethod
    def table_name(cls) -> str:
        return "slicing"
