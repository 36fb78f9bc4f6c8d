"""[integration]: how the light along a ray is summed, and how exactly."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from clvol.scene.knob import Knob
from clvol.scene.table import Number, Table, Whole

_STEPS = tuple(2.0 ** (k / 2) for k in range(6, -11, -1))  # 8 ... 1/32
_BY_STEPS = ("raycast", "multiresolution", "pyramid")


def _precisions(scene: Any) -> tuple[str, ...]:
    """What takes less memory than the volume as it is."""
    volume = scene.volume
    smaller = [k for k, size in (("uint8", 1), ("uint16", 2)) if size < volume.dtype.itemsize]
    if volume.nan_count or volume.inf_count:  # integers hold neither
        smaller = []
    return (*smaller, "stored")


class Integration(Table):
    """``step`` is in units of the smallest voxel edge.

    ``compositing``: "over" is emission and absorption along the ray; the others show the "maximum", the
    "minimum" or the "average" of the values on it, or the maximum where ``attenuation`` makes what
    lies behind count less. ``prefilter``: of the filter "cubic" alone, which then meets the voxels.

    ``quadrature``: even "steps" along a ray, or "cells": pieces from one cell of the linear filter to the
    next, each cut into as many parts as ``step`` goes into 1: one, or an even number.
    ``early_termination``: a ray may stop at this transmittance; 0 means never. ``table_size``
    changes nothing any more: segments were once looked up in a table of so many entries an axis, and are
    integrated in closed form now. ``tolerance``: the error that the reference method aims at, in linear premultiplied colour. ``voxel_precision``: what voxels are held as
    while rendering, "stored" as they are, or quantised evenly over the volume's range.
    """

    method: Annotated[
        Literal["raycast", "multiresolution", "pyramid", "reference"],
        Knob("method", "", ("raycast", "multiresolution", "pyramid"), is_ladder=False),
    ] = Field("raycast", description="'raycast', 'multiresolution', 'pyramid' or 'reference'")
    step: Annotated[
        Number,
        Knob("step", "voxel edges", _STEPS, is_main=True, is_continuous=True, methods=_BY_STEPS),
    ] = Field(1.0, gt=0, le=1e6, description="a number greater than 0, at most 1e6")
    classification: Annotated[
        Literal["pre", "post", "preintegrated"],
        Knob("classification", "", ("pre", "post", "preintegrated"), is_ladder=False),
    ] = Field("preintegrated", description="'pre', 'post' or 'preintegrated'")
    quadrature: Annotated[
        Literal["steps", "cells"], Knob("quadrature", "", ("steps", "cells"), is_ladder=False)
    ] = Field("steps", description="'steps' or 'cells'")
    filter: Annotated[
        Literal["nearest", "linear", "cubic", "catmull-rom"],
        Knob("filter", "", ("nearest", "linear", "cubic"), is_ladder=False),
    ] = Field("linear", description="'nearest', 'linear', 'cubic' or 'catmull-rom'")
    prefilter: bool = Field(False, description="true or false")
    compositing: Literal["over", "maximum", "minimum", "average", "attenuated-maximum"] = Field(
        "over", description="'over', 'maximum', 'minimum', 'average' or 'attenuated-maximum'"
    )
    attenuation: Number = Field(1.0, ge=0, le=1e6, description="a number from 0 to 1e6")
    early_termination: Annotated[
        Number, Knob("early termination", "transmittance", (0.1, 0.03, 0.01, 1e-3, 1e-4, 0.0))
    ] = Field(1e-3, ge=0, lt=1, description="a transmittance from 0 to less than 1")
    table_size: Whole = Field(256, ge=16, le=1024, description="a whole number from 16 to 1024")
    voxel_precision: Annotated[
        Literal["stored", "uint16", "uint8"],
        Knob("voxel precision", "", _precisions, methods=("raycast",)),
    ] = Field("stored", description="'stored', 'uint16' or 'uint8'")
    tolerance: Number = Field(1e-9, gt=0, lt=1, description="a number between 0 and 1")

    @property
    def takes_steps(self) -> bool:
        """Whether ``step`` counts: not for the exact integral."""
        return self.method in _BY_STEPS

    @classmethod
    def table_name(cls) -> str:
        return "integration"
