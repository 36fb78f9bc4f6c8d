"""Volumes as blocks at several resolutions: the format on disk, building a store, and reading blocks from it.

Flat blocking (Ljung 2006, sec. 3.1): the volume is cut into blocks of ``edge``^3 voxels, and every block is stored at
all resolutions edge^3, (edge / 2)^3, ..., 1. A block covers the same space at every resolution.
"""
