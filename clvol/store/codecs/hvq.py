"""The codec "hvq": hierarchical vector quantisation of 4^3 samples by a mean and two codes, about 21 : 1.

J. Schneider, R. Westermann: Compression domain volume rendering, IEEE Visualization 2003. The first code has the shape
of the means of 2^3 samples, eight differences from the mean of 4^3; the second has the 64 differences from those. Both
codebooks have 256 entries. Single errors are large, whatever the PSNR.
"""

from __future__ import annotations

from clvol.store.codecs.codec import ZSTD, Codec
from clvol.store.codecs.coded_blocks import FIXED
from clvol.store.codecs.fixed import fixed_kind

CODEC = Codec("hvq", False, ZSTD, {FIXED: fixed_kind(has_means=True)}, targets=True)
