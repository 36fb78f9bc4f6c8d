"""Structs shared with the kernels, each declared once here and checked on the device.

Every field is 16 bytes wide, or all are together, so that numpy and any OpenCL compiler lay them
out alike.
"""

from __future__ import annotations

import numpy as np

_FLOAT4_BEFORE = (
    "plane_origin", "plane_du", "plane_dv", "ray_forward", "ray_du", "ray_dv", "lens", "march",
    "upper", "classes", "gate", "voxel",
)  # fmt: skip
_INT4 = ("size", "stride", "cells", "image", "band", "table", "pieces")


def view_dtype(voxel_bits: int) -> np.dtype:
    """``View`` of cl/view.h, for volumes of ``voxel_bits`` (8, 16, 32 or 64)."""
    double = ("f8", 2) if voxel_bits == 64 else ("f4", 4)
    return np.dtype(
        [(name, "f4", 4) for name in _FLOAT4_BEFORE]
        + [("voxel_double", *double)]
        + [(name, "i4", 4) for name in _INT4]
    )


BLOCKS = np.dtype([("count", "i4", 4), ("edge", "f4", 4)])
"""``Blocks`` of cl/block_parameters.h."""

MOST_HALVES = 16  # MOST_HALVES
PYRAMID = np.dtype(
    [
        ("levels", "i4", 4), ("cells", "i4", 4), ("free_cells", "i4", 4), ("spacing", "f4", 4), ("edges", "f4", 4),
        ("oracle", "f4", 4), ("gate", "f4", 4), ("halves", "f4", (MOST_HALVES, 4)),
    ]
)  # fmt: skip
"""``Pyramid`` of cl/pyramid.h."""

_EFFECTS_FLOAT4 = (
    "local_x", "local_y", "local_z", "gradient_x", "gradient_y", "gradient_z", "gradient_scale",
    "material", "shading", "depth_cue", "depth_color", "projection", "shadow", "light_grid",
    "environment", "value_bounds", "noise_reach",
)  # fmt: skip
_EFFECTS_INT4 = (
    "counts", "first", "light_size", "maps", "map_offsets", "factors", "factor_offsets", "fields",
)  # fmt: skip
MOST_FIELDS = 3
_FIELD_FLOAT4 = ("field_x", "field_y", "field_z", "field_map")
_FIELD_INT4 = ("field_size", "field_at")

MOST_NOISE_TERMS = 4  # NOISE_TERMS
NOISE_TERM = np.dtype(
    [("scale", "f4", 4), ("offset", "f4", 4), ("amplitude", "f4", 4), ("shape", "i4", 4)]
)
"""``NoiseTerm`` of cl/noise.h."""

BLOCK_PAYLOAD = np.dtype([("from", "i4"), ("to", "i4"), ("size", "i4"), ("codec", "i4")])
"""``BlockPayload`` of cl/decode_blocks.cl."""


def effects_dtype() -> np.dtype:
    """``Effects`` of cl/effects.h."""
    return np.dtype(
        [(name, "f4", 4) for name in _EFFECTS_FLOAT4]
        + [(name, "i4", 4) for name in _EFFECTS_INT4]
        + [(name, "f4", (MOST_FIELDS, 4)) for name in _FIELD_FLOAT4]
        + [(name, "i4", (MOST_FIELDS, 4)) for name in _FIELD_INT4]
        + [("noise_counts", "i4", 4), ("noise_terms", NOISE_TERM, MOST_NOISE_TERMS)]
    )
