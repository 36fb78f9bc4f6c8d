"""Decoding of blocks of codes on a device: into blocks whose samples lie together, or into a volume of rows.

Codes reach a device only through ``CodeDecoder.hold`` and ``decode_volume``, which check them: a block of impossible
bytes is a VolumeError, and kernels trust what they get. The voxels are those of clvol/store/codecs/decode.py, bit for
bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from clvol.errors import RenderError, VolumeError
from clvol.opencl.arguments import RAW, reads, value, writes
from clvol.opencl.context import DeviceArray, DeviceContext, Kernel
from clvol.opencl.structs import CODE_MAP, CODED_BLOCK
from clvol.store.codecs.coded_blocks import WHOLE, Codebooks, CodedBlocks
from clvol.store.codecs.layout import check_codes
from clvol.store.codecs.working_values import LARGEST

SPARE_BYTES = 64  # after the codes of a buffer: kernels read vectors that may end beyond the last block
STAGING_BYTES = 16 * 2**20
_SIDES = (1, 2, 4, 8, 16, 32)
_MEAN_UNIT = 7  # of (mean << 8) + 128
_STAGED_EDGE, _LINE_BYTES = 16, 64  # of blocks that are staged (CODED_STAGED of cl/decode_codes.cl); of a cache line
_STREAMED_BYTES = 32 * 2**20, 4 * 2**20  # of voxels, in blocks and in a volume

Stages: TypeAlias = "int | np.ndarray"
"""A limit of stages: of all blocks, or int [n], of each."""

_ARGUMENTS = (
    reads("blocks", np.uint8, "count", CODED_BLOCK.itemsize), value("count", np.int32), reads("codes", np.uint8),
    reads("entries", np.int8), reads("map", np.uint8, CODE_MAP.itemsize), writes("voxels", RAW),
    value("first_code", np.int64), value("first_voxel", np.int64), value("row", np.int64), value("slice", np.int64),
    writes("fault", np.int32),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class HeldCodes:
    """Blocks of s samples per axis on a device, as codes that were checked; ``start`` int64 [n]: where each begins."""

    codes: DeviceArray
    start: np.ndarray
    s: int

    @property
    def nbytes(self) -> int:
        return self.codes.nbytes


class CodeDecoder:
    """Decodes the blocks of one volume on one device. ``where``: what errors name, such as the file."""

    def __init__(self, context: DeviceContext, codebooks: Codebooks, where: str = "codes") -> None:
        fault = codebooks.fault()
        if fault is not None:
            raise VolumeError(where, f"impossible codebooks ({fault})", "those of one of clvol's codecs")
        if codebooks.values.dtype.itemsize > 4:
            raise RenderError(where, f"labels of {codebooks.values.dtype}", "a type of at most four bytes on a device")
        self._context, self.codebooks, self.where = context, codebooks, where
        self.dtype = codebooks.values.dtype
        # A group of one keeps compilers for CPUs from spreading vectors of 16 over work-items.
        self._group = 1 if context.is_cpu else 32
        self._entries = context.upload(device_entries(codebooks))
        self._map = context.upload(code_map(codebooks).view(np.uint8))
        self._fault = context.upload(np.full(1, -1, np.int32), writable=True)
        self._kernel = self._compiled(0)
        self._line = _LINE_BYTES // (_STAGED_EDGE * self.dtype.itemsize)  # blocks whose rows are a cache line

    def _compiled(self, staged: int) -> Kernel:
        own = switches(self.codebooks, self._group, staged)
        return self._context.kernel("decode_codes.cl", "decode_codes", _ARGUMENTS, own)

    @property
    def nbytes(self) -> int:
        """Bytes on the device, without codes and voxels."""
        return self._entries.nbytes + self._map.nbytes + self._fault.nbytes

    def hold(self, coded: CodedBlocks, s: int, stages: Stages = WHOLE) -> HeldCodes:
        """``coded`` on the device, of which no more bytes need to be there than a limit of ``stages`` takes: then they
        may only be decoded to it. VolumeError names the first block whose bytes are impossible."""
        self._check(coded, s, np.arange(len(coded)), stages)
        data, start = gathered(coded, np.arange(len(coded)))
        codes = self._context.empty(np.uint8, (len(data) + SPARE_BYTES,))
        if len(data):
            self._context.write(codes, data)
        return HeldCodes(codes, start, s)

    def into_blocks(
        self,
        held: HeldCodes,
        blocks: np.ndarray,
        voxels: DeviceArray,
        places: np.ndarray,
        stages: Stages = WHOLE,
    ) -> None:
        """Enqueues the decoding of ``blocks`` (numbers in ``held``) to samples [s, s, s] that begin at the elements
        ``places`` of ``voxels``, to a limit of ``stages``."""
        self._check_room(voxels, int(np.max(places, initial=0)) + (held.s**3 if len(blocks) else 0))
        if (np.asarray(places) < 0).any():
            raise RenderError(self.where, f"decoded to the place {np.min(places)}", "0 or more")
        extent = np.full((len(blocks), 4), held.s, np.int32)
        self._decode(held.codes, held.start[blocks], places, extent, voxels, stages)

    def into_volume(
        self,
        held: HeldCodes,
        blocks: np.ndarray,
        voxels: DeviceArray,
        corners: np.ndarray,
        stages: Stages = WHOLE,
        first_slice: int = 0,
    ) -> None:
        """Enqueues the decoding of ``blocks`` (numbers in ``held``) to the corners int [n, 3] (z, y, x) of ``voxels``
        [nz, ny, nx], which ``first_slice`` slices precede. What of a block is beyond the upper ends is left out."""
        self._rows(held.codes, held.start[blocks], held.s, voxels, corners, stages, first_slice)

    def decode_volume(
        self,
        coded: CodedBlocks,
        s: int,
        voxels: DeviceArray,
        corners: np.ndarray,
        stages: Stages = WHOLE,
        *,
        staging_bytes: int = STAGING_BYTES,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Decodes blocks at ``corners`` int [n, 3] (z, y, x) of ``voxels`` [nz, ny, nx], with at most about
        ``staging_bytes`` of codes on the device at a time (one block at least). What of a block is beyond the upper
        ends is left out. ``progress(done, total)`` counts blocks. VolumeError names the first block whose bytes are
        impossible; parts before it are decoded."""
        room = max(min(staging_bytes, int(coded.size.sum())), int(coded.size.max(initial=0)))
        staging = self._context.empty(np.uint8, (room + SPARE_BYTES,))
        for blocks in parts_of(coded.size, room):
            own = stages[blocks] if isinstance(stages, np.ndarray) else stages
            self._check(coded, s, blocks, own)
            data, start = gathered(coded, blocks)
            self._context.write(staging, data)
            self._rows(staging, start, s, voxels, corners[blocks], own, 0)
            if progress is not None:
                progress(int(blocks[-1]) + 1, len(coded))
        self.check_fault()

    def check_fault(self) -> None:
        """Waits for what was enqueued; RenderError if a kernel met a block of a kind that it does not know."""
        fault = int(self._context.read(self._fault)[0])
        if fault >= 0:
            self._context.write(self._fault, np.full(1, -1, np.int32))
            raise RenderError(self.where, f"block {fault} of a launch is of an unknown kind", "codes that were checked")

    def _check(self, coded: CodedBlocks, s: int, blocks: np.ndarray, stages: Stages) -> None:
        if s not in _SIDES:
            raise RenderError(self.where, f"blocks of {s} samples per axis", "one of " + ", ".join(map(str, _SIDES)))
        limits = np.broadcast_to(stages, blocks.shape)
        damaged = []
        for limit in np.unique(limits):
            own = blocks[limits == limit]
            part = CodedBlocks(coded.data, coded.start[own], coded.size[own])
            damaged += own[check_codes(part, s, self.codebooks, int(limit))].tolist()
        if damaged:
            more = f" and {len(damaged) - 1} others" if len(damaged) > 1 else ""
            raise VolumeError(self.where, f"impossible bytes of block {min(damaged)}{more}", "undamaged codes")

    def _check_room(self, voxels: DeviceArray, needed: int) -> None:
        if voxels.dtype != self.dtype:
            raise RenderError(self.where, f"decoded into {voxels.dtype}", str(self.dtype))
        count = int(np.prod(voxels.shape, dtype=np.int64))
        if needed > count:
            raise RenderError(self.where, f"decoded into {count} voxels", f"at least {needed}")

    def _rows(
        self,
        codes: DeviceArray,
        start: np.ndarray,
        s: int,
        voxels: DeviceArray,
        corners: np.ndarray,
        stages: Stages,
        first_slice: int,
    ) -> None:
        corners = np.asarray(corners, np.int64).reshape(-1, 3) - (first_slice, 0, 0)
        shape = np.array(voxels.shape, np.int64)
        self._check_room(voxels, 0)
        if len(shape) != 3 or (corners < 0).any() or (corners >= shape).any():
            raise RenderError(self.where, "a block outside the volume", f"corners within {tuple(voxels.shape)}")
        extent = np.full((len(corners), 4), s, np.int32)
        extent[:, :3] = np.minimum(shape - corners, s)[:, ::-1]
        row, area = int(shape[2]), int(shape[1] * shape[2])
        places = corners @ (area, row, 1)
        self._decode(codes, start, places, extent, voxels, stages, row, area)

    def _decode(
        self,
        codes: DeviceArray,
        start: np.ndarray,
        places: np.ndarray,
        extent: np.ndarray,
        voxels: DeviceArray,
        stages: Stages,
        row: int = 0,
        area: int = 0,
        first_code: int = 0,
        first_voxel: int = 0,
    ) -> None:
        if not len(start):
            return
        blocks = np.empty(len(start), CODED_BLOCK)
        blocks["from"], blocks["to"], blocks["extent"], blocks["limit"] = start, places, extent, stages
        # What exceeds the caches is written past them. Blocks that lie together are read soon, by whoever copies them.
        size, least = len(blocks) * _STAGED_EDGE**3 * self.dtype.itemsize, _STREAMED_BYTES[bool(row)]
        streams = self._context.is_cpu and extent[0, 3] == _STAGED_EDGE and size >= least
        kernel, each = (self._compiled(self._line), self._line) if streams else (self._kernel, 1)
        items = -(-len(blocks) // each)
        kernel(
            self._context.queue,
            (-(-items // self._group) * self._group,),
            (self._group,),
            blocks=self._context.upload(blocks.view(np.uint8)),
            count=len(blocks),
            codes=codes,
            entries=self._entries,
            map=self._map,
            voxels=voxels,
            first_code=first_code,
            first_voxel=first_voxel,
            row=row,
            slice=area,
            fault=self._fault,
        )


def switches(codebooks: Codebooks, group: int, staged: int = 0) -> dict[str, int]:
    """The switches (-D) of cl/decode_codes.cl. ``staged``: blocks that a work-item decodes beside each other."""
    dtype = codebooks.values.dtype
    return {
        "LANES": 1, "VOXEL_BITS": dtype.itemsize * 8, "VOXEL_SIGNED": int(dtype.kind == "i"),
        "CODED_SIDE": codebooks.side, "CODED_MEANS": int(codebooks.codec != "vq"),
        "CODED_WHOLE": int(codebooks.values.span == LARGEST), "CODED_GROUP": group,
        "CODED_LABELS": int(codebooks.codec == "labels"), "CODED_NARROW": int(is_narrow(codebooks)),
        "CODED_STAGED": staged,
    }  # fmt: skip


def unit_of(codebooks: Codebooks) -> int:
    """log2 of a number, at most 128, of which all working values that codes stand for are multiples."""
    return min(int(np.min(codebooks.shifts, initial=_MEAN_UNIT)), _MEAN_UNIT)


def is_narrow(codebooks: Codebooks) -> bool:
    """Whether all sums of a mean and codes of sub-blocks of 4^3 samples fit into 16 bits, in multiples of 2^unit."""
    if codebooks.side != 4 or not codebooks.stages:
        return False
    unit = unit_of(codebooks)
    entries = codebooks.entries.reshape(codebooks.stages, -1).astype(np.int64)
    scales = 1 << (np.asarray(codebooks.shifts, np.int64) - unit)
    low = (np.minimum(entries.min(axis=1), 0) * scales).sum()
    high = (np.maximum(entries.max(axis=1), 0) * scales).sum() + (LARGEST >> unit)
    return bool(-(2**15) <= low and high < 2**15)


def device_entries(codebooks: Codebooks) -> np.ndarray:
    """int8: the bytes of ``entries`` of cl/decode_codes.cl."""
    if not codebooks.stages:
        return np.zeros(64, np.int8)
    if not is_narrow(codebooks):
        return codebooks.entries.ravel()
    scales = 1 << (np.asarray(codebooks.shifts, np.int16) - unit_of(codebooks))
    return (codebooks.entries * scales[:, None, None].astype(np.int16)).astype(np.int16).ravel().view(np.int8)


def code_map(codebooks: Codebooks) -> np.ndarray:
    """``CodeMap`` of cl/decode_codes.h [1]."""
    own, values = np.zeros(1, CODE_MAP), codebooks.values
    shifts = own["shifts"].reshape(1, -1)
    shifts[0, : codebooks.stages] = codebooks.shifts
    own["shifts"] = shifts.reshape(own["shifts"].shape)
    own["stages"], own["residual_step"], own["unit"] = codebooks.stages, codebooks.residual_step, unit_of(codebooks)
    own["low"], own["span"], own["first"], own["scale"] = values.low, values.span, values.first, values.scale
    return own


def parts_of(sizes: np.ndarray, room: int) -> Iterator[np.ndarray]:
    """Numbers of blocks of ``sizes`` bytes in parts of at most ``room`` bytes together, in order."""
    ends = np.cumsum(sizes)
    first = 0
    while first < len(sizes):
        before = ends[first] - sizes[first]
        last = max(int(np.searchsorted(ends, before + room, side="right")), first + 1)
        yield np.arange(first, last)
        first = last


def gathered(coded: CodedBlocks, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bytes of ``blocks``, one after another, and where each begins (int64)."""
    start, size = coded.start[blocks], coded.size[blocks]
    first = np.cumsum(size) - size
    total = int(size.sum())
    if len(blocks) and (start == start[0] + first).all():
        return coded.data[start[0] : start[0] + total], first
    return coded.data[np.repeat(start - first, size) + np.arange(total)], first
