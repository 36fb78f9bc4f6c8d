"""The codec "vq": vector quantisation of 2^3 samples by a codebook of 256, one bit per voxel of 8.

K. Engel, T. Ertl: Interactive high-quality volume rendering with flexible consumer graphics hardware, Eurographics
2002, State of the Art Reports, section 9; for volumes first P. Ning, L. Hesselink: Vector quantization for volume
rendering, Workshop on Volume Visualization 1992. They fetch samples from the codebook while they render, by the nearest
neighbour; here blocks are decoded before filters see them. Single errors are large, whatever the PSNR.
"""

from __future__ import annotations

from clvol.store.codecs.codec import ZSTD, Codec
from clvol.store.codecs.coded_blocks import FIXED
from clvol.store.codecs.fixed import fixed_kind

CODEC = Codec("vq", False, ZSTD, {FIXED: fixed_kind(has_means=False)}, targets=True)
