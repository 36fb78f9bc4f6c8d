"""[integration]: how light along a ray is integrated, and how exactly."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from clvol.scene.table import AsTuple, Number, Table, Whole, wrong

_BY_SEGMENTS = ("raycast",)  # one rule for all segments of a ray
_BY_STEPS = ("raycast", "multiresolution", "pyramid", "slicing")
_SHADED = ("raycast",)
_BY_SLICES = ("slicing",)  # methods that draw slices one over the other
_OF_BLOCKS = ("multiresolution",)  # methods whose volume is blocks, each at a resolution of its own


class Integration(Table):
    """How values along a ray are sampled, classified and composited.

    ``step`` is in units of the smallest voxel edge. Where the data are smooth the ray caster takes several steps at
    once, as long as the bound on what that adds to the error of a colour stays below ``step_error`` times the square
    of ``step`` per edge; 0 means even steps. ``compositing``: "over" integrates emission and absorption along
    the ray; the others show the "maximum", the "minimum" or the "average" of the values on it, or a maximum in which
    ``attenuation`` weakens what lies behind. ``prefilter`` makes the filter "cubic" interpolate the voxels.

    ``blend`` puts channels together. Each has a picture of its own, with all that the scene states, and light adds up
    ("additive", which may exceed white), is screened (1 - (1 - a)(1 - b) of each component) or is the "maximum" of each
    component; opacities are screened, or their maximum. "mix" is one medium: extinctions and emissions of all channels
    add up at every place, so that channels hide each other by depth.

    ``minification`` "levels": the volume at half its resolution, a quarter, and so on; a sample is a blend of the two
    between whose voxels' edges the side of a pixel lies where it is (Williams 1983), ``level_bias`` levels coarser.
    ``step`` is then in voxels of the finest of them.

    ``classification``: "auto" is "post" where that errs less than "preintegrated", which it is elsewhere.

    ``quadrature``: even "steps" along a ray, or "cells": one piece per cell of the linear filter that the ray crosses,
    cut into 1 / ``step`` parts (one, or an even number). ``early_termination`` is the transmittance at which a ray may
    stop; 0 means never. ``segments``: "pieces" integrates each segment in closed form; "integral-table" takes
    differences of integral functions, tabulated at ``table_size`` values, and leaves attenuation inside a segment out
    (Engel, Kraus and Ertl 2001, section 3.2): an approximation, for comparison. Otherwise ``table_size`` has no effect.
    ``tolerance`` is the error that the reference method aims
    at, in linear premultiplied colour. ``voxel_precision``: voxels are held as "stored" while rendering, or quantised
    evenly over the volume's range.
    """

    method: Literal["raycast", "multiresolution", "pyramid", "slicing", "reference"] = Field(
        "raycast",
        title="Ray casting, blocks within a memory budget, adaptive sampling, slices, or the exact integral.",
        description="'raycast', 'multiresolution', 'pyramid', 'slicing' or 'reference'",
    )
    step: Number = Field(
        1.0, gt=0, le=1e6,
        title="Distance between samples along a ray, in edges of the smallest voxel.",
        description="a number greater than 0, at most 1e6",
    )
    step_error: Number = Field(
        1e-3, ge=0, le=1,
        title="Error that segments of several steps may add per voxel edge, at steps of one edge; 0: even steps.",
        description="a number from 0 to 1 (linear, premultiplied)",
    )
    classification: Literal["auto", "pre", "post", "preintegrated"] = Field(
        "auto",
        title="Classify voxels, midpoints of segments, or whole segments (pre-integration); 'auto' takes what suits.",
        description="'auto', 'pre', 'post' or 'preintegrated'",
    )
    segments: Literal["pieces", "integral-table"] = Field(
        "pieces",
        title="Pre-integrated segments in closed form, or by tables of integral functions without attenuation inside.",
        description="'pieces' or 'integral-table'",
    )
    quadrature: Literal["steps", "cells"] = Field(
        "steps",
        title="Even steps along a ray, or one rule per voxel cell that the ray crosses.",
        description="'steps' or 'cells'",
    )
    filter: Literal[
        "nearest", "linear", "cubic", "catmull-rom", "mitchell", "lanczos2", "lanczos3", "windowed-sinc", "table"
    ] = Field(
        "linear",
        title="Interpolation between voxels; 'cubic' is a B-spline, which smooths; 'table' is filter_table.",
        description="'nearest', 'linear', 'cubic', 'catmull-rom', 'mitchell', 'lanczos2', 'lanczos3', "
        "'windowed-sinc' or 'table'",
    )
    filter_table: Annotated[tuple[Number, ...], AsTuple] | None = Field(
        None,
        title="Weights of the filter 'table' at even distances, from 0 to filter_reach; a spline goes through them.",
        description="4 to 4096 numbers, of which the first is above 0 and the last is 0",
        examples=[[1.0, 0.5, 0.0, 0.0]],
    )
    filter_reach: Number = Field(
        2.0, ge=1, le=3,
        title="Distance in voxels at which filter_table ends.",
        description="a number from 1 to 3",
    )
    prefilter: bool = Field(
        False,
        title="Makes the cubic B-spline interpolate the voxels instead of smoothing them.",
        description="true or false",
    )
    minification: Literal["off", "levels"] = Field(
        "off",
        title="Samples of means of voxels where a pixel covers several ('levels'), or always of the voxels themselves.",
        description="'off' or 'levels'",
    )
    level_bias: Number = Field(
        -1.0, ge=-4, le=4,
        title="Added to the level that a pixel's size asks for; below 0: finer ones. Without levels it has no effect.",
        description="a number from -4 to 4",
    )
    compositing: Literal["over", "maximum", "minimum", "average", "attenuated-maximum"] = Field(
        "over",
        title="Emission and absorption ('over'), or a projection of the values along each ray.",
        description="'over', 'maximum', 'minimum', 'average' or 'attenuated-maximum'",
    )
    blend: Literal["additive", "screen", "maximum", "mix"] = Field(
        "additive",
        title="How [[channel]]s are put together: their pictures added, or blended, or all as one medium ('mix').",
        description="'additive', 'screen', 'maximum' or 'mix'",
    )
    attenuation: Number = Field(
        1.0, ge=0, le=1e6,
        title="How strongly 'attenuated-maximum' weakens what lies behind.",
        description="a number from 0 to 1e6",
    )
    early_termination: Number = Field(
        1e-3, ge=0, lt=1,
        title="Transmittance at which a ray may stop; 0 means never.",
        description="a transmittance from 0 to less than 1",
    )
    table_size: Whole = Field(
        256, ge=16, le=1024,
        title="Entries of the tables of segments = 'integral-table'; without these it has no effect.",
        description="a whole number from 16 to 1024",
    )
    voxel_precision: Literal["stored", "uint16", "uint8"] = Field(
        "stored",
        title="Type of the voxels while rendering: as stored, or quantised evenly over the value range.",
        description="'stored', 'uint16' or 'uint8'",
    )
    tolerance: Number = Field(
        1e-9, gt=0, lt=1,
        title="Error that the reference method aims at (linear, premultiplied).",
        description="a number between 0 and 1",
    )

    @property
    def takes_steps(self) -> bool:
        """Whether ``step`` has an effect; it has none on the exact integral."""
        return self.method in _BY_STEPS

    @property
    def takes_midpoints(self) -> bool:
        """Whether the method may classify the values in the middle of segments where the scene leaves the choice."""
        return self.method in _BY_SEGMENTS and self.quadrature == "steps" and self.compositing == "over"

    @property
    def shades(self) -> bool:
        """Whether lights and all filters can be rendered; some methods and quadratures have emission and absorption
        alone."""
        return self.method in _SHADED and self.quadrature == "steps"

    @property
    def draws_slices(self) -> bool:
        """Whether the method draws slices one over the other, as [slicing] says."""
        return self.method in _BY_SLICES

    @property
    def reads_blocks(self) -> bool:
        """Whether the method samples blocks, each at a resolution of its own."""
        return self.method in _OF_BLOCKS

    @classmethod
    def table_name(cls) -> str:
        return "integration"

    @model_validator(mode="after")
    def _has_the_table_of_its_filter(self) -> Integration:
        table = self.filter_table
        if self.filter != "table":
            if table is not None:
                raise wrong("filter_table", list(table), f"no filter_table for the filter {self.filter!r}")
            return self
        if table is None or not 4 <= len(table) <= 4096 or table[0] <= 0 or table[-1] != 0:
            expected = "4 to 4096 numbers, of which the first is above 0 and the last is 0, for the filter 'table'"
            raise wrong("filter_table", None if table is None else list(table), expected)
        return self
