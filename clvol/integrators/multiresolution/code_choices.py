"""What blocks of codes may be held as, and how well: the bytes and the visible error of every (level, depth).

A block at full resolution may be cut after any of its stages, since these are a prefix of its bytes, without or with
residuals (clvol/store/codecs/coded_blocks.py). Coarser levels are held whole: they are an eighth of the size or less.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clvol.device.code_decoder import CodeDecoder
from clvol.device.memory import value_map
from clvol.integrators.multiresolution.coded_source import CodedSource, codes_at
from clvol.integrators.multiresolution.visible_error import ShownColors, noise_errors
from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.context import DeviceContext
from clvol.store.codecs.coded_blocks import CODED, WHOLE, Codebooks, CodedBlocks
from clvol.store.codecs.layout import kinds_of, parse_coded
from clvol.store.source import BlockStatistics

_BATCH_BYTES = 4 * 2**20  # of decoded samples that are compared together


@dataclass(frozen=True, eq=False)
class Choices:
    """Ways to hold each of n blocks, the finest first: choice k is ``level[k]``, cut after ``depth[k]`` stages
    (WHOLE: not cut).

    size       int64 [choices, n]: bytes
    deviation  float32 [choices, n]: of level 0, the root mean square of what the cut changes; 0 of other levels
    """

    level: np.ndarray
    depth: np.ndarray
    size: np.ndarray
    deviation: np.ndarray

    def errors(
        self, levels: np.ndarray, statistics: BlockStatistics, shown: Sequence[ShownColors]
    ) -> np.ndarray:
        """float32 [choices, k]: the visible error of every choice for the blocks of ``statistics``, in the look of
        ``shown`` that shows most; ``levels`` float32 [levels, k]: of every level (``estimated_errors``)."""
        first = statistics.first
        part = slice(first, first + levels.shape[1])
        out = levels[self.level].copy()
        for k in np.flatnonzero((self.level == 0) & (self.depth < WHOLE)):
            out[k] = np.max([noise_errors(statistics, self.deviation[k, part], each) for each in shown], axis=0)
        return out


def choices_of(context: DeviceContext, source: CodedSource, batch_bytes: int = _BATCH_BYTES) -> Choices:
    """The choices of all blocks of ``source``. Decodes level 0 once for each stage, at most about ``batch_bytes`` of
    samples at a time."""
    blocks, books = source.blocks, source.codebooks
    depths = list(range(books.stages + 1)) if books.codec == "rvq" else []
    level = [0] * (len(depths) + 1) + list(range(1, blocks.levels))
    depth = [WHOLE, *reversed(depths)] + [WHOLE] * (blocks.levels - 1)
    size = np.zeros((len(level), blocks.count), np.int64)
    deviation = np.zeros((len(level), blocks.count), np.float32)
    decoder = CodeDecoder(context, books, source.name)
    batch = max(min(batch_bytes, _BATCH_BYTES) // (2 * blocks.edge**3 * books.values.dtype.itemsize), 1)
    for first in range(0, blocks.count, batch):
        part = np.arange(first, min(first + batch, blocks.count))
        coded = codes_at(source, 0, part)
        size[0, part] = coded.size
        cut = cut_sizes(coded, blocks.edge, books, depths)
        found = _deviations(context, decoder, coded, blocks.edge, depths, value_map(source).gain)
        for k, each in enumerate(reversed(depths), 1):
            size[k, part], deviation[k, part] = cut[each], found[each]
        for finer in range(1, blocks.levels - 1):
            size[len(depths) + finer, part] = codes_at(source, finer, part).size
    return Choices(np.array(level), np.array(depth), size, deviation)


def cut_sizes(coded: CodedBlocks, s: int, codebooks: Codebooks, depths: list[int]) -> np.ndarray:
    """int64 [depths, k]: bytes of each block if it is cut after so many stages."""
    out = np.tile(coded.size, (len(depths), 1))
    own = np.flatnonzero(kinds_of(coded) == CODED)
    if len(own) and len(depths):
        parsed = parse_coded(coded.data, coded.start[own], coded.size[own], s, codebooks)
        out[:, own] = (parsed.stages[:, depths] - coded.start[own, None]).T
    return out


def _deviations(
    context: DeviceContext, decoder: CodeDecoder, coded: CodedBlocks, s: int, depths: list[int], gain: float
) -> np.ndarray:
    """float32 [depths, k]: the root mean square difference of each block from itself, cut."""
    out = np.zeros((len(depths), len(coded)), np.float32)
    own = np.flatnonzero(kinds_of(coded) == CODED)
    if not len(own) or not len(depths):
        return out
    dtype = decoder.dtype
    held = decoder.hold(CodedBlocks(coded.data, coded.start[own], coded.size[own]), s)
    places, shape = np.arange(len(own)) * s**3, (len(own), s, s, s)
    whole, cut = context.empty(dtype, shape), context.empty(dtype, shape)
    squares = context.empty(np.float32, (len(own),))
    kernel = context.kernel(
        "block_differences.cl", "block_differences",
        (
            reads("a", dtype), reads("b", dtype), value("samples", np.int32), value("gain", np.float32),
            writes("squares", np.float32),
        ),
        {"VOXEL_BITS": dtype.itemsize * 8, "VOXEL_SIGNED": int(dtype.kind == "i")},
    )  # fmt: skip
    decoder.into_blocks(held, np.arange(len(own)), whole, places)
    for k, depth in enumerate(depths):
        decoder.into_blocks(held, np.arange(len(own)), cut, places, depth)
        kernel(context.queue, (len(own),), None, a=whole, b=cut, samples=s**3, gain=gain, squares=squares)
        out[k, own] = np.sqrt(context.read(squares) / s**3)
    return np.nan_to_num(out)
