"""clvol store with codecs of codes, and what clvol info says of such stores."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from clvol.opencl.devices import report_of
from clvol.store.zarr_store import open_store

SHAPE = (64, 80, 100)  # large enough for codebooks to pay


@pytest.fixture
def volume(folder):
    rng = np.random.default_rng(0)
    z, y, x = np.indices(SHAPE)
    data = (100 + 80 * np.sin(z / 9) * np.cos(y / 7) * np.sin(x / 11) + rng.normal(0, 2, SHAPE)).astype(np.uint8)
    np.save(folder / "v.npy", data)
    return data


def test_what_was_measured_is_what_info_says(run, folder, volume):
    how = ("--codec", "rvq", "--max-voxel-error", 0.03, "--shard", 32)
    outcome = run("store", "v.npy", "-o", "v.zarr", *how)
    assert (outcome.status, outcome.out, outcome.err) == (0, "v.zarr\n", "")
    store = open_store(folder / "v.zarr")
    off = np.abs(store.volume_level(0).astype(float) - volume)
    extent = float(np.ptp(volume))
    assert 0 < off.max() <= 0.03 * extent
    facts = json.loads(run("info", "v.zarr", "--json").out)["store"]
    assert facts["codecs"] == ["rvq"] * 3 + ["zstd"] * 2 and not facts["lossless"]
    codes = facts["codes"]
    assert codes["psnr"] == pytest.approx(10 * math.log10(extent**2 / np.mean(off**2)))
    assert codes["max_voxel_error"] == pytest.approx(off.max() / extent)
    assert codes["target"] == {"max_voxel_error": 0.03} and codes["codec"] == "rvq"
    assert codes["original"] == {"dtype": "uint8", "value_range": [volume.min(), volume.max()]}
    size = {p: p.stat().st_size for p in (folder / "v.zarr").rglob("*") if p.is_file()}
    own = sum(n for p, n in size.items() if p.relative_to(folder / "v.zarr").parts[0] in ("0", "codebooks"))
    assert codes["bits_per_voxel"] == pytest.approx(8 * own / volume.size)
    whole = sum(size.values()) - size[folder / "v.zarr/zarr.json"]
    assert codes["bits_per_voxel_all"] == pytest.approx(8 * whole / volume.size)
    said = run("info", "v.zarr").out
    assert f"PSNR {codes['psnr']:.2f} dB" in said and "% of the range" in said
    assert f"{codes['bits_per_voxel']:.3g} at full resolution" in said and "max_voxel_error 0.03" in said


def test_devices_that_share_the_blocks_write_the_same_bytes(run, folder, volume, device):
    name = report_of(device).name
    if device.max_compute_units < 2:
        pytest.skip("the device has one compute unit, which cannot be divided")
    halves = ("--device", f"{name}:1/2", "--device", f"{name}:2/2")
    for output, devices in (("one", ("--device", name)), ("two", halves)):
        assert run("store", "v.npy", "-o", output, "--codec", "rvq", "--psnr", 40, *devices).status == 0
    for file in (folder / "one").rglob("*"):
        if file.is_file():
            assert file.read_bytes() == (folder / "two" / file.relative_to(folder / "one")).read_bytes()


def test_both_devices_write_the_same_bytes(run, folder, volume, each_device):
    run("store", "v.npy", "-o", "default", "--codec", "rvq", "--psnr", 40)
    name = each_device.platform.name
    outcome = run("store", "v.npy", "-o", "other", "--codec", "rvq", "--psnr", 40, "--device", name)
    assert outcome.status == 0, outcome.err
    assert open_store(folder / "other").codebooks.stages > 0
    for file in (folder / "default").rglob("*"):
        if file.is_file():
            assert file.read_bytes() == (folder / "other" / file.relative_to(folder / "default")).read_bytes()


def test_the_seed_is_kept_and_gives_the_same_bytes(run, folder, volume):
    for name in ("a", "b"):
        outcome = run("store", "v.npy", "-o", name, "--codec", "rvq", "--bits-per-voxel", 0.9, "--seed", 7)
        assert (outcome.status, outcome.err) == (0, "")
    codes = json.loads(run("info", "a", "--json").out)["store"]["codes"]
    assert codes["seed"] == 7 and codes["bits_per_voxel"] <= 0.9
    for file in (folder / "a").rglob("*"):
        if file.is_file():
            assert file.read_bytes() == (folder / "b" / file.relative_to(folder / "a")).read_bytes()


def test_fewer_vectors_than_codes_are_exact_and_that_is_said(run, folder):
    tiles = np.random.default_rng(2).integers(0, 256, (9, 4, 4, 4)).astype(np.uint8)
    places = np.random.default_rng(3).integers(0, 9, (16, 16, 16))
    np.save(folder / "t.npy", tiles[places].transpose(0, 3, 1, 4, 2, 5).reshape(64, 64, 64))
    assert run("store", "t.npy", "-o", "t", "--codec", "rvq", "--max-voxel-error", 0.001, "--quiet").status == 0
    codes = json.loads(run("info", "t", "--json").out)["store"]["codes"]
    assert codes["max_voxel_error"] == 0 and 1 <= codes["distinct_vectors"] <= 9
    assert f"{codes['distinct_vectors']} distinct ones, fewer than codes, each exact" in run("info", "t").out


def test_a_psnr_is_reached_however_high(run, folder, volume):
    for psnr in (44, 90):
        outcome = run("store", "v.npy", "-o", f"{psnr}", "--codec", "rvq", "--psnr", psnr)
        assert (outcome.status, outcome.err) == (0, "")
        reached = json.loads(run("info", f"{psnr}", "--json").out)["store"]["codes"]["psnr"]
        assert reached is None or reached >= psnr


def test_float64_is_said_to_become_float32(run, folder, volume):
    np.save(folder / "f.npy", volume / 7)
    outcome = run("store", "f.npy", "-o", "f", "--codec", "vq")
    assert outcome.status == 0 and outcome.err.count("\n") == 1
    assert "voxels of float64 are stored as float32 by the codec vq; lossless codecs keep their type" in outcome.err
    assert f"float64, {volume.min() / 7:.9g} to" in run("info", "f").out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--codec", "rvq", "--psnr", 40, "--bits-per-voxel", 1], "--bits-per-voxel: together with psnr"),
        (["--max-voxel-error", 0.1], "--max-voxel-error: with the lossless codec 'blosc-lz4'"),
        (["--codec", "rvq", "--max-voxel-error", 0], "--max-voxel-error: got 0.0, expected more than 0, at most 1"),
        (["--codec", "rvq", "--psnr", "nan"], "--psnr: got nan"),
        (["--codec", "zstd", "--device", "pocl"], "--device: got 'pocl' with the codec 'zstd', expected a lossy codec"),
        (["--codec", "zstd", "--seed", 3], "--seed: got 3 with the codec 'zstd', expected a lossy codec"),
        (["--codec", "rvq", "--bits-per-voxel", 0.001], "--bits-per-voxel: got 0.001, less than constant blocks take"),
        (["--codec", "rvq", "--device", "none such"], "none such"),
        (["--codec", "vq9"], "--codec: got 'vq9', expected one of blosc-lz4, zstd, none, rvq"),
    ],
)
def test_impossible_wishes_are_one_line_and_leave_nothing(refused, folder, volume, nothing_left, arguments, said):
    assert said in refused(3 if "none such" in said else 2, "store", "v.npy", "-o", "x", *arguments)


def test_labels_are_refused_and_the_lossless_codec_is_named(refused, folder, nothing_left):
    nibabel = pytest.importorskip("nibabel")
    image = nibabel.Nifti1Image(np.arange(64, dtype=np.uint8).reshape(4, 4, 4), np.eye(4))
    image.header.set_intent("label")
    nibabel.save(image, folder / "l.nii")
    line = refused(2, "store", "l.nii", "-o", "x", "--codec", "rvq")
    assert line.startswith("--codec: got 'rvq' for labels, which it would turn into other labels, expected 'labels'")
    (folder / "l.nii").unlink()
