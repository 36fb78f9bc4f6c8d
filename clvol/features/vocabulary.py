"""The vocabulary that the host and the kernels share, as numbered in cl/features.h; counters in the headers that count.

tests/test_features.py compares all of it with the #defines.
"""

from __future__ import annotations

FILTERS = {
    "nearest": 0, "linear": 1, "cubic": 2, "catmull-rom": 3, "mitchell": 4, "lanczos2": 5, "lanczos3": 6,
    "windowed-sinc": 7, "table": 8,
}  # fmt: skip
# Voxels that a filter uses beyond the corners of a lattice cell.
FILTER_REACH = {
    "nearest": 0, "linear": 0, "cubic": 1, "catmull-rom": 1, "mitchell": 1, "lanczos2": 1, "lanczos3": 2,
    "windowed-sinc": 2, "table": 2,
}  # fmt: skip
# Filters whose reconstruction is differentiated analytically, without an operator on voxels.
ANALYTIC = ("cubic", "catmull-rom", "mitchell", "lanczos2", "lanczos3", "windowed-sinc", "table")
# Kinds of gradients; "central" and "sobel" are computed on the fly.
GRADIENTS = {"central": 1, "sobel": 2, "precomputed": 3, "analytic": 4}
CLASSIFICATIONS = {"pre": 0, "post": 1, "preintegrated": 2}
COMPOSITINGS = {"over": 0, "maximum": 1, "minimum": 2, "average": 3, "attenuated-maximum": 4}
QUADRATURES = {"steps": 0, "cells": 1}
# Step lengths of rays in a volume of blocks.
STEPPINGS = {"full": 0, "limited": 1, "naive": 2, "bounded": 3}
# How the method "pyramid" queries an oracle.
ORACLES = {"minimum": 0, "map": 1, "error": 2, "custom": 3}
# Shapes of slices: SLICES; 0: rays take steps of their own.
SLICES = {"along-axis": 1, "along-view": 2, "shells": 3, "half-angle": 4}
# What a pixel is rounded to after each slice: ACCUMULATE.
ACCUMULATE = {"float32": 0, "half": 1, "uint8": 2}
# Methods of shadows: SHADOWS.
SHADOW_METHODS = {"rays": 1, "volume": 2, "half-angle": 3}
# What ambient occlusion darkens: AMBIENT_OCCLUSION.
DARKENS = {"ambient": 1, "all": 2}
# Bits of OPACITY_FACTORS.
OPACITY_FACTORS = {"gradient": 1, "directional": 2, "fur": 4}
# What layers of a transfer function are stated by: TRANSFER_LAYERS.
TRANSFER_LAYERS = {"by-gradient": 1, "of-two": 2, "of-three": 3}
# Roles of fields, and bits of FIELDS.
FIELD_ROLES = {"label": 1, "density": 2, "mask": 4, "color": 8, "value": 16}
# What a term of noise perturbs; bit 1 << n of NOISE says whether any does (not of attenuation and fur).
NOISE_TARGETS = {"value": 0, "coordinate": 1, "attenuation": 2, "fur": 3}
LIGHTS = {"directional": 0, "point": 1, "headlight": 2, "spot": 3, "image": 4}
CLIPS = {"plane": 0, "box": 1, "sphere": 2, "mesh": 3}
# How a block's samples reach the device.
BLOCK_CODECS = {"raw": 0, "constant": 1}
CODE_DROPPED = 15  # the code of a block without samples
# Contents of a cell of a volume of blocks.
CELLS = {"visible": 0, "beside-holes": 1, "empty": 255}

# What is counted beside samples, in the order of COUNT_... of the header that is named.
EFFECT_COUNTERS = (  # cl/effects.h
    "gradients", "lit_samples", "surface_tests", "surface_hits", "shadow_rays", "shadow_samples", "field_samples",
    "bends",
)  # fmt: skip
BLOCK_COUNTERS = ("block_reads", "blended_samples")  # cl/block_parameters.h
LEVEL_COUNTERS = ("level_blends", "finest_samples")  # cl/volume_levels.h
PYRAMID_COUNTERS = ("oracle_samples", "syntheses", "accumulations")  # cl/pyramid.h

# Of a filter of the scene's own, the sums of the magnitudes of its weights along an axis, and of their derivatives.
LARGEST_WEIGHTS, LARGEST_SLOPES = 2.0, 8.0
# The largest sum of the weights' magnitudes along an axis: 1 if no weight is negative.
WEIGHTS = {
    "catmull-rom": 1.25, "mitchell": 1.139, "lanczos2": 1.251, "lanczos3": 1.544, "windowed-sinc": 1.428,
    "table": LARGEST_WEIGHTS,
}  # fmt: skip
# The largest sum of their derivatives' magnitudes.
SLOPES = {
    "nearest": 2.0, "linear": 2.0, "cubic": 2.0, "catmull-rom": 3.0, "mitchell": 2.34, "lanczos2": 3.11,
    "lanczos3": 3.18, "windowed-sinc": 3.18, "table": LARGEST_SLOPES,
}  # fmt: skip


def overshoot(filter: str) -> float:
    """How far ``filter`` can take a sample beyond the range of its voxels on either side, as a share of the range.
    The cause is negative weights.
    """
    return (WEIGHTS.get(filter, 1.0) ** 3 - 1.0) / 2.0
