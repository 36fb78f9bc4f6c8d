"""Names of what gets compiled, as numbered in cl/features.h."""

from __future__ import annotations

FILTERS = {"nearest": 0, "linear": 1, "cubic": 2, "catmull-rom": 3}
# Voxels that a filter uses beyond the corners of a lattice cell.
FILTER_REACH = {"nearest": 0, "linear": 0, "cubic": 1, "catmull-rom": 1}
# Filters whose reconstruction has a derivative of its own: no operator on voxels is used.
ANALYTIC = ("cubic", "catmull-rom")
CLASSIFICATIONS = {"pre": 0, "post": 1, "preintegrated": 2}
QUADRATURES = {"steps": 0, "cells": 1}
METHODS = ("raycast", "reference")
