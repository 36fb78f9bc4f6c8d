"""[gradient]: how the field's derivative is computed where something needs it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Table


class GradientSettings(Table):
    """How gradients are computed, and where.

    ``operator`` is the finite difference of voxels for the filters "nearest" and "linear"; "cubic" and "catmull-rom"
    are differentiated analytically. ``storage``: gradients are computed once per voxel ("precomputed"), at each sample
    ("on-the-fly"), or whichever is faster ("auto").
    """

    operator: Literal["central", "sobel"] = Field(
        "central",
        title="Finite differences for the filters 'nearest' and 'linear'; cubic filters are differentiated exactly.",
        description="'central' or 'sobel'",
    )
    storage: Literal["auto", "precomputed", "on-the-fly"] = Field(
        "auto",
        title="Whether gradients are stored per voxel (4 bytes each) or computed per sample.",
        description="'auto', 'precomputed' or 'on-the-fly'",
    )

    @classmethod
    def table_name(cls) -> str:
        return "gradient"
