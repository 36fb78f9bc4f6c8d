"""Blocks as codes of a vector-quantising codec: what they consist of, and the layout of their bytes.

The samples [s, s, s] of a block (any level; s = 4, 8, 16, 32) are cut into sub-blocks of ``side``^3 samples, whose own
samples are in C order (z, y, x). Blocks of fewer than four samples per axis are CONSTANT or RAW. Samples are of the
type ``values.dtype`` (the volume's; float32 for float64), little-endian, and not aligned.

A block's bytes are its kind (1 byte), and then

  CONSTANT   one sample
  RAW        all samples [s, s, s] in C order
  CODED      codec "rvq" only (side 4). Octants of 8^3 samples are in C order of the block, the eight sub-blocks of an
             octant in C order of the octant: sub-block k has the corner (4 (k >> 2), 4 (k >> 1 & 1), 4 (k & 1)), z
             first. A block of s = 4 is a single sub-block, as if of one octant that is split.
             flags     one bit per octant, in bytes, the lowest bit first: whether it is split into sub-blocks. Bits
                       beyond the last octant (s = 8) are 0. No flags if s = 4.
             means     for octant after octant: one byte if it is not split, one per sub-block if it is
             depths    for each sub-block of split octants four bits, the lower half of a byte first: its number of
                       stages, 0 to ``stages`` of the codebooks, or ESCAPED. One byte if s = 4.
             heads     for each escaped sub-block in order a byte: its number of stages in the lower half and the number
                       of bits b (0 to 8) of its residuals in the upper half; or RAW_SAMPLES, which has no stages
             stage 1, stage 2, ...: one code (a byte) for each sub-block of at least that many stages, in order
             tails     for each escaped sub-block in order 8 b bytes: 64 residuals of b bits (that of sample k in bits
                       k b ... k b + b - 1, counted from the lowest bit of the first byte; two's complement); or, of
                       RAW_SAMPLES, 64 samples
  FIXED      codecs "vq", "vq-mean" and "hvq"; sub-blocks in C order of the block.
             "vq"      (side 2) one code per sub-block
             "vq-mean" (side 2) a mean per sub-block, then a code per sub-block
             "hvq"     (side 4) a mean per sub-block, then a code of stage 1 (shape of the means of 2^3 samples) per
                       sub-block, then one of stage 2
  REGIONS    codec "labels": the number of different labels less one (a byte), the labels; then, of octants and
             sub-blocks (side 4) as in CODED blocks,
             flags     as in CODED blocks
             types     for each sub-block of split octants two bits, the lowest bits of a byte first: 0, 1 and 2 for
                       one, two, and three or four labels, 3 for more. One byte if s = 4.
             indices   of labels, b bits each, the lowest bits of a byte first, where b is the least of 1, 2, 4 and 8
                       with which all labels have a number: for octant after octant one if it is not split, otherwise
                       for each of its sub-blocks 1, 2, 4 or none, by its type
             planes    for each sub-block of split octants 0, 1, 2 or b planes, by its type, of 2 bytes each: which of
                       the sub-block's eight cells of 2^3 samples are mixed, and which of the others consist of ones;
                       bit c is cell c, in C order
             cells     for each mixed cell in order a byte: bit i is sample i of the cell, in C order. So plane p has
                       bit p of the number of each sample, which counts the sub-block's indices (types 1, 2) or the
                       block's labels (type 3).
  RUNS       codec "labels": labels as above, the number of runs less one (2 bytes), the length of each run less one (2
             bytes each), and the index of each run's label (a byte each); runs follow the samples in C order

A block ends with what is listed. Every byte is a possible code: entries that are not used decode to 0.

A working value is (mean << 8) + 128 + the sum over stages of (codebook[stage, code, sample] << shift[stage]), clipped
to 0 ... 65535; "vq" has no means, and 32768 takes the place of (mean << 8) + 128. It becomes a voxel as
``WorkingValues`` says, and then ``residual * residual_step`` is added (integer types: to the voxel, clipped to
low ... low + span; floating-point types: to the clipped working value, which is clipped again).

Decoding to a limit of n stages, 0 to ``stages`` of the codebooks, takes the first n stages of each sub-block and no
tails: sub-blocks of RAW_SAMPLES then consist of their means. It needs a prefix of the block's bytes alone
(``layout.prefix_sizes``). With a greater limit, such as WHOLE, nothing is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clvol.store.codecs.working_values import LARGEST, WorkingValues

CONSTANT, RAW, CODED, FIXED, REGIONS, RUNS = range(6)  # kinds of blocks
MOST_STAGES = 12
WHOLE = 15  # a limit of stages that leaves nothing out
ESCAPED = 15
RAW_SAMPLES = 0xFF
ENTRIES = 256  # of a codebook; those that are not used are 0
LARGEST_SHIFT = 9
SHAPES = {"vq": (2, 1, 1), "vq-mean": (2, 1, 1), "hvq": (4, 2, 2), "rvq": (4, 0, MOST_STAGES), "labels": (4, 0, 0)}
"""By codec: samples per axis of a sub-block, and the least and largest number of stages."""


@dataclass(frozen=True, eq=False)
class Codebooks:
    """What decoding needs besides a block's bytes.

    ``codec``: "vq", "vq-mean", "hvq", "rvq" or "labels". ``side``: samples per axis of a sub-block. ``entries`` int8
    [stages, ENTRIES, side^3]: unused entries are 0; the first stage of "hvq" repeats each mean of 2^3 samples eight
    times. ``shifts`` int32 [stages], 0 to 9. ``residual_step`` 1 to 65535. Stages: 1 of "vq" and "vq-mean", 2 of "hvq",
    0 to MOST_STAGES of "rvq", none of "labels" (``labels.label_codebooks``).
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

    def fault(self) -> str | None:
        """What is impossible about them, such as of a damaged store; None if nothing is."""
        if self.codec not in SHAPES:
            return f"codec {self.codec!r}"
        side, fewest, most = SHAPES[self.codec]
        if self.side != side or not fewest <= self.stages <= most:
            return f"{self.stages} stages of side {self.side}"
        if self.entries.dtype != np.int8 or self.entries.shape != (self.stages, ENTRIES, side**3):
            return f"entries of shape {self.entries.shape}, type {self.entries.dtype}"
        if self.shifts.ndim != 1 or ((self.shifts < 0) | (self.shifts > LARGEST_SHIFT)).any():
            return "shifts"
        return None if 1 <= self.residual_step <= LARGEST else f"residual step {self.residual_step}"

    def shifted(self, stage: int) -> np.ndarray:
        """int32 [ENTRIES, side^3]: what the codes of a stage, the first is 0, add to working values."""
        return self.entries[stage].astype(np.int32) << int(self.shifts[stage])

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
