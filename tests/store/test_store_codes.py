"""Stores that hold codes: statistics and errors are those of what is decoded, and bounds hold for all voxels."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT
from helpers.stub_trainer import StubEncoder, StubTrainer

from clvol.errors import ClvolWarning, RenderError, UsageError, VolumeError
from clvol.readers import load_volume
from clvol.store.build import build_store
from clvol.store.codecs import CODES
from clvol.store.codecs.coded_blocks import CONSTANT, RAW, CodedBlocks, RateTarget
from clvol.store.codecs.decode import decode_blocks
from clvol.store.volume_blocks import VolumeBlocks
from clvol.store.voxel_source import VolumeSource
from clvol.store.zarr_store import open_store
from clvol.volume import Grid, Volume

LOSSY = [codec.name for codec in CODES.values() if not codec.lossless]
TYPES = ("uint8", "int8", "uint16", "int16", "float32")
SHAPE = (40, 35, 66)
BOUND = RateTarget(max_voxel_error=0.05)


def voxels(shape=SHAPE, dtype="uint8", seed: int = 0) -> np.ndarray:
    """Smooth and noisy parts, a constant block, and of floating-point types NaN and infinite voxels."""
    rng = np.random.default_rng(seed)
    z, y, x = np.indices(shape)
    values = 60 + 50 * np.sin(z / 9) * np.cos(y / 7) * np.sin(x / 11) + rng.normal(0, 1, shape) * (x > 40)
    values[:16, :16, 16:32] = 33
    values = values.astype(dtype)
    if values.dtype.kind == "f":
        values[rng.random(shape) < 0.001] = np.nan
        values.flat[3:4] = np.inf
        values[:16, :16, :16] = np.nan
    return values


def coded(volume: Volume | np.ndarray, path: Path, codec: str = "rvq", target: RateTarget | None = BOUND, **settings):
    volume = volume if isinstance(volume, Volume) else Volume(volume)
    target = None if codec == "labels" else target
    return build_store(
        volume, path, codec=codec, target=target, trainer=StubTrainer(), **{"shard": 32, **settings}
    )


def joined(source) -> dict[str, np.ndarray]:
    names = ("minimum", "maximum", "mean", "quantiles", "deviation", "reach_low", "reach_high", "holes")
    parts = list(source.statistics())
    by_level = {name: getattr(parts[0], name).ndim > 1 for name in names}
    return {name: np.concatenate([getattr(p, name) for p in parts], int(by_level[name])) for name in names}


def assert_measured(store, original: np.ndarray) -> None:
    """What the root says of errors and bytes is what decoding and counting give."""
    measured, decoded = store.codes.measured, store.volume_level(0)
    finite = np.isfinite(original)
    np.testing.assert_array_equal(decoded[~finite], original[~finite])
    low, high = store.codes.original_range
    off = decoded[finite].astype(float) - original[finite].astype(float)
    extent = high - low
    if off.any():
        assert measured.psnr == pytest.approx(10 * math.log10(extent**2 / np.mean(off**2)))
        assert measured.max_voxel_error == pytest.approx(np.abs(off).max() / extent)
    else:
        assert (measured.psnr, measured.max_voxel_error) == (math.inf, 0)
    size = {p: p.stat().st_size for p in Path(store.path).rglob("*") if p.is_file()}
    top = Path(store.path)
    own = sum(n for p, n in size.items() if p.relative_to(top).parts[0] in ("0", "codebooks"))
    assert measured.bits_per_voxel == pytest.approx(8 * own / original.size)
    whole = sum(size.values()) - size[top / "zarr.json"]
    assert store.codes.bits_per_voxel_all == pytest.approx(8 * whole / original.size)


@pytest.mark.parametrize("shape", ((1, 17, 33), (33, 1, 1), (1, 1, 1), SHAPE))
@pytest.mark.parametrize("dtype", TYPES)
def test_a_bound_holds_for_every_voxel(tmp_path, dtype, shape):
    data = voxels(shape, dtype)
    store = coded(data, tmp_path / "s")
    assert store.dtype == data.dtype
    decoded, finite = store.volume_level(0), np.isfinite(data)
    if finite.any():
        off = np.abs(decoded[finite].astype(float) - data[finite])
        assert off.max() <= 0.05 * np.ptp(data[finite].astype(float))
    assert_measured(store, data)
    assert [c.coded for c in store.layout.codecs] == [True, True, True, False, False]


@pytest.mark.parametrize("edge", (4, 8, 16, 32))
@pytest.mark.parametrize("codec", LOSSY)
def test_every_way_of_reading_gives_what_the_codes_say(tmp_path, codec, edge):
    data = voxels((37, 41, 50), "int16")
    store = coded(data, tmp_path / "s", codec, None, edge=edge, shard=3 * edge)
    assert_measured(store, data)
    every = np.random.default_rng(1).permutation(store.blocks.count)
    for level in range(store.blocks.levels):
        s = store.blocks.samples(level)
        whole, blocks = store.volume_level(level), store.read(level, every)
        assert store.layout.codecs[level].coded == (s >= 4)
        padded = np.pad(whole, [(0, c * s - n) for c, n in zip(store.blocks.counts, whole.shape)], mode="edge")
        for place, samples in zip(store.blocks.places(every), blocks):
            here = tuple(slice(p * s, p * s + s) for p in place)
            np.testing.assert_array_equal(samples, padded[here])
        if s < 4:
            with pytest.raises(ValueError, match="holds samples"):
                store.read_codes(level, every)
            continue
        codes = store.read_codes(level, every)
        assert len(codes) == len(every) and codes.size.sum() == len(codes.data)
        inside = (store.blocks.places(every) < np.array(whole.shape) // s).all(axis=1)
        found = decode_blocks(codes, s, store.codebooks)
        np.testing.assert_array_equal(found[inside], blocks[inside])
        two = store.read_codes(level, every[:2])
        assert bytes(two.data) == bytes(codes.data[: codes.start[1] + codes.size[1]])
    for z0, z1, y0, y1, x0, x1 in ((0, 37, 0, 41, 0, 50), (5, 6, 31, 33, 16, 50), (36, 37, 40, 41, 49, 50)):
        np.testing.assert_array_equal(store.box(z0, z1, y0, y1, x0, x1), store.volume_level(0)[z0:z1, y0:y1, x0:x1])
    assert len(store.read_codes(0, np.array([], int))) == 0 and store.read(0, np.array([], int)).size == 0


@pytest.mark.parametrize("codec", ("rvq", "hvq"))
@pytest.mark.parametrize("dtype", ("uint8", "int16", "float32"))
def test_statistics_are_those_of_decoded_samples(tmp_path, dtype, codec):
    """With neighbours in other regions, which are decoded, too."""
    store = coded(voxels((70, 40, 66), dtype), tmp_path / "s", codec, None)
    decoded = store.volume_level(0)
    found, wanted = joined(store), joined(VolumeBlocks(Volume(decoded)))
    for name in ("reach_low", "reach_high", "holes"):
        np.testing.assert_array_equal(found[name], wanted[name], err_msg=name)
    for name in ("minimum", "maximum", "mean", "quantiles"):
        np.testing.assert_allclose(found[name][0], wanted[name][0], rtol=1e-6, err_msg=name)
    every = np.arange(store.blocks.count)
    full = store.read(0, every).astype(np.float64)
    for level in range(store.blocks.levels):
        samples = store.read(level, every).astype(np.float64)
        flat = np.where(np.isfinite(samples), samples, np.nan).reshape(len(every), -1)
        some = ~np.isnan(flat).all(axis=1)
        np.testing.assert_allclose(found["minimum"][level][some], np.nanmin(flat[some], axis=1))
        np.testing.assert_allclose(found["maximum"][level][some], np.nanmax(flat[some], axis=1))
        np.testing.assert_allclose(found["mean"][level][some], np.nanmean(flat[some], axis=1), rtol=1e-5)
        fine = samples
        for axis in (1, 2, 3):
            fine = np.repeat(fine, 1 << level, axis=axis)
        with np.errstate(invalid="ignore"):
            squares = np.where(np.isfinite(fine - full), fine - full, np.nan) ** 2
        rms = np.sqrt(np.nanmean(squares[some].reshape(some.sum(), -1), axis=1))
        whole = np.isfinite(rms)
        np.testing.assert_allclose(found["deviation"][level][some][whole], rms[whole], rtol=1e-4, atol=1e-4)
    finite = decoded[np.isfinite(decoded)]
    assert store.value_range == (finite.min(), finite.max())
    assert (store.nan_count, store.inf_count) == (np.isnan(decoded).sum(), np.isinf(decoded).sum())


def test_levels_are_means_of_original_voxels(tmp_path):
    data = voxels(dtype="int16")
    store = coded(data, tmp_path / "s", "hvq", None)
    plain = build_store(Volume(data), tmp_path / "plain", shard=32)
    for level in (3, 4):
        np.testing.assert_array_equal(store.volume_level(level), plain.volume_level(level))


def test_a_bound_that_is_broken_is_an_error_that_says_where(tmp_path, monkeypatch):
    """Whatever the encoder claims."""
    real = StubEncoder.encode

    def worse(self, samples):
        self.training.policy["bound"] = None
        return real(self, samples)

    monkeypatch.setattr(StubEncoder, "encode", worse)
    with pytest.raises(RenderError, match=r"level \d, the samples from \(.*of the range, expected at most 0.05"):
        coded(voxels(), tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_an_encoder_that_loses_nan_is_an_error(tmp_path, monkeypatch):
    def zeros(self, samples):
        data = np.frombuffer(bytes([CONSTANT]) + np.float32(60).tobytes(), np.uint8)
        return CodedBlocks(data, np.zeros(len(samples), np.int64), np.full(len(samples), 5))

    monkeypatch.setattr(StubEncoder, "encode", zeros)
    with pytest.raises(RenderError, match="which voxels are finite"):
        coded(voxels(dtype="float32"), tmp_path / "s", "rvq", None)


# ---- hard cases ----------------------------------------------------------------------------------


@pytest.mark.parametrize("codec", LOSSY)
@pytest.mark.parametrize("value", (0, 7, -100, 1e30, np.nan, -np.inf))
def test_constant_volumes_are_exact(tmp_path, value, codec):
    data = np.full((20, 33, 17), value, np.float32 if not abs(value) <= 100 else np.int16)
    store = coded(data, tmp_path / "s", codec)
    np.testing.assert_array_equal(store.volume_level(0), data)
    assert_measured(store, data)
    assert (store.read_codes(0, [0]).data[0]) == CONSTANT or not np.isfinite(value)


@pytest.mark.parametrize("scale", (1e30, 1e-30, 3e38))
def test_large_and_small_values(tmp_path, scale):
    data = (np.sin(np.arange(33 * 20 * 20) / 40).reshape(33, 20, 20) * scale).astype(np.float32)
    store = coded(data, tmp_path / "s")
    extent = float(data.max()) - float(data.min())
    off = np.abs(store.volume_level(0).astype(float) - data).max()
    assert off <= 0.05 * extent
    assert_measured(store, data)


def test_float64_is_held_as_float32_and_that_is_said(tmp_path):
    data = np.sin(np.arange(40**3) / 50).reshape(40, 40, 40)
    with pytest.warns(ClvolWarning, match="float32"):
        store = coded(data, tmp_path / "s")
    assert store.dtype == np.float32 and store.codes.original_dtype == np.float64
    assert np.abs(store.volume_level(0) - data).max() <= 0.05 * np.ptp(data)
    assert_measured(store, data)
    with pytest.warns(ClvolWarning), pytest.raises(VolumeError, match="1e\\+300, which float32 cannot hold"):
        coded(np.where(data > 0, 1e300, 0.0), tmp_path / "t")
    with pytest.warns(ClvolWarning), pytest.raises(UsageError, match="rounding to float32"):
        coded(1e9 + data, tmp_path / "t")


@pytest.mark.parametrize("dtype", ("uint8", "uint16", "float32"))
def test_noise_takes_hardly_more_than_raw(tmp_path, dtype):
    """The whole store beside one whose samples are not compressed; an encoder that does not give up is overruled."""
    rng = np.random.default_rng(5)
    data = rng.integers(0, 256, (64, 64, 64 * np.dtype(dtype).itemsize), np.uint8).view(dtype)
    if dtype == "float32":
        data = rng.normal(0, 1, data.shape).astype(np.float32)
    raw = build_store(Volume(data), tmp_path / "raw", shard=64, codec="none")
    store = coded(data, tmp_path / "s", "rvq", RateTarget(max_voxel_error=1e-6), shard=64)
    np.testing.assert_array_equal(store.volume_level(0), data)
    codes = store.read_codes(0, np.arange(store.blocks.count))
    assert set(codes.data[codes.start]) == {RAW}
    assert store.bytes_on_disk <= 1.01 * raw.bytes_on_disk
    assert store.codes.measured.bits_per_voxel <= 1.01 * 8 * data.itemsize


def test_where_codebooks_cost_more_than_they_save_there_are_none(tmp_path):
    """All is then stored as it is, and decoded as it was."""
    data = np.random.default_rng(1).integers(0, 256, (16, 16, 16), np.uint8)
    for codec in LOSSY:
        store = coded(data, tmp_path / codec, codec, RateTarget(max_voxel_error=1e-6), shard=16)
        np.testing.assert_array_equal(store.volume_level(0), data)
        assert store.codes.policy["without_codes"] and not store.codebooks.entries.any()
        codes = next((tmp_path / codec / "0/c").rglob("0")).parent
        assert sum(p.stat().st_size for p in codes.rglob("*") if p.is_file()) <= 1.02 * data.nbytes + 40
        assert_measured(store, data)
    assert not (tmp_path / "rvq/codebooks").exists()


def test_an_encoder_that_fails_is_no_full_disk(tmp_path, monkeypatch):
    def failing(self, samples):
        raise ValueError("operands could not be broadcast")

    monkeypatch.setattr(StubEncoder, "encode", failing)
    with pytest.raises(RenderError, match="level 0, the samples from .*: encoding failed: operands could not be"):
        coded(voxels(), tmp_path / "s")


def test_impossible_codes_of_an_encoder_are_an_error(tmp_path, monkeypatch):
    def nonsense(self, samples):
        return CodedBlocks(np.full(9, 88, np.uint8), np.zeros(len(samples), np.int64), np.full(len(samples), 9))

    monkeypatch.setattr(StubEncoder, "encode", nonsense)
    with pytest.raises(RenderError, match="level 0, the samples from .*: the encoder made impossible codes"):
        coded(voxels(), tmp_path / "s")


# ---- labels --------------------------------------------------------------------------------------


@pytest.mark.parametrize("codec", LOSSY)
def test_a_lossy_codec_for_labels_is_refused(tmp_path, codec):
    for volume in (Volume(voxels(), labels=True), Volume(voxels() > 60)):
        with pytest.raises(UsageError, match="--codec labels|codec.*labels") as error:
            coded(volume, tmp_path / "s", codec)
        assert "\n" not in str(error.value) and list(tmp_path.iterdir()) == []


# ---- metadata ------------------------------------------------------------------------------------


@pytest.mark.parametrize("codec", LOSSY)
def test_the_metadata_claim_only_levels_of_samples_to_be_an_image(tmp_path, codec):
    zarr = pytest.importorskip("zarr")
    coded(Volume(voxels(), (0.5, 1, 2), (7, 8, 9)), tmp_path / "s", codec, None)
    group = zarr.open_group(str(tmp_path / "s"), mode="r")
    (multiscale,) = group.attrs["ome"]["multiscales"]
    assert [dataset["path"] for dataset in multiscale["datasets"]] == ["3", "4"]
    assert multiscale["datasets"][0]["coordinateTransformations"][0]["scale"] == [16, 8, 4]
    assert group["3"].shape == (5, 5, 9) and group["0"].dtype == np.uint8
    assert group["0"].attrs["clvol-codes"] == codec
    assert group["codebooks"].dtype == np.int8
    with pytest.raises(VolumeError, match="holds codes") as error:
        load_volume(tmp_path / "s" / "0")
    assert "\n" not in str(error.value)


def test_what_the_store_says_of_its_codes(tmp_path):
    store = coded(voxels(), tmp_path / "s", seed=3)
    root = json.loads((tmp_path / "s/zarr.json").read_text())["attributes"]["clvol"]
    assert root["codes"]["seed"] == 3 and root["codes"]["target"] == {"max_voxel_error": 0.05}
    again = open_store(tmp_path / "s").codes
    assert (again.target, again.seed, again.codec) == (BOUND, 3, "rvq")
    assert again.measured == store.codes.measured
    loaded = load_volume(tmp_path / "s")
    np.testing.assert_array_equal(loaded.data, store.volume_level(0))
    assert loaded.value_range == store.value_range


def test_a_turned_store_decodes_on_the_host_only(tmp_path):
    """Its codes are of voxels in their own order."""
    store = coded(Volume(voxels(), slope=-2.0, offset=5.0), tmp_path / "s")
    loaded = load_volume(tmp_path / "s")
    turned = loaded.turned() if hasattr(loaded, "turned") else loaded._turned()
    assert store.codebooks is not None and turned.blocks_source.codebooks is None
    np.testing.assert_array_equal(turned.data, 255 - store.volume_level(0))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"codec": "zstd"}, "max_voxel_error: with the lossless codec"),
        ({"codec": "labels"}, "max_voxel_error: with the lossless codec"),
        ({"target": RateTarget(psnr=40, bits_per_voxel=1)}, "bits_per_voxel: together with psnr"),
        ({"target": RateTarget(max_voxel_error=0.0)}, "max_voxel_error: got 0.0"),
        ({"target": RateTarget(psnr=math.nan)}, "psnr: got nan"),
        ({"target": RateTarget(bits_per_voxel=-1)}, "bits_per_voxel: got -1"),
        ({"trainer": None}, "trainer: got None"),
        ({"codec": "vq-9"}, "codec: got 'vq-9'"),
    ],
)
def test_impossible_wishes_are_refused_before_the_work(tmp_path, settings, said):
    with pytest.raises(UsageError) as error:
        settings = {"codec": "rvq", "target": BOUND, "trainer": StubTrainer()} | settings
        build_store(Volume(voxels()), tmp_path / "s", **settings)
    assert str(error.value).startswith(said) and list(tmp_path.iterdir()) == []


_GENERATED = """
import resource, sys
sys.path[:0] = [sys.argv[2]]
import numpy as np
from helpers.stub_trainer import StubTrainer
from clvol.store.build import build_store
from clvol.volume import Grid

