"""Random blocks of codes that are possible: every kind, codec, size and type, by a seed."""

from __future__ import annotations

import numpy as np

from clvol.store.codecs.coded_blocks import SHAPES, Codebooks, CodedBlocks
from clvol.store.codecs.labels import label_codebooks
from clvol.store.codecs.working_values import WorkingValues
from reference.plain_codes import Coded, Constant, Fixed, Labelled, Raw, Regions, Runs, SubBlock, write

DTYPES = ("uint8", "int8", "uint16", "int16", "float32")
LOSSY = ("rvq", "hvq", "vq-mean", "vq")
CODECS = (*LOSSY, "labels")


def random_values(rng: np.random.Generator, dtype: str, whole: bool = False) -> WorkingValues:
    """A map of working values; ``whole``: over the whole range of an integer type."""
    kind = np.dtype(dtype)
    if kind.kind == "f":
        scale = float(np.float32(rng.random() + 0.1))
        return WorkingValues(kind, first=int(rng.integers(-(2**20), 2**20)), scale=scale)
    info = np.iinfo(kind)
    low, high = (info.min, info.max) if whole else np.sort(rng.integers(info.min, info.max + 1, 2))
    return WorkingValues(kind, int(low), int(high) - int(low))


def random_codebooks(
    rng: np.random.Generator, codec: str, dtype: str, stages: int | None = None, whole: bool = False
) -> Codebooks:
    if codec == "labels":
        return label_codebooks(np.dtype(dtype))
    side, fewest, most = SHAPES[codec]
    stages = int(rng.integers(max(fewest, 1), most + 1)) if stages is None else stages
    entries = rng.integers(-128, 128, (stages, 256, side**3)).astype(np.int8)
    if codec == "hvq":  # the first stage: means of 2^3 samples
        means = rng.integers(-128, 128, (256, 2, 2, 2)).astype(np.int8)
        entries[0] = means.repeat(2, 1).repeat(2, 2).repeat(2, 3).reshape(256, 64)
    shifts = np.sort(rng.integers(0, 10, stages))[::-1].astype(np.int32)
    return Codebooks(codec, side, entries, shifts, random_values(rng, dtype, whole), int(rng.integers(1, 9)))


def random_samples(rng: np.random.Generator, dtype: np.dtype, count: int) -> list:
    if dtype.kind == "f":
        odd = rng.choice([np.nan, np.inf, -np.inf, -0.0, 1e30, 1e-42], count)
        usual = rng.normal(0, 100, count)
        return np.where(rng.random(count) < 0.3, odd, usual).astype(np.float32).tolist()
    info = np.iinfo(dtype)
    return rng.integers(info.min, info.max + 1, count).tolist()


def random_subblock(rng: np.random.Generator, codebooks: Codebooks, escapes: float = 0.2) -> SubBlock:
    mean = int(rng.integers(256))
    codes = rng.integers(0, 256, int(rng.integers(codebooks.stages + 1))).tolist()
    if rng.random() >= escapes:
        return SubBlock(mean, codes)
    if rng.random() < 0.3:
        return SubBlock(mean, raw=random_samples(rng, codebooks.values.dtype, 64))
    bits = int(rng.integers(9))
    half = 1 << bits >> 1
    residuals = rng.integers(-half, max(half, 1), 64).tolist()
    return SubBlock(mean, codes, bits, residuals)


def random_block(rng: np.random.Generator, s: int, codebooks: Codebooks):
    """A block of any kind that the codec has; kinds of its own most often."""
    draw = rng.random()
    dtype = codebooks.values.dtype
    if draw < 0.1:
        return Constant(random_samples(rng, dtype, 1)[0])
    if draw < 0.2 or s < 4:
        return Raw(random_samples(rng, dtype, s**3))
    if codebooks.codec == "labels":
        return random_labels(rng, s, dtype)
    if codebooks.codec == "rvq":
        escapes = rng.choice([0.0, 0.05, 0.5])
        split = rng.choice([0.0, 0.5, 1.0]) if s > 4 else 1.0
        octants: list = []
        for _ in range(max(s // 8, 1) ** 3):
            if rng.random() >= split:
                octants.append(int(rng.integers(256)))
            else:
                octants.append([random_subblock(rng, codebooks, escapes) for _ in range(8 if s > 4 else 1)])
        return Coded(octants)
    count = (s // codebooks.side) ** 3
    means = rng.integers(0, 256, count).tolist() if codebooks.codec != "vq" else []
    return Fixed(means, [rng.integers(0, 256, count).tolist() for _ in range(codebooks.stages)])


def random_labels(rng: np.random.Generator, s: int, dtype: np.dtype):
    """A block of labels, which need not be different, by octants or by runs."""
    count = int(rng.choice([1, 2, 3, 4, 5, 16, 17, 256]))
    labels = random_samples(rng, dtype, count)
    if rng.random() < 0.3:
        cuts = np.sort(rng.choice(np.arange(1, s**3), int(rng.integers(min(50, s**3))), replace=False))
        lengths = np.diff(np.concatenate([[0], cuts, [s**3]]))
        return Runs(labels, [(int(length), int(rng.integers(count))) for length in lengths])
    split = rng.choice([0.0, 0.5, 1.0]) if s > 4 else 1.0
    octants: list = []
    for _ in range(max(s // 8, 1) ** 3):
        if rng.random() >= split:
            octants.append(int(rng.integers(count)))
            continue
        subs = []
        for _ in range(8 if s > 4 else 1):
            kind = int(rng.integers(4))
            numbers = rng.integers(0, (1, 2, 4, count)[kind], 64).tolist()
            subs.append(Labelled(kind, rng.integers(0, count, (1, 2, 4, 0)[kind]).tolist(), numbers))
        octants.append(subs)
    return Regions(labels, octants)


def packed(blocks: list[bytes], gap: int = 3) -> CodedBlocks:
    """``blocks`` in one array with ``gap`` bytes between them, so that nothing is aligned; last blocks first."""
    data, start = bytearray(b"\xee" * gap), np.zeros(len(blocks), np.int64)
    for k in reversed(range(len(blocks))):
        start[k] = len(data)
        data += blocks[k] + b"\xee" * gap
    return CodedBlocks(np.frombuffer(bytes(data), np.uint8), start, np.array([len(b) for b in blocks], np.int64))


def random_codes(seed: int, codec: str, s: int, dtype: str, count: int, **options) -> tuple[list[bytes], Codebooks]:
    """``count`` blocks as bytes, and the codebooks that decode them."""
    rng = np.random.default_rng(seed)
    codebooks = random_codebooks(rng, codec, dtype, **options)
    return [write(random_block(rng, s, codebooks), s, codebooks) for _ in range(count)], codebooks
