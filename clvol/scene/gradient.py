"""[gradient]: how the field's derivative is found where something needs it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Table


class GradientSettings(Table):
    """``operator``: on voxels; the filters "cubic" and "catmull-rom" have an analytic derivative
    and use none. ``storage``: found once for all voxels, at each sample, or as is quicker."""

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