class Generated:
    shape, dtype, identity = (384, 512, 512), np.dtype(np.uint16), {}
    name, frame = "generated", "index"
    grid = Grid(shape)

    def box(self, z0, z1, y0, y1, x0, x1):
        z, y, x = (np.arange(a, b).astype(np.uint16) >> 4 for a, b in ((z0, z1), (y0, y1), (x0, x1)))
        return 1000 * (z[:, None, None] ^ y[:, None] ^ x)

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

import tensorstore
before = peak()
store = build_store(Generated(), sys.argv[1], codec="rvq", trainer=StubTrainer(), workers=2)
for part in store.statistics():
    pass
print(peak() - before)
"""


def test_building_takes_less_memory_than_the_volume(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", _GENERATED, str(tmp_path / "s"), str(ROOT / "tests")], capture_output=True, text=True,
        timeout=300, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 2 * 384 * 512**2 * 0.75


def test_sources_are_read_in_boxes(tmp_path):
    """Only boxes of the source are read, none larger than a region."""

    class Boxes(VolumeSource):
        largest = 0

        def box(self, *bounds):
            found = super().box(*bounds)
            self.largest = max(self.largest, found.size)
            return found

    source = Boxes(Volume(voxels((70, 70, 70))))
    store = build_store(source, tmp_path / "s", codec="rvq", target=BOUND, trainer=StubTrainer(), shard=32)
    assert source.largest <= 34**3 and store.grid == Grid((70, 70, 70))


# ---- the codec of labels -------------------------------------------------------------------------


def segments(shape, dtype, seed: int = 0) -> np.ndarray:
    """Cells of some points, each of a label of its own, and specks."""
    rng = np.random.default_rng(seed)
    points = rng.random((40, 3)) * shape
    places = np.stack(np.indices(shape), -1).reshape(-1, 3)
    nearest = ((places[:, None] - points) ** 2).sum(axis=2).argmin(axis=1).reshape(shape)
    nearest[rng.random(shape) < 0.01] = 99
    return nearest.astype(dtype) * np.array(3, dtype)


def most_frequent(data: np.ndarray, level: int) -> np.ndarray:
    edge = 1 << level
    out = np.empty([-(-n // edge) for n in data.shape], data.dtype)
    for place in np.ndindex(out.shape):
        own = data[tuple(slice(p * edge, (p + 1) * edge) for p in place)]
        labels, counts = np.unique(own, return_counts=True)
        out[place] = labels[counts.argmax()]
    return out


@pytest.mark.parametrize("shape", ((1, 17, 33), (20, 35, 40)))
@pytest.mark.parametrize("dtype", ("uint8", "uint16", "float32", "float64"))
def test_labels_are_exact_at_every_level_and_levels_invent_none(tmp_path, dtype, shape):
    data = segments(shape, dtype)
    store = coded(Volume(data, labels=True), tmp_path / "s", "labels")
    for level in range(store.blocks.levels):
        np.testing.assert_array_equal(store.volume_level(level), most_frequent(data, level))
    assert_measured(store, data)
    assert store.value_range == (data.min(), data.max())
    assert all(codec.lossless for codec in store.layout.codecs) and store.codes.measured.psnr == math.inf
    assert load_volume(tmp_path / "s").labels
    assert store.codebooks.codec == "labels" and not (tmp_path / "s/codebooks").exists()


def test_negative_labels_and_the_metadata(tmp_path):
    data = segments((20, 20, 20), "int16") - np.int16(50)
    store = coded(Volume(data, labels=True), tmp_path / "s", "labels")
    np.testing.assert_array_equal(store.volume_level(0), data)
    assert np.isin(store.volume_level(2), data).all()
    root = json.loads((tmp_path / "s/zarr.json").read_text())
    (multiscale,) = root["attributes"]["ome"]["multiscales"]
    assert (multiscale["type"], len(multiscale["datasets"])) == ("mode", 2)


def test_labels_take_less_than_their_voxels_compressed(tmp_path):
    data = segments((64, 64, 64), "uint16")
    codes = coded(Volume(data, labels=True), tmp_path / "s", "labels", shard=64)
    plain = build_store(Volume(data, labels=True), tmp_path / "plain", shard=64)
    level = sum(p.stat().st_size for p in (tmp_path / "plain/0").rglob("*") if p.is_file())
    assert codes.codes.measured.bits_per_voxel * data.size / 8 < level
    np.testing.assert_array_equal(plain.volume_level(0), data)


@pytest.mark.parametrize(
    ("target", "said"),
    [
        (RateTarget(psnr=90), r"s: PSNR \d\d\.\d\d dB, less than 90"),
        (RateTarget(bits_per_voxel=0.1), r"s: [\d.]+ bits per voxel, more than 0.1"),
    ],
)
def test_a_target_that_was_missed_is_said(tmp_path, target, said):
    """The stub keeps to neither."""
    with pytest.warns(ClvolWarning, match=said):
        coded(voxels(), tmp_path / "s", "vq", target)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        coded(voxels(), tmp_path / "t", "vq", RateTarget(psnr=10))
