"""Functions of lanes by themselves, beside numpy: as this processor has them, and as others do."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from clvol.opencl.arguments import reads, value, writes
from clvol.opencl.build import is_pocl

SOURCE = Path(__file__).with_name("lanes_alone.cl")
LANES = 16
ROWS = (
    "packed", "unpacked", "permuted", "permuted by low bits", "permuted8", "gathered from its own", "mask", "bits",
    "any", "bytes", "shorts", "low", "high", "least", "reciprocal", "rough reciprocal", "inverse root",
)  # fmt: skip


def random_packets(packets: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(5)
    n = packets * LANES
    bits = rng.integers(0, 1 << LANES, packets, dtype=np.uint32)
    bits[:18] = [0, 0xFFFF, *(1 << k for k in range(LANES))]
    words = rng.integers(0, 256, 4096, dtype=np.uint8)
    return {
        "v": np.exp2(rng.uniform(-20, 20, n)).astype(np.float32), "bits": bits, "words": words,
        "at": rng.integers(0, LANES, n, dtype=np.int32),
        "offsets": rng.integers(0, (words.size - 8) // 2, n, dtype=np.int32),
    }  # fmt: skip


def results(context, packets: dict[str, np.ndarray], switches: dict[str, int]) -> dict[str, np.ndarray]:
    """uint32 [packets, LANES] by the name of the row."""
    n = packets["v"].size
    kernel = context.kernel(
        SOURCE, "lanes_alone",
        (
            reads("v", np.float32, "n"), reads("at", np.int32, "n"), reads("bits", np.uint32),
            reads("words", np.uint8), reads("offsets", np.int32, "n"), value("n", np.int32),
            writes("results", np.uint32, len(ROWS), "n"),
        ),
        {"LANES": LANES, **switches},
    )  # fmt: skip
    found = context.empty(np.uint32, (len(ROWS), n))
    kernel(context.queue, (n // LANES,), (1,), n=n, results=found,
           **{name: context.upload(array) for name, array in packets.items()})  # fmt: skip
    return dict(zip(ROWS, context.read(found).reshape(len(ROWS), -1, LANES), strict=True))


def has_avx2() -> bool:
    try:
        return " avx2 " in Path("/proc/cpuinfo").read_text(encoding="ascii")
    except OSError:
        return False


@pytest.mark.parametrize("switches", [{}, {"LANES_PORTABLE": 1}, {"LANES_IN_AVX2": 1}], ids=["own", "portable", "avx2"])
def test_lanes_go_where_numpy_says(context, switches):
    if not context.is_cpu:
        pytest.skip("packets are for processors")
    if "LANES_IN_AVX2" in switches and not (is_pocl(context.device) and has_avx2()):
        pytest.skip("the instructions of AVX2 are written for PoCL, and this device or processor has none")
    packets = random_packets(200)
    found = results(context, packets, switches)
    v = packets["v"].reshape(-1, LANES)
    at, offsets = packets["at"].reshape(-1, LANES), packets["offsets"].reshape(-1, LANES)
    is_set = (packets["bits"][:, None] >> np.arange(LANES) & 1).astype(bool)
    rank = np.cumsum(is_set, axis=1) - is_set
    as_bits = lambda a: np.ascontiguousarray(a, np.float32).view(np.uint32)  # noqa: E731
    pick = lambda a, k: np.take_along_axis(a, k, axis=1)  # noqa: E731

    for packet, lanes in enumerate(is_set):
        assert np.array_equal(found["packed"][packet, : lanes.sum()], as_bits(v[packet, lanes]))
    assert np.array_equal(found["unpacked"], as_bits(np.where(is_set, pick(v, rank), 0)))
    assert np.array_equal(found["permuted"], as_bits(pick(v, at)))
    assert np.array_equal(found["permuted by low bits"], found["permuted"])
    assert np.array_equal(found["permuted8"], as_bits(pick(v, at & 7)))
    assert np.array_equal(found["gathered from its own"], as_bits(pick(v, at)))
    assert np.array_equal(found["mask"], np.where(is_set, np.uint32(0xFFFFFFFF), np.uint32(0)))
    assert np.array_equal(found["bits"], np.repeat(packets["bits"][:, None], LANES, axis=1))
    assert np.array_equal(found["any"] != 0, np.repeat(is_set.any(axis=1)[:, None], LANES, axis=1))
    assert np.array_equal(found["least"], np.repeat(at.min(axis=1)[:, None], LANES, axis=1).astype(np.uint32))

    words = packets["words"]
    word = lambda place: np.ascontiguousarray(words[place[..., None] + np.arange(4)]).view("<u4")[..., 0]  # noqa: E731
    assert np.array_equal(found["bytes"], word(offsets)) and np.array_equal(found["shorts"], word(2 * offsets))
    assert np.array_equal(found["low"], word(2 * offsets)) and np.array_equal(found["high"], word(2 * offsets + 4))

    for name, exact, limit in (
        ("reciprocal", 1 / v.astype(float), 2e-7), ("rough reciprocal", 1 / v.astype(float), 7e-5),
        ("inverse root", 1 / np.sqrt(v.astype(float)), 4e-7),
    ):  # fmt: skip
        assert np.abs(found[name].view(np.float32) / exact - 1).max() < limit, name


def test_compilers_write_nothing_to_the_terminal(context, capfd):
    """Vectors that are wider than registers are worth a warning to PoCL's compiler, which says how many there were."""
    if not context.is_cpu:
        pytest.skip("packets are for processors")
    results(context, random_packets(20), {"NEVER_BUILT_BEFORE": time.time_ns() % 2**31})
    said = capfd.readouterr()
    assert said.err == "" and said.out == ""
