"""Structs shared with the kernels, each declared once here.

clvol/opencl/struct_check.py compares them with the device's.

``struct`` lays fields out as OpenCL C does. The header named beside each struct explains its fields.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from clvol.store.codecs.coded_blocks import MOST_STAGES
from clvol.volume.level_layout import MOST_VOLUME_LEVELS

# Lengths of arrays in structs, as in cl/features.h: how many of each a scene may have.
MOST_FIELDS, MOST_NOISE_TERMS, MOST_HALVES, MOST_FILTER_TERMS = 8, 4, 16, 9

_TYPES = {
    "float": np.dtype("f4"), "float2": np.dtype(("f4", 2)), "float4": np.dtype(("f4", 4)),
    "int": np.dtype("i4"), "int2": np.dtype(("i4", 2)), "int4": np.dtype(("i4", 4)),
    "double": np.dtype("f8"), "long": np.dtype("i8"),
}  # fmt: skip

FieldType = str | np.dtype


def struct(*groups: tuple[FieldType, str] | tuple[FieldType, str, int]) -> np.dtype:
    """A struct of OpenCL C as a numpy dtype.

    ``groups``: fields as (type, "names of fields") or (type, name, length of the array).
    Each field is at the next multiple of its alignment: vectors are aligned to their size, structs to their widest
    field. The size is a multiple of the widest alignment. ValueError for an unknown type.
    """
    names, formats, offsets = [], [], []
    end, widest = 0, 1
    for kind, called, *length in groups:
        if isinstance(kind, str) and kind not in _TYPES:
            raise ValueError(f"type {kind!r} of {called!r}")
        dtype = _TYPES[kind] if isinstance(kind, str) else kind
        alignment = _alignment(dtype)
        widest = max(widest, alignment)
        field = np.dtype((dtype, (length[0],))) if length else dtype
        for name in called.split():
            start = -(-end // alignment) * alignment
            names.append(name)
            formats.append(field)
            offsets.append(start)
            end = start + field.itemsize
    size = -(-end // widest) * widest
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


def _alignment(dtype: np.dtype) -> int:
    """Alignment in bytes of a scalar, a vector of two or four, or a struct."""
    if dtype.fields is None:
        return dtype.itemsize
    return max(_element_alignment(field[0]) for field in dtype.fields.values())


def _element_alignment(dtype: np.dtype) -> int:
    """Alignment of a struct's field, which may be an array of vectors or of structs, but not of scalars."""
    if dtype.base.fields is not None:
        return _alignment(dtype.base)
    return dtype.base.itemsize * (dtype.shape[-1] if dtype.shape else 1)


@lru_cache
def view_dtype(voxel_bits: int) -> np.dtype:
    """``View`` of cl/view.h, for volumes of ``voxel_bits`` (8, 16, 32 or 64)."""
    doubles: tuple[Any, ...] = (("double", "voxel_bias_double voxel_gain_double"),) if voxel_bits == 64 else ()
    return struct(
        ("float4", "plane_origin plane_du plane_dv ray_forward ray_du ray_dv upper"),
        ("float4", "shows_above shows_below opacity_terms opacity_more"),
        ("float4", "filter_terms", MOST_FILTER_TERMS),
        ("float4", "level_scales", MOST_VOLUME_LEVELS),
        ("int4", "level_sizes", MOST_VOLUME_LEVELS),
        ("float4", "footprint"),
        ("int4", "size cells"),
        ("float4", "owned_from owned_to"),
        ("int4", "stored_from stored_to"),
        *doubles,
        ("float2", "tangent centre footprints"),
        ("int2", "image tile lattice"),
        ("int", "ray_spacing"),
        ("float", "ray_tolerance"),
        ("int", "first_tile"),
        ("float", "step plane_distance stop_opacity deepest edge_length"),
        ("float", "first_value nodes_per_value last_node warp_bins"),
        ("float", "gate_low gate_high step_units opacity_limit voxel_gain zero"),
        ("int", "cell_shift cell_parts row_stride slice_stride piece_columns piece_count function_floats"),
        ("int", "octant_cells"),
    )


BLOCKS = struct(("int4", "count"), ("float", "edge inverse_edge"), ("int", "log_edge"))
"""``Blocks`` of cl/block_parameters.h."""

BLOCK_PAYLOAD = struct(("int", "from to size codec"))
"""``BlockPayload`` of cl/decode_blocks.cl."""

CODED_BLOCK = struct(("int4", "extent"), ("long", "from to"), ("int", "limit"))
"""``CodedBlock`` of cl/decode_codes.h."""

CODE_MAP = struct(
    ("int4", "shifts", MOST_STAGES // 4), ("int", "stages residual_step low span first unit"), ("float", "scale")
)
"""``CodeMap`` of cl/decode_codes.h."""

PYRAMID = struct(
    ("float4", "halves", MOST_HALVES),
    ("float4", "oracle edges"),
    ("int4", "cells free_cells"),
    ("int", "cell_shift free_shift levels oversampling half_count"),
    ("float", "ray_spacing spacing_growth gate_low gate_high"),
)
"""``Pyramid`` of cl/pyramid.h."""

SLICES = struct(("float", "first spacing thickness"), ("int", "axis count"))
"""``Slices`` of cl/slices.h."""

HALF_ANGLE = struct(
    ("float4", "across light_x light_y light_w"), ("int4", "size"), ("float", "own_share texels"), ("int", "is_point")
)
"""``HalfAngle`` of cl/half_angle.h."""

NOISE_TERM = struct(
    ("float4", "scale offset amplitude"),
    ("float", "value_amplitude gain"),
    ("int", "octaves first_texel"),
)
"""``NoiseTerm`` of cl/noise.h."""

FIELD = struct(
    ("float4", "x y z lower upper"),
    ("int4", "size"),
    ("int", "role first_voxel table piece_columns piece_count has_pole"),
    ("float", "edge_units threshold side"),
)
"""``Field`` of cl/effects.h."""

EFFECTS = struct(
    ("float4", "local_x local_y local_z gradient_x gradient_y gradient_z"),
    ("float4", "gradient_scale cue_color light_grid occlusion_grid noise_reach"),
    ("int4", "light_size occlusion_size"),
    (FIELD, "fields", MOST_FIELDS),
    (NOISE_TERM, "noise_terms", MOST_NOISE_TERMS),
    ("int", "along_axes"),
    ("float", "ambient diffuse specular shininess fade"),
    ("int", "two_sided"),
    ("float", "cue_start cue_per_edge cue_strength"),
    ("float", "lowest_value values_per_range attenuation hidden_score lowest_sample highest_sample"),
    ("float", "shadow_bound shadow_step shadow_depth scattering"),
    ("int", "light_count surface_count kept_clips removed_clips mesh_clips first_light first_surface first_clip"),
    ("int", "diffuse_map_size specular_map_size sky_map_size diffuse_map specular_map sky_map"),
    ("int", "gradient_opacity_points directional_opacity_points layer_count layer_rows"),
    ("int", "gradient_opacity_table directional_opacity_table layer_table"),
    ("int", "field_count added_terms moving_terms tinting_terms fur_terms"),
    ("int", "glow_points glow_table index_points index_table"),
    ("float", "longest_path"),
)
"""``Effects`` of cl/effects.h."""
