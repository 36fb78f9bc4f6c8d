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
    ] = Field(
        "raycast",
        title="Rendering method: ray casting, blocks within a memory budget, adaptive sampling, or the exact integral.",
        description="'raycast', 'multiresolution', 'pyramid' or 'reference'",
    )
    step: Annotated[
        Number,
        Knob("step", "voxel edges", _STEPS, is_main=True, is_continuous=True, methods=_BY_STEPS),
    ] = Field(
        1.0, gt=0, le=1e6,
        title="Distance between samples along a ray, in edges of the smallest voxel.",
        description="a number greater than 0, at most 1e6",
    )
    classification: Annotated[
        Literal["pre", "post", "preintegrated"],
        Knob("classification", "", ("pre", "post", "preintegrated"), is_ladder=False),
    ] = Field(
        "preintegrated",
        title="Classify voxels, midpoints of segments, or whole segments (pre-integration).",
        description="'pre', 'post' or 'preintegrated'",
    )
    quadrature: Annotated[
        Literal["steps", "cells"], Knob("quadrature", "", ("steps", "cells"), is_ladder=False)
    ] = Field(
        "steps",
        title="Even steps along a ray, or one rule per voxel cell that the ray crosses.",
        description="'steps' or 'cells'",
    )
    filter: Annotated[
        Literal["nearest", "linear", "cubic", "catmull-rom"],
        Knob("filter", "", ("nearest", "linear", "cubic"), is_ladder=False),
    ] = Field(
        "linear",
        title="Interpolation between voxels; 'cubic' is a B-spline, which smooths.",
        description="'nearest', 'linear', 'cubic' or 'catmull-rom'",
    )
    prefilter: bool = Field(
        False,
        title="Makes the cubic B-spline interpolate the voxels instead of smoothing them.",
        description="true or false",
    )
    compositing: Literal["over", "maximum", "minimum", "average", "attenuated-maximum"] = Field(
        "over",
        title="Emission and absorption ('over'), or a projection of the values along each ray.",
        description="'over', 'maximum', 'minimum', 'average' or 'attenuated-maximum'",
    )
    attenuation: Number = Field(
        1.0, ge=0, le=1e6,
        title="How strongly 'attenuated-maximum' weakens what lies behind.",
        description="a number from 0 to 1e6",
    )
    early_termination: Annotated[
        Number, Knob("early termination", "transmittance", (0.1, 0.03, 0.01, 1e-3, 1e-4, 0.0))
    ] = Field(
        1e-3, ge=0, lt=1,
        title="Transmittance at which a ray may stop; 0 means never.",
        description="a transmittance from 0 to less than 1",
    )
    table_size: Whole = Field(
        256, ge=16, le=1024,
        title="Has no effect; accepted because earlier versions used lookup tables of this size.",
        description="a whole number from 16 to 1024",
    )
    voxel_precision: Annotated[
        Literal["stored", "uint16", "uint8"],
        Knob("voxel precision", "", _precisions, methods=("raycast",)),
    ] = Field(
        "stored",
        title="Type of the voxels while rendering: as stored, or quantised evenly over the value range.",
        description="'stored', 'uint16' or 'uint8'",
    )
    tolerance: Number = Field(
        1e-9, gt=0, lt=1,
        title="Error that the reference method aims at (linear, premultiplied).",
        description="a number between 0 and 1",
    )

    @classmethod
    def table_name(cls) -> str:
        return "integration"
