"""Blocks as codes of a vector-quantising codec: what they consist of, and the layout of their bytes.

The samples [s, s, s] of a block (any level; s = 4, 8, 16, 32) are cut into sub-blocks of ``side``^3 samples.
Sub-blocks are numbered in z-order within octants of 8^3 samples and octants in C order (z, y, x) of the block, samples
of a sub-block in C order. Blocks of fewer than four samples per axis are always stored raw.

A block's bytes:

  kind (1 byte), then
  CONSTANT   one sample, of the volume's type
  RAW        all samples [s, s, s], of the volume's type
  CODED      codec "rvq", in this order:
             flags     one bit per octant, the lowest first: whether it is split into sub-blocks; the octants of a
                       block of s samples are (s / 8)^3, in whole bytes. No flags if s = 4: a single sub-block.
             means     one byte per octant that is not split, eight per octant that is, one if s = 4
             depths    four bits per sub-block of split octants (the lower half first): the number of stages, 0 to
                       MOST_STAGES, or ESCAPED; one byte if s = 4
             stage 1, stage 2, ...: one code (a byte) for each sub-block with at least that many stages. The first n
                       stages are therefore a prefix of the bytes, and decoding can end after any stage (escaped
                       sub-blocks then consist of their means).
             escapes   for each escaped sub-block in order: a byte with the number of stages n in its lower and the
                       number of bits b (0 to 8) in its upper half, n codes, and 64 residuals of b bits (sample k in
                       bits k b ... k b + b - 1, the lowest bit of the lowest byte first; signed, two's complement);
                       or the byte RAW_SAMPLES and 64 samples of the volume's type
  FIXED      codec "vq": one code per sub-block (side 2); "vq-mean": all means, then all codes (side 2); "hvq": all
             means, then all codes of stage 1 (shape of the means of 2^3 samples), then of stage 2 (side 4).
             Sub-blocks in C order of the block.

The working value of a sample: (mean << 8) + 128 + the sum over stages of
(codebook[stage, code, sample] << shift[stage]), clipped to 0 ... 65535; "vq" has no means: 32768 takes the place of
(mean << 8) + 128. It becomes a voxel as ``WorkingValues`` says; ``residual * residual_step`` is added to it (integer
types: to the voxel, clipped to low ... low + span; floating-point types: to the working value, clipped again).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clvol.store.codecs.working_values import WorkingValues

CONSTANT, RAW, CODED, FIXED = range(4)  # kinds of blocks
MOST_STAGES = 12
ESCAPED = 15
RAW_SAMPLES = 0xFF
ENTRIES = 256  # of a codebook, at most


@dataclass(frozen=True, eq=False)
class Codebooks:
    """What decoding needs besides a block's bytes.

    ``codec``: "vq", "vq-mean", "hvq" or "rvq". ``side``: samples per axis of a sub-block. ``entries`` int8
    [stages, ENTRIES, side^3]: unused entries are 0; the first stage of "hvq" repeats each mean of 2^3 samples eight
    times. ``shifts`` int32 [stages], 0 to 9. ``residual_step`` >= 1.
    """

    codec: str
    side: int
    entries: np.ndarray
    shifts: np.ndarray
    values: WorkingValues
    residual_step: int = 1

    @property
    def stages(self) -> int:
        return len(self.shifts)

    @property
    def nbytes(self) -> int:
        """Bytes of the codebooks on a device."""
        return self.entries.nbytes + self.shifts.nbytes


@dataclass(frozen=True, eq=False)
class CodedBlocks:
    """The bytes of blocks: block k is ``data[start[k] : start[k] + size[k]]``. ``data`` uint8; ``start`` and ``size``
    int64 [n]."""

    data: np.ndarray
    start: np.ndarray
    size: np.ndarray

    def __len__(self) -> int:
        return len(self.start)


@dataclass(frozen=True)
class RateTarget:
    """What an encoder keeps to: at most one of the three. ``max_voxel_error``: the largest error of any voxel, as a
    share of the volume's range; ``psnr`` in dB over the range, at least; ``bits_per_voxel`` at most, codebooks and
    index included. None at all: the codec's own default."""

    max_voxel_error: float | None = None
    psnr: float | None = None
    bits_per_voxel: float | None = None

    def to_json(self) -> dict[str, float]:
        return {key: value for key, value in vars(self).items() if value is not None}


@dataclass(frozen=True)
class MeasuredError:
    """The difference between decoded and original voxels (finite ones): ``psnr`` in dB over the range (inf if
    lossless), ``max_voxel_error`` as a share of the range, ``bits_per_voxel`` of level 0 with codebooks."""

    psnr: float
    max_voxel_error: float
    bits_per_voxel: float
    facts: dict[str, Any] = field(default_factory=dict)
