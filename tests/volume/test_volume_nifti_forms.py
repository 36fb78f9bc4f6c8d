"""NIfTI: which form says where voxels lie, pairs of files, times and channels."""

from __future__ import annotations

from pathlib import Path

import nibabel
import numpy as np
import pytest
from slice_files import loaded, refusal, voxels

from clvol.readers import load_volume

QFORM = np.array([[0, -2.0, 0, 5], [0.5, 0, 0, 6], [0, 0, 3.0, 7], [0, 0, 0, 1]])
SFORM = np.diag([4.0, 5.0, 6.0, 1.0])
FIELDS = ("srow_x", "srow_y", "srow_z")


def nifti(path: Path, sform: int, qform: int, kind=nibabel.Nifti1Image, **fields) -> Path:
    """Zooms are the qform's; the codes say which of the forms count."""
    header = kind.header_class()
    header.set_data_dtype("<i2")
    header.set_data_shape((8, 7, 6))
    header.set_qform(QFORM, code=qform)
    header.set_sform(SFORM, code=sform)
    for name, value in fields.items():
        header[name] = value
    header["vox_offset"] = header.single_vox_offset
    gap = header.single_vox_offset - header.sizeof_hdr
    path.write_bytes(header.binaryblock + b"\0" * gap + voxels().tobytes())
    return path


@pytest.mark.parametrize("kind", [nibabel.Nifti1Image, nibabel.Nifti2Image])
@pytest.mark.parametrize("sform, qform", [(1, 1), (2, 0), (0, 1)])
def test_the_sform_goes_before_the_qform(tmp_path, kind, sform, qform) -> None:
    volume, warned = loaded(nifti(tmp_path / "v.nii", sform, qform, kind))
    matrix = volume.grid.index_to_world()
    np.testing.assert_allclose(matrix, SFORM if sform else QFORM, atol=1e-5)
    assert volume.frame.startswith("RAS (") and warned == ""


@pytest.mark.parametrize(
    "rows",
    [
        ([0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]),
        ([0, 0, 0, 9], [0, 0, 0, 9], [0, 0, 0, 9]),
        ([1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0]),
        ([np.nan, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]),
    ],
)
def test_a_useless_sform_beside_a_good_qform(tmp_path, rows) -> None:
    path = nifti(tmp_path / "v.nii", 2, 1, **dict(zip(FIELDS, rows)))
    volume, warned = loaded(path)
    np.testing.assert_allclose(volume.grid.index_to_world(), QFORM, atol=1e-5)
    assert "sform" in warned and np.array_equal(volume.data, voxels())


def test_voxel_sizes_alone(tmp_path) -> None:
    """Method 1 of the standard: no flip, no origin, and nothing that could be called RAS."""
    volume, warned = loaded(nifti(tmp_path / "v.nii", 0, 0))
    np.testing.assert_allclose(volume.grid.index_to_world(), np.diag([0.5, 2, 3, 1]), atol=1e-6)
    assert volume.frame == "index" and warned == ""
    blank = nifti(tmp_path / "w.nii", 1, 0, **{name: [0] * 4 for name in FIELDS})
    volume, warned = loaded(blank)
    assert volume.grid.spacing == pytest.approx((0.5, 2, 3)) and "sform" in warned


def test_a_qfac_of_zero_counts_as_one(tmp_path) -> None:
    path = nifti(tmp_path / "v.nii", 0, 1, pixdim=[0, 0.5, 2, 3, 1, 1, 1, 1])
    np.testing.assert_allclose(loaded(path)[0].grid.index_to_world(), QFORM, atol=1e-5)


@pytest.mark.parametrize("slope", [0.0, np.nan, np.inf])
def test_a_slope_that_is_none(tmp_path, slope) -> None:
    volume, _ = loaded(nifti(tmp_path / "v.nii", 1, 0, scl_slope=slope, scl_inter=np.nan))
    assert volume.dtype == np.int16 and np.array_equal(volume.data, voxels())


def test_a_slope_with_an_offset_that_is_none(tmp_path) -> None:
    volume, warned = loaded(nifti(tmp_path / "v.nii", 1, 0, scl_slope=2, scl_inter=np.nan))
    assert np.array_equal(volume.data, voxels() * 2.0) and "scl_inter" in warned


@pytest.mark.parametrize("kind", [nibabel.Nifti1Pair, nibabel.Nifti2Pair])
@pytest.mark.parametrize("packed", ["", ".gz"])
@pytest.mark.parametrize("asked", [".hdr", ".img"])
def test_pairs(tmp_path, kind, packed, asked) -> None:
    nibabel.save(kind(voxels().transpose(), QFORM), tmp_path / f"v.img{packed}")
    volume, _ = loaded(tmp_path / f"v{asked}{packed}")
    assert np.array_equal(volume.data, voxels()) and volume.name == "v"
    np.testing.assert_allclose(volume.grid.index_to_world(), QFORM, atol=1e-5)
    other = {".hdr": ".img", ".img": ".hdr"}[asked]
    assert volume.files == (str(tmp_path / f"v{other}{packed}"),)
    (tmp_path / f"v{other}{packed}").unlink()
    assert f"no v{other} beside it" in refusal(tmp_path / f"v{asked}{packed}")


def test_an_analyze_header_is_refused_with_the_reason(tmp_path) -> None:
    nibabel.save(nibabel.AnalyzeImage(voxels().transpose(), np.eye(4)), tmp_path / "v.img")
    assert "Analyze 7.5" in refusal(tmp_path / "v.img")


@pytest.mark.parametrize("ending", [".nii", ".nii.gz"])
@pytest.mark.parametrize("order", "<>")
def test_times_and_channels(tmp_path, ending, order) -> None:
    times = np.stack([voxels() + 300 * t for t in range(4)])  # [t, z, y, x]
    header = nibabel.Nifti1Header(endianness=order)
    header.set_data_dtype("int16")
    path = tmp_path / f"v{ending}"
    nibabel.save(nibabel.Nifti1Image(times.transpose(), np.eye(4), header), path)
    assert "4 times: 0, 1, 2, 3, expected volume.time" in refusal(path)
    for t in range(4):
        assert np.array_equal(load_volume(path, time=t).data, voxels() + 300 * t)
    assert "volume.time = 4" in refusal(path, time=4)
    vectors = times.transpose()[:, :, :, None, :]
    nibabel.save(nibabel.Nifti1Image(vectors, np.eye(4), header), path)
    assert "4 channels" in refusal(path)
    assert np.array_equal(load_volume(path, channel=3).data, voxels() + 900)
    both = np.stack([times, times + 3000])  # [c, t, z, y, x]
    nibabel.save(nibabel.Nifti1Image(both.transpose(), np.eye(4), header), path)
    assert np.array_equal(load_volume(path, channel=1, time=2).data, voxels() + 3600)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    refusal(path, channel=1, time=2)


def test_one_time_is_what_counts_for_the_memory_cap(tmp_path) -> None:
    times = np.stack([voxels()] * 50)
    for name in ("v.nii", "v.nii.gz"):
        nibabel.save(nibabel.Nifti1Image(times.transpose(), np.eye(4)), tmp_path / name)
        assert load_volume(tmp_path / name, time=49, memory_cap=672).nbytes == 672
        assert "memory cap" in refusal(tmp_path / name, time=49, memory_cap=671)
