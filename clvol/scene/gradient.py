"""[gradient]: how the field's derivative is found where something needs it."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Table


class GradientSettings(Table):
    """``operator``: on voxels; the filters "cubic" and "catmull-rom" have an analytic derivative
    and use none. ``storage``: found once for all voxels, at each sample, or as is quicker."""

    operator: Literal["central", "sobel"] = Field("central", description="'central' or 'sobel'")
    storage: Literal["auto", "precomputed", "on-the-fly"] = Field(
        "auto", description="'auto', 'precomputed' or 'on-the-fly'"
    )

    @classmethod
    def table_name(cls) -> str:
        return "gradient"
