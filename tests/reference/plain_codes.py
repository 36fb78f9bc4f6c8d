"""Blocks of codes written and read byte by byte, as the text of clvol/store/codecs/coded_blocks.py says.

A block is described as the layout has it: ``Constant(sample)``, ``Raw(samples)``, ``Fixed(means, codes)``,
``Coded(octants)``, where an octant is a mean or a list of eight ``SubBlock``, ``Regions(labels, octants)``, where an
octant is an index or a list of eight ``Labelled``, or ``Runs(labels, runs)`` with the length and the index of each run.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

# The samples of each cell of 2^3 of a sub-block of 4^3.
CELLS = [
    [16 * (2 * z + c) + 4 * (2 * y + b) + 2 * x + a for c, b, a in np.ndindex(2, 2, 2)]
    for z, y, x in np.ndindex(2, 2, 2)
]
FORMATS = {"uint8": "<B", "int8": "<b", "uint16": "<H", "int16": "<h", "float32": "<f"}


@dataclass
class Constant:
    sample: float


@dataclass
class Raw:
    samples: list


@dataclass
class Fixed:
    """``means``: a byte per sub-block, none for "vq". ``codes``: a list per stage."""

    means: list
    codes: list


@dataclass
class SubBlock:
    """``codes``: one per stage. Escaped if it has ``raw`` (64 samples) or ``residuals`` (64 integers of ``bits``)."""

    mean: int
    codes: list = field(default_factory=list)
    bits: int = 0
    residuals: list | None = None
    raw: list | None = None

    @property
    def escaped(self) -> bool:
        return self.raw is not None or self.residuals is not None


@dataclass
class Coded:
    octants: list


@dataclass
class Labelled:
    """A sub-block of ``type`` 0 to 3 with its ``indices`` and the ``numbers`` of its 64 samples."""

    type: int
    indices: list
    numbers: list


@dataclass
class Regions:
    labels: list
    octants: list


@dataclass
class Runs:
    labels: list
    runs: list


def sample_bytes(sample, dtype) -> bytes:
    return struct.pack(FORMATS[np.dtype(dtype).name], sample)


def write(block, s, codebooks) -> bytes:
    """The bytes of a block of s samples per axis."""
    dtype = codebooks.values.dtype
    if isinstance(block, Constant):
        return bytes([0]) + sample_bytes(block.sample, dtype)
    if isinstance(block, Raw):
        return bytes([1]) + b"".join(sample_bytes(v, dtype) for v in block.samples)
    if isinstance(block, Fixed):
        return bytes([3, *block.means]) + b"".join(bytes(codes) for codes in block.codes)
    if isinstance(block, Regions):
        return bytes([4]) + _write_labels(block.labels, dtype) + _write_regions(block, s)
    if isinstance(block, Runs):
        out = bytes([5]) + _write_labels(block.labels, dtype) + struct.pack("<H", len(block.runs) - 1)
        lengths = b"".join(struct.pack("<H", length - 1) for length, _ in block.runs)
        return out + lengths + bytes(index for _, index in block.runs)
    return bytes([2]) + _write_coded(block, s, dtype)


def _write_labels(labels, dtype) -> bytes:
    return bytes([len(labels) - 1]) + b"".join(sample_bytes(v, dtype) for v in labels)


def _index_bits(labels) -> int:
    return next(b for b in (1, 2, 4, 8) if len(labels) <= 1 << b)


def _write_flags(octants) -> bytes:
    flags = sum(isinstance(octant, list) << k for k, octant in enumerate(octants))
    return flags.to_bytes(-(-len(octants) // 8), "little")


def _write_regions(block, s) -> bytes:
    out = bytearray() if s == 4 else bytearray(_write_flags(block.octants))
    subs = [sub for octant in block.octants if isinstance(octant, list) for sub in octant]
    types = sum(sub.type << 2 * k for k, sub in enumerate(subs))
    out += types.to_bytes(-(-len(subs) // 4), "little")
    indices = []
    for octant in block.octants:
        for part in octant if isinstance(octant, list) else [octant]:
            indices += part.indices if isinstance(part, Labelled) else [part]
    bits = _index_bits(block.labels)
    packed = sum(index << k * bits for k, index in enumerate(indices))
    out += packed.to_bytes(-(-len(indices) * bits // 8), "little")
    cells = bytearray()
    for sub in subs:
        for p in range((0, 1, 2, bits)[sub.type]):
            mixed = ones = 0
            for c, cell in enumerate(CELLS):
                own = [sub.numbers[k] >> p & 1 for k in cell]
                if len(set(own)) == 2:
                    mixed |= 1 << c
                    cells.append(sum(bit << i for i, bit in enumerate(own)))
                else:
                    ones |= own[0] << c
            out += bytes([mixed, ones])
    out += cells
    return bytes(out)


def _write_coded(block, s, dtype) -> bytes:
    out = bytearray()
    if s > 4:
        out += _write_flags(block.octants)
    subs = []
    for octant in block.octants:
        if isinstance(octant, list):
            subs += octant
            out += bytes(sub.mean for sub in octant)
        else:
            out.append(octant)
    depths = [15 if sub.escaped else len(sub.codes) for sub in subs]
    if s == 4:
        out.append(depths[0])
    else:
        for low, high in zip(depths[::2], depths[1::2]):
            out.append(low | high << 4)
    out += bytes(255 if sub.raw is not None else len(sub.codes) | sub.bits << 4 for sub in subs if sub.escaped)
    for j in range(12):
        for sub in subs:
            if sub.raw is None and len(sub.codes) > j:
                out.append(sub.codes[j])
    for sub in subs:
        if sub.raw is not None:
            out += b"".join(sample_bytes(v, dtype) for v in sub.raw)
        elif sub.residuals is not None:
            packed = 0
            for k, residual in enumerate(sub.residuals):
                packed |= (residual & (1 << sub.bits) - 1) << k * sub.bits
            out += packed.to_bytes(8 * sub.bits, "little")
    return bytes(out)


class _Bytes:
    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def bytes(self, count: int) -> bytes:
        self.at += count
        assert self.at <= len(self.data)
        return self.data[self.at - count : self.at]

    def sample(self, dtype):
        form = FORMATS[dtype.name]
        data = self.bytes(struct.calcsize(form))
        if dtype.kind == "f":  # Python's own float would make a signalling NaN a quiet one
            return np.frombuffer(data, form)[0]
        return struct.unpack(form, data)[0]


def read(data: bytes, s, codebooks, limit: int = 15) -> np.ndarray:
    """The voxels [s, s, s] of a block's bytes."""
    dtype = codebooks.values.dtype
    source = _Bytes(data)
    voxels = np.empty((s, s, s), dtype)
    kind = source.byte()
    if kind == 0:
        voxels[:] = source.sample(dtype)
    elif kind == 1:
        for place in np.ndindex(s, s, s):
            voxels[place] = source.sample(dtype)
    elif kind in (4, 5):
        labels = [source.sample(dtype) for _ in range(source.byte() + 1)]
        (_read_regions if kind == 4 else _read_runs)(source, voxels, s, labels)
    elif kind == 3:
        _read_fixed(source, voxels, s, codebooks, limit)
    else:
        assert kind == 2
        _read_coded(source, voxels, s, codebooks, limit)
    if limit > codebooks.stages:
        assert source.at == len(data)
    return voxels


