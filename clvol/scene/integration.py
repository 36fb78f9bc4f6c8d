"""[integration]: how the light along a ray is summed, and how exactly."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from clvol.scene.table import Number, Table, Whole


class Integration(Table):
    """``step`` is in units of the smallest voxel edge.

    ``early_termination``: a ray may stop at this transmittance; 0 means never. ``table_size``:
    entries an axis of the pre-integration table. ``tolerance``: the error that the reference
    method aims at, in linear premultiplied colour.
    """

    method: Literal["raycast", "multiresolution", "pyramid", "reference"] = Field(
        "raycast", description="'raycast', 'multiresolution', 'pyramid' or 'reference'"
    )
    step: Number = Field(1.0, gt=0, le=1e6, description="a number greater than 0, at most 1e6")
    classification: Literal["pre", "post", "preintegrated"] = Field(
        "preintegrated", description="'pre', 'post' or 'preintegrated'"
    )
    filter: Literal["nearest", "linear", "cubic"] = Field(
        "linear", description="'nearest', 'linear' or 'cubic'"
    )
    early_termination: Number = Field(
        1e-3, ge=0, lt=1, description="a transmittance from 0 to less than 1"
    )
    table_size: Whole = Field(
        256, ge=16, le=1024, description="a whole number from 16 to 1024"
    )
    tolerance: Number = Field(1e-9, gt=0, lt=1, description="a number between 0 and 1")

    @classmethod
    def table_name(cls) -> str:
        return "integration"
