"""Where DICOM slices lie: rounded positions pass with a warning, missing and uneven ones do not."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.slice_files import dicom_series, loaded, refusal, voxels

COUNT = 6


@pytest.mark.parametrize("digits", [1, 2, 3])
@pytest.mark.parametrize("gap", [1 / 3, 0.625, 0.7031, 1.25])
@pytest.mark.parametrize("first", [-123.45, 0.0, 1000.0])
def test_rounded_positions_are_taken_for_even_ones(tmp_path, digits, gap, first) -> None:
    places = [round(first + gap * k, digits) for k in range(COUNT)]
    dicom_series(tmp_path / "ct", places=places)
    volume, warned = loaded(tmp_path / "ct")
    assert np.array_equal(volume.data, voxels())
    mean = (places[-1] - places[0]) / (COUNT - 1)
    assert volume.grid.spacing[2] == pytest.approx(mean, rel=1e-9)
    off = np.abs(np.array(places) - (places[0] + mean * np.arange(COUNT))).max()
    assert ("rounded" in warned) == (off > 0.01 * mean)


def test_positions_in_whole_millimetres(tmp_path) -> None:
    dicom_series(tmp_path / "ct", places=[0, 2, 5, 8, 10, 12])  # 2.5 apart
    volume, warned = loaded(tmp_path / "ct")
    assert volume.grid.spacing[2] == 2.4 and "rounded" in warned


def test_what_the_header_leaves_out_is_told(tmp_path) -> None:
    def edit(data, k):
        del data.PixelSpacing, data.ImageOrientationPatient

    dicom_series(tmp_path / "ct", edit=edit)
    volume, warned = loaded(tmp_path / "ct")
    assert volume.grid.spacing == (1, 1, 2)
    assert "no PixelSpacing" in warned and "no ImageOrientationPatient" in warned


@pytest.mark.parametrize("missing", [1, 2, 4])
@pytest.mark.parametrize("gap", [1.0, 2.0, 1 / 3])
def test_a_missing_slice_is_named_with_its_neighbours(tmp_path, missing, gap) -> None:
    paths = dicom_series(tmp_path / "ct", places=[gap * k for k in range(COUNT)])
    paths[missing].unlink()
    message = refusal(tmp_path / "ct")
    assert "a slice is missing" in message
    assert f"s{missing - 1}.dcm and s{missing + 1}.dcm are {2 * gap:.6g} mm" in message
    assert f"others {gap:.6g} mm" in message


@pytest.mark.parametrize("count", [3, 10, 60])
def test_no_missing_slice_passes_for_rounding(tmp_path, count) -> None:
    """Whole millimetres are few decimals, but a slice that is missing is no rounding."""
    for missing in {1, count // 2, count - 2}:
        folder = tmp_path / str(missing)
        places = [float(k) for k in range(count) if k != missing]
        dicom_series(folder, np.resize(voxels(), (count - 1, 7, 8)), places=places)
        if count > 3:
            assert "missing" in refusal(folder)
        else:  # two slices have but one distance
            assert loaded(folder)[0].grid.spacing[2] == 2


@pytest.mark.parametrize(
    "places, pair",
    [
        ([0, 1, 2, 3.3, 4.3, 5.3], "s2.dcm and s3.dcm are 1.3 mm apart, others 1 mm"),
        ([0, 5, 10, 20.7, 25.7, 30.7], "s2.dcm and s3.dcm are 10.7 mm apart, others 5 mm"),
        ([0, 2, 4, 6, 8, 9.25], "s4.dcm and s5.dcm are 1.25 mm apart, others 2 mm"),
    ],
)
def test_uneven_slices_are_refused_with_their_distances(tmp_path, places, pair) -> None:
    dicom_series(tmp_path / "ct", places=places)
    message = refusal(tmp_path / "ct")
    assert "unevenly spaced" in message and pair in message


def test_doubled_slices_are_named(tmp_path) -> None:
    dicom_series(tmp_path / "ct", places=[0, 1, 2, 2, 3, 4])
    message = refusal(tmp_path / "ct")
    assert "doubled" in message and "s2.dcm" in message and "s3.dcm" in message


def test_slices_without_positions_go_by_location_or_number(tmp_path) -> None:
    def located(data, k):
        del data.ImagePositionPatient
        data.SliceLocation = f"{10 - 2.5 * k}"

    dicom_series(tmp_path / "by_location", edit=located)
    volume, warned = loaded(tmp_path / "by_location")
    assert np.array_equal(volume.data, voxels()[::-1]) and "SliceLocation" in warned
    assert volume.grid.spacing[2] == 2.5

    def numbered(data, k):
        del data.ImagePositionPatient
        data.SpacingBetweenSlices = "1.5"

    dicom_series(tmp_path / "by_number", edit=numbered)
    volume, warned = loaded(tmp_path / "by_number")
    assert np.array_equal(volume.data, voxels()) and "ordered by number" in warned
    assert volume.grid.spacing[2] == 1.5