def _voxels_of(working: list, residuals: list, codebooks) -> np.ndarray:
    """Voxels in C order of working values that are not yet clipped."""
    values, out = codebooks.values, []
    for w, residual in zip(working, residuals):
        w = min(max(w, 0), 65535)
        if values.is_float:
            w = min(max(w + residual * codebooks.residual_step, 0), 65535)
            out.append(np.float32(w + values.first) * np.float32(values.scale))
        else:
            voxel = values.low + (w * (values.span + 1) >> 16) + residual * codebooks.residual_step
            out.append(min(max(voxel, values.low), values.low + values.span))
    side = codebooks.side
    return np.array(out, values.dtype).reshape(side, side, side)


def _working(start: int, codes: list, codebooks) -> list:
    working = [start] * codebooks.side**3
    for j, code in enumerate(codes):
        for k in range(len(working)):
            working[k] += int(codebooks.entries[j, code, k]) << int(codebooks.shifts[j])
    return working


def _read_fixed(source, voxels, s, codebooks, limit) -> None:
    side = codebooks.side
    corners = list(np.ndindex(*(s // side,) * 3))
    means = [source.byte() for _ in corners] if codebooks.codec != "vq" else None
    codes = [[source.byte() for _ in corners] for _ in range(min(codebooks.stages, limit))]
    for k, (z, y, x) in enumerate(corners):
        start = 32768 if means is None else means[k] * 256 + 128
        working = _working(start, [stage[k] for stage in codes], codebooks)
        own = voxels[z * side :, y * side :, x * side :][:side, :side, :side]
        own[:] = _voxels_of(working, [0] * side**3, codebooks)


def _read_coded(source, voxels, s, codebooks, limit) -> None:
    dtype = codebooks.values.dtype
    octants = list(np.ndindex(*(s // 8,) * 3)) if s > 4 else [(0, 0, 0)]
    split = [True]
    if s > 4:
        flags = int.from_bytes(source.bytes(-(-len(octants) // 8)), "little")
        split = [bool(flags >> k & 1) for k in range(len(octants))]
    subs = []  # corner and mean of each sub-block of split octants
    for (z, y, x), is_split in zip(octants, split):
        if not is_split:
            mean = source.byte()
            for part in np.ndindex(2, 2, 2):
                corner = tuple(8 * a + 4 * b for a, b in zip((z, y, x), part))
                _put(voxels, corner, _voxels_of([mean * 256 + 128] * 64, [0] * 64, codebooks))
        elif s == 4:
            subs.append(((0, 0, 0), source.byte()))
        else:
            for k in range(8):
                corner = 8 * z + 4 * (k >> 2), 8 * y + 4 * (k >> 1 & 1), 8 * x + 4 * (k & 1)
                subs.append((corner, source.byte()))
    if s == 4:
        depths = [source.byte()]
    else:
        depths = []
        for _ in range(len(subs) // 2):
            both = source.byte()
            depths += [both & 15, both >> 4]
    heads = [source.byte() if depth == 15 else None for depth in depths]
    stages = [depth if head is None else 0 if head == 255 else head & 15 for depth, head in zip(depths, heads)]
    codes: list = [[] for _ in subs]
    for j in range(min(codebooks.stages, limit)):
        for k, depth in enumerate(stages):
            if depth > j:
                codes[k].append(source.byte())
    for k, (corner, mean) in enumerate(subs):
        residuals, raw = [0] * 64, None
        head = heads[k]
        if head is not None and limit > codebooks.stages:
            if head == 255:
                raw = [source.sample(dtype) for _ in range(64)]
            else:
                bits = head >> 4
                packed = int.from_bytes(source.bytes(8 * bits), "little")
                for n in range(64):
                    own = packed >> n * bits & (1 << bits) - 1
                    residuals[n] = own - (1 << bits) if bits and own >> bits - 1 else own
        if raw is None:
            own = _voxels_of(_working(mean * 256 + 128, codes[k], codebooks), residuals, codebooks)
        else:
            own = np.array(raw, dtype).reshape(4, 4, 4)
        _put(voxels, corner, own)


def _put(voxels, corner, own) -> None:
    z, y, x = corner
    voxels[z : z + 4, y : y + 4, x : x + 4] = own


def _read_runs(source, voxels, s, labels) -> None:
    count = int.from_bytes(source.bytes(2), "little") + 1
    lengths = [int.from_bytes(source.bytes(2), "little") + 1 for _ in range(count)]
    samples = [labels[source.byte()] for _ in lengths]
    voxels[:] = np.repeat(np.array(samples, voxels.dtype), lengths).reshape(s, s, s)


def _read_regions(source, voxels, s, labels) -> None:
    octants = list(np.ndindex(*(s // 8,) * 3)) if s > 4 else [(0, 0, 0)]
    parts = []  # of octant after octant: corner, edge, and whether it has a type
    flags = int.from_bytes(source.bytes(-(-len(octants) // 8)), "little") if s > 4 else 0
    for k, (z, y, x) in enumerate(octants):
        if s == 4:
            parts.append(((0, 0, 0), 4, True))
        elif flags >> k & 1:
            parts += [((8 * z + 4 * a, 8 * y + 4 * b, 8 * x + 4 * c), 4, True) for a, b, c in np.ndindex(2, 2, 2)]
        else:
            parts.append(((8 * z, 8 * y, 8 * x), 8, False))
    typed = sum(has_type for *_, has_type in parts)
    packed = int.from_bytes(source.bytes(-(-typed // 4)), "little")
    types, seen = [], 0
    for *_, has_type in parts:
        types.append(packed >> 2 * seen & 3 if has_type else 0)
        seen += has_type
    bits = _index_bits(labels)
    counts = [(1, 2, 4, 0)[kind] for kind in types]
    packed = int.from_bytes(source.bytes(-(-sum(counts) * bits // 8)), "little")
    at, parted = 0, []
    for count in counts:
        parted.append([packed >> (at + k) * bits & (1 << bits) - 1 for k in range(count)])
        at += count
    found = []
    for (corner, edge, _), kind, own in zip(parts, types, parted):
        planes = [(source.byte(), source.byte()) for _ in range((0, 1, 2, bits)[kind])]
        found.append((corner, edge, kind, own, planes))
    for corner, edge, kind, own, planes in found:
        numbers = [0] * edge**3
        for p, (mixed, ones) in enumerate(planes):
            for c, cell in enumerate(CELLS):
                byte = source.byte() if mixed >> c & 1 else 255 * (ones >> c & 1)
                for i, k in enumerate(cell):
                    numbers[k] |= (byte >> i & 1) << p
        z, y, x = corner
        for number, place in zip(numbers, np.ndindex(edge, edge, edge)):
            label = labels[number if kind == 3 else own[number]]
            voxels[z + place[0], y + place[1], x + place[2]] = label
