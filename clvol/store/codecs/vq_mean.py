"""The codec "vq-mean": a mean of 2^3 samples and a code for what is left, 256 entries, two bits per voxel of 8.

R. L. Baker, R. M. Gray: Differential vector quantization of achromatic imagery, Picture Coding Symposium 1983: vectors
without their means take fewer entries. Single errors are smaller than those of "vq" at twice its bytes.
"""

from __future__ import annotations

from clvol.store.codecs.codec import ZSTD, Codec
from clvol.store.codecs.coded_blocks import FIXED
from clvol.store.codecs.fixed import fixed_kind

CODEC = Codec("vq-mean", False, ZSTD, {FIXED: fixed_kind(has_means=True)}, targets=True)
