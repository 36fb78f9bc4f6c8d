"""Decodes blocks of codes at any level into samples of blocks that lie anywhere in a buffer."""

from __future__ import annotations

import numpy as np

from clvol.device.code_decoder import CodeDecoder, HeldCodes
from clvol.integrators.multiresolution.coded_source import CodedSource
from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext
from clvol.store.codecs.coded_blocks import WHOLE, CodedBlocks


class BlockDecoder:
    """For the blocks of ``source``: as ``CodeDecoder``, and what a block holds beyond the volume is the volume's last
    samples, as in ``BlockSource.read``."""

    def __init__(self, context: DeviceContext, source: CodedSource) -> None:
        self._context, self._blocks = context, source.blocks
        self._decoder = CodeDecoder(context, source.codebooks, source.name)
        self.dtype, self.nbytes = self._decoder.dtype, self._decoder.nbytes
        self._repeat = context.kernel(
            "repeat_last.cl", "repeat_last",
            (reads("ends", np.int32, 4), value("size", np.int32), writes("samples", self.dtype)),
            {"VOXEL_BITS": self.dtype.itemsize * 8, "VOXEL_SIGNED": int(self.dtype.kind == "i")},
        )  # fmt: skip

    def hold(self, coded: CodedBlocks, level: int, depths: int | np.ndarray = WHOLE) -> HeldCodes:
        """``coded`` of blocks at ``level`` on the device, cut after ``depths`` stages."""
        return self._decoder.hold(coded, self._blocks.samples(level), depths)

    def decode(
        self,
        held: HeldCodes,
        places: np.ndarray,
        blocks: np.ndarray,
        level: int,
        samples: DeviceArray,
        start: np.ndarray,
        depths: int | np.ndarray = WHOLE,
    ) -> None:
        """Enqueues the decoding of ``blocks`` (numbers, int64 [k]) at ``level``, which have ``places`` in ``held``, to
        samples that begin at the elements ``start`` of ``samples``."""
        self._decoder.into_blocks(held, places, samples, start, depths)
        inside = np.array(self._blocks.level_shape(level)) - self._blocks.places(blocks) * held.s
        short = np.flatnonzero(np.any(inside < held.s, axis=1))
        if len(short):
            ends = np.concatenate([start[short, None], inside[short, ::-1]], axis=1).astype(np.int32)
            self._repeat(
                self._context.queue, (len(ends),), None,
                ends=self._context.upload(ends), size=held.s, samples=samples,
            )  # fmt: skip
