"""Names of what gets compiled, as numbered in cl/features.h."""

from __future__ import annotations

FILTERS = {"nearest": 0, "linear": 1, "cubic": 2, "catmull-rom": 3}
# Voxels that a filter uses beyond the corners of a lattice cell.
FILTER_REACH = {"nearest": 0, "linear": 0, "cubic": 1, "catmull-rom": 1}
# Filters whose reconstruction has a derivative of its own: no operator on voxels is used.
ANALYTIC = ("cubic", "catmull-rom")
# How gradients are had; "central" and "sobel" are found on the fly.
GRADIENTS = {"central": 1, "sobel": 2, "precomputed": 3, "analytic": 4}
CLASSIFICATIONS = {"pre": 0, "post": 1, "preintegrated": 2}
COMPOSITINGS = {"over": 0, "maximum": 1, "minimum": 2, "average": 3, "attenuated-maximum": 4}
QUADRATURES = {"steps": 0, "cells": 1}
# How far rays go at once in a volume of blocks.
STEPPINGS = {"full": 0, "limited": 1, "naive": 2, "bounded": 3}
# How the method "pyramid" asks an oracle.
ORACLES = {"minimum": 0, "map": 1, "error": 2, "custom": 3}
# The sum of the weights' magnitudes along an axis, at most: 1 where no weight is negative.
_WEIGHT = {"catmull-rom": 1.25}


def overshoot(filter: str) -> float:
    """How far ``filter`` takes a sample below the lowest or above the highest of its voxels, at
    most: a share of their span. It is what negative weights can add up to."""
    return (_WEIGHT.get(filter, 1.0) ** 3 - 1.0) / 2.0
