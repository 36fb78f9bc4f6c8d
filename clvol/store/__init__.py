"""Volumes as blocks at several resolutions: on disk, and which resolution of each block a picture wants.

Flat blocking (Ljung 2006, sec. 3.1): the volume is cut into blocks of ``edge``^3 voxels, and every block is
stored at all resolutions edge^3, (edge / 2)^3, ..., 1. A block keeps its place whatever its resolution.
"""
