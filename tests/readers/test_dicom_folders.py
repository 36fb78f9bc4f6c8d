"""DICOM folders as they come: other objects beside the slices, several series, times and echoes."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.slice_files import (
    SHAPE,
    dicom,
    dicom_series,
    enhanced,
    group,
    item,
    loaded,
    refusal,
    voxels,
)
from pydicom.uid import BasicTextSRStorage, GrayscaleSoftcopyPresentationStateStorage

from clvol import Scene
from clvol.readers import load_volume


def report(path: Path, kind: str = BasicTextSRStorage) -> None:
    def edit(data):
        data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = kind
        for name in ("Rows", "Columns", "PixelData", "ImagePositionPatient", "PixelSpacing"):
            delattr(data, name)

    dicom(path, voxels()[0], series="1.2.3.99", edit=edit)


@pytest.mark.parametrize("kind", [BasicTextSRStorage, GrayscaleSoftcopyPresentationStateStorage])
def test_objects_that_are_no_images_are_left_out_with_a_warning(tmp_path, kind) -> None:
    dicom_series(tmp_path / "ct")
    report(tmp_path / "ct" / "a_report.dcm", kind)
    volume, warned = loaded(tmp_path / "ct")
    assert np.array_equal(volume.data, voxels())
    assert "a_report.dcm" in warned and "left out" in warned


@pytest.mark.parametrize(
    "own_series, said", [(False, "ImageType"), (True, "ImageType"), (True, "SeriesDescription")]
)
def test_a_localizer_is_left_out_with_a_warning(tmp_path, own_series, said) -> None:
    dicom_series(tmp_path / "ct")

    def edit(data):
        if said == "ImageType":
            data.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]
        else:
            data.SeriesDescription = "Scout"

    series = "1.2.3.5" if own_series else "1.2.3.4"
    plane = np.zeros((5, 5), "int16")
    dicom(
        tmp_path / "ct" / "a.dcm", plane, orientation=(1, 0, 0, 0, 0, -1), series=series, edit=edit
    )
    volume, warned = loaded(tmp_path / "ct")
    assert np.array_equal(volume.data, voxels())
    assert "a.dcm" in warned and "left out" in warned and "localizer" in warned
    if own_series:  # but it is there for whoever wants it
        assert load_volume(tmp_path / "ct", series="1.2.3.5").shape == (1, 5, 5)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("colour", [False, True])
def test_pictures_of_a_screen_are_left_out_with_a_warning(tmp_path, count, colour) -> None:
    dicom_series(tmp_path / "ct")

    def edit(data, k):
        del data.ImagePositionPatient, data.ImageOrientationPatient
        if colour:
            data.SamplesPerPixel, data.PhotometricInterpretation = 3, "RGB"

    dicom_series(
        tmp_path / "ct", np.zeros((count, 3, 4), "uint8"), prefix="a", series="1.2.5", edit=edit
    )
    volume, warned = loaded(tmp_path / "ct")
    assert np.array_equal(volume.data, voxels())
    assert "a0.dcm" in warned and "no place in space" in warned


def test_localizers_alone_are_a_volume(tmp_path) -> None:
    def edit(data, k):
        data.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]

    dicom_series(tmp_path / "mr", edit=edit)
    volume, warned = loaded(tmp_path / "mr")
    assert volume.shape == SHAPE and warned == ""


@pytest.mark.parametrize("which", ["first", "last"])
@pytest.mark.parametrize(
    "odd, word",
    [
        (dict(orientation=(1, 0, 0, 0, 0, -1)), "lies otherwise"),
        (dict(edit=lambda data: setattr(data, "PixelSpacing", ["2", "1"])), "spaced otherwise"),
        (dict(plane=np.zeros((7, 9), "int16")), "another size (9 x 7)"),
        (dict(edit=lambda data: delattr(data, "ImagePositionPatient")), "no position"),
    ],
)
def test_one_odd_slice_is_named(tmp_path, which, odd, word) -> None:
    paths = dicom_series(tmp_path / "ct")
    odd = {"plane": voxels()[0], **odd}
    name = "a_odd.dcm" if which == "first" else "z_odd.dcm"
    dicom(tmp_path / "ct" / name, position=(1.0, 2.0, 50.0), **odd)
    message = refusal(tmp_path / "ct")
    assert name in message and word in message and "6 slices" in message
    assert not any(path.name in message for path in paths)


def test_a_copy_of_a_slice_is_left_out_with_a_warning(tmp_path) -> None:
    paths = dicom_series(tmp_path / "ct")
    shutil.copy(paths[2], tmp_path / "ct" / "copy.dcm")
    volume, warned = loaded(tmp_path / "ct")
    assert np.array_equal(volume.data, voxels()) and "copy of" in warned


def test_names_that_are_not_utf8(tmp_path) -> None:
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/gr\xf6\xdfe\xff"))
    for path in dicom_series(folder):
        path.rename(Path(os.fsdecode(os.fsencode(path) + b"\xff")))
    volume, _ = loaded(folder)
    assert np.array_equal(volume.data, voxels())
    os.unlink(os.fsencode(folder) + b"/s3.dcm\xff")
    assert "missing" in str(refusal(folder))


def test_files_without_ending_beside_a_dicomdir_and_below(tmp_path) -> None:
    for path in dicom_series(tmp_path / "disk" / "DICOM" / "ST000"):
        path.rename(path.with_suffix(""))
    dicom(tmp_path / "disk" / "DICOMDIR", voxels()[0], series="9.9")
    (tmp_path / "disk" / "Thumbs.db").write_bytes(b"\0" * 300)
    volume, warned = loaded(tmp_path / "disk")
    assert np.array_equal(volume.data, voxels()) and warned == ""


def test_folders_below_are_not_mixed_with_the_slices_above(tmp_path) -> None:
    dicom_series(tmp_path / "ct")
    dicom_series(tmp_path / "ct" / "older", series="1.2.3.5")
    assert np.array_equal(loaded(tmp_path / "ct")[0].data, voxels())


# ---- choices -------------------------------------------------------------------------------------


def two_series(folder: Path, **numbers) -> None:
    for k, (uid, array) in enumerate((("1.2.8", voxels()), ("1.2.9", voxels() + 1))):

        def edit(data, _, k=k):
            data.SeriesDescription = f"phase {k}"
            if numbers:
                data.SeriesNumber = list(numbers.values())[k]

        dicom_series(folder, array, series=uid, prefix=f"s{k}_", edit=edit)


def test_a_series_is_chosen_by_its_uid_or_its_place(tmp_path) -> None:
    two_series(tmp_path / "ct")
    message = refusal(tmp_path / "ct")
    for part in ("volume.series", "1.2.8 (6 files, phase 0)", "1.2.9 (6 files, phase 1)"):
        assert part in message
    for series in ("1.2.9", 1, "1"):
        assert np.array_equal(load_volume(tmp_path / "ct", series=series).data, voxels() + 1)
    assert "volume.series = 2 among 2" in refusal(tmp_path / "ct", series=2)
    assert "1.2.9" in refusal(tmp_path / "ct", series="1.2.7")


def test_a_series_has_a_number_of_its_own(tmp_path) -> None:
    two_series(tmp_path / "ct", first=301, second=4)
    assert "301 1.2.8" in refusal(tmp_path / "ct")
    assert np.array_equal(load_volume(tmp_path / "ct", series=4).data, voxels() + 1)
    assert "volume.series" in refusal(tmp_path / "ct", series=1)


def several(folder: Path, count: int, edit) -> None:
    """``count`` volumes of one series at the same places."""
    for t in range(count):
        dicom_series(
            folder, voxels() + t, prefix=f"t{t}_", edit=lambda data, k, t=t: edit(data, k, t)
        )


TIMES = {
    "TemporalPositionIdentifier": lambda k, t: t + 1,
    "TriggerTime": lambda k, t: 12.5 * t,
    "AcquisitionNumber": lambda k, t: 7 + t,
    "AcquisitionTime": lambda k, t: f"1200{t:02}.5",
    "InstanceNumber": lambda k, t: 1 + k + 6 * t,
}
CHANNELS = {
    "EchoTime": lambda k, t: 2.5 * (t + 1),
    "DiffusionBValue": lambda k, t: 1000.0 * t,
    "ImageType": lambda k, t: ["ORIGINAL", "PRIMARY", "MPR"[t]],
}


@pytest.mark.parametrize("name", [*TIMES, *CHANNELS])
def test_several_volumes_of_one_series(tmp_path, name) -> None:
    key = "time" if name in TIMES else "channel"
    values = {**TIMES, **CHANNELS}[name]
    several(tmp_path / "mr", 3, lambda data, k, t: setattr(data, name, values(k, t)))
    message = refusal(tmp_path / "mr")
    assert f"volume.{key}" in message and f"3 {key}s" in message
    for t in range(3):
        assert np.array_equal(load_volume(tmp_path / "mr", **{key: t}).data, voxels() + t)
    assert f"volume.{key} = 3 among 3" in refusal(tmp_path / "mr", **{key: 3})
    if key == "time":
        reach = [float(voxels().min()), float(voxels().max() + 2)]
        series = Scene(volume={"file": tmp_path / "mr", "time": "all", "value_range": reach}).load_series()
        assert [np.array_equal(series.step(t).data, voxels() + t) for t in range(3)] == [True] * 3


def test_echoes_and_times_together(tmp_path) -> None:
    def edit(data, k, n):
        data.EchoNumbers, data.TemporalPositionIdentifier = n % 2 + 1, n // 2 + 1
        data.AcquisitionTime = f"{100000 + 6 * n + k}"  # each slice has its own

    several(tmp_path / "mr", 4, edit)
    assert "2 channels" in refusal(tmp_path / "mr", time=1)
    assert "2 times" in refusal(tmp_path / "mr", channel=0)
    assert np.array_equal(load_volume(tmp_path / "mr", channel=1, time=1).data, voxels() + 3)


def test_a_key_where_there_is_no_choice(tmp_path) -> None:
    dicom_series(tmp_path / "ct")
    assert load_volume(tmp_path / "ct", channel=0, time=0, series=0).shape == SHAPE
    for key in ("channel", "time", "series"):
        assert f"volume.{key} = 1" in refusal(tmp_path / "ct", **{key: 1})


# ---- multi-frame files ---------------------------------------------------------------------------


def test_an_enhanced_file_has_geometry_in_functional_groups_alone(tmp_path) -> None:
    order = [3, 0, 5, 1, 4, 2]
    places = [(1.0, 2.0, 3.0 + 4.0 * k) for k in order]
    path = enhanced(tmp_path / "e.dcm", voxels()[order], places)
    for where in (path, tmp_path):
        volume, warned = loaded(where)
        assert np.array_equal(volume.data, voxels()) and warned == ""
        assert volume.grid.spacing == (0.25, 0.5, 4.0) and volume.grid.origin == (1, 2, 3)
        assert volume.frame == "LPS" and volume.unit == "mm"


def test_an_enhanced_file_with_times(tmp_path) -> None:
    places = [(0.0, 0.0, 2.0 * k) for k in range(3)] * 2
    own = lambda k: group(FrameContentSequence=item(TemporalPositionIndex=k // 3 + 1))  # noqa: E731
    path = enhanced(tmp_path / "e.dcm", voxels(), places, per_frame=own)
    assert "2 times" in refusal(path)
    assert np.array_equal(load_volume(path, time=1).data, voxels()[3:])


def test_an_enhanced_file_that_lacks_groups(tmp_path) -> None:
    path = enhanced(tmp_path / "e.dcm", voxels(), [(0, 0, k) for k in range(5)])
    assert "describes 5 of 6 frames" in refusal(path)


@pytest.mark.parametrize("placed", [False, True])
def test_a_film_has_times(tmp_path, placed) -> None:
    def edit(data, k):
        data.NumberOfFrames, data.Rows, data.Columns, data.FrameTime = 6, 7, 8, "40"
        if not placed:
            del data.ImagePositionPatient

    dicom_series(tmp_path / "us", voxels().reshape(1, 42, 8), edit=edit)
    assert "6 times" in refusal(tmp_path / "us")
    assert np.array_equal(load_volume(tmp_path / "us", time=4).data, voxels()[4:5])


def test_one_slice_of_a_series_says_so(tmp_path) -> None:
    paths = dicom_series(tmp_path / "ct")
    volume, warned = loaded(paths[2])
    assert np.array_equal(volume.data, voxels()[2:3]) and "one slice" in warned
