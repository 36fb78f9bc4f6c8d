"""DICOM folders: order, geometry, rescaling, and what makes a folder no volume."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from clvol.errors import VolumeError
from clvol.readers import load_volume

SHAPE = (4, 3, 5)
MARK = (2, 1, 3)


def voxels(dtype: str = "uint16") -> np.ndarray:
    array = (np.arange(60).reshape(SHAPE) + 3).astype(dtype)
    array[MARK] = 99
    return array


def write_series(
    folder: Path,
    array: np.ndarray,
    *,
    position: Callable[[int], tuple] = lambda k: (10.0, -20.0, 30.0 + 2.5 * k),
    orientation: tuple = (1, 0, 0, 0, 1, 0),
    slope: Callable[[int], float] = lambda k: 1,
    intercept: float = 0,
    prefix: str = "s",
    colour: bool = False,
) -> list[Path]:
    """One file a slice, named against their order; rows 0.5 apart, columns 2."""
    folder.mkdir(exist_ok=True)
    series, study = generate_uid(), generate_uid()
    paths = []
    for k, plane in enumerate(array):
        data = Dataset()
        data.file_meta = FileMetaDataset()
        data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = CTImageStorage
        data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
        data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data.Modality, data.SeriesInstanceUID, data.StudyInstanceUID = "CT", series, study
        data.InstanceNumber = len(array) - k
        data.Rows, data.Columns = plane.shape[:2]
        data.ImagePositionPatient = [f"{c:.6g}" for c in position(k)]
        data.ImageOrientationPatient = [f"{c:.6g}" for c in orientation]
        data.PixelSpacing, data.SliceThickness = ["0.5", "2"], "7"
        data.SamplesPerPixel = 3 if colour else 1
        data.PhotometricInterpretation = "RGB" if colour else "MONOCHROME2"
        if colour:
            data.PlanarConfiguration = 0
        data.BitsAllocated = data.BitsStored = 8 * array.dtype.itemsize
        data.HighBit = data.BitsStored - 1
        data.PixelRepresentation = int(array.dtype.kind == "i")
        data.RescaleSlope, data.RescaleIntercept = f"{slope(k):.6g}", f"{intercept:.6g}"
        data.PixelData = plane.tobytes() + b"\0" * (plane.nbytes % 2)
        paths.append(folder / f"{prefix}{90 - k}")
        data.save_as(paths[-1], enforce_file_format=True)
    return paths


def refused(folder: Path) -> str:
    with pytest.raises(VolumeError) as caught:
        load_volume(folder)
    message = str(caught.value)
    assert message.startswith(f"{folder}: ") and "\n" not in message
    return message


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16"])
def test_values_type_and_world_position(tmp_path: Path, dtype) -> None:
    paths = write_series(tmp_path / "ct", voxels(dtype))
    volume = load_volume(tmp_path / "ct")
    assert volume.dtype == np.dtype(dtype)
    assert np.array_equal(volume.data, voxels(dtype))
    world = volume.grid.index_to_world() @ [3, 1, 2, 1]
    np.testing.assert_allclose(world[:3], [10 + 3 * 2.0, -20 + 0.5, 30 + 2 * 2.5], atol=1e-9)
    assert (volume.frame, volume.format, volume.name) == ("LPS", "DICOM", "ct")
    # ITK agrees where the slice with the mark is, and on its values.
    image = SimpleITK.ReadImage(str(paths[2]))
    assert image[3, 1, 0] == 99
    there = image.TransformIndexToPhysicalPoint((3, 1, 0))
    np.testing.assert_allclose(world[:3], there, atol=1e-9)


def test_sagittal_slices_stacked_against_their_normal(tmp_path: Path) -> None:
    """Slices are sorted along the normal, (-1, 0, 0) here, whatever their names and numbers."""
    write_series(
        tmp_path / "mr",
        voxels(),
        orientation=(0, 1, 0, 0, 0, -1),
        position=lambda k: (10.0 + 2.5 * k, -20.0, 30.0),
    )
    volume = load_volume(tmp_path / "mr")
    assert np.array_equal(volume.data, voxels()[::-1])
    world = volume.grid.index_to_world() @ [3, 1, 3 - 2, 1]
    np.testing.assert_allclose(world[:3], [10 + 2 * 2.5, -20 + 3 * 2.0, 30 - 0.5], atol=1e-9)


def test_a_tilted_gantry_gives_a_sheared_grid(tmp_path: Path) -> None:
    where = lambda k: (10.0, -20.0 + 0.75 * k, 30.0 + 2.5 * k)  # noqa: E731
    write_series(tmp_path / "ct", voxels(), position=where)
    world = load_volume(tmp_path / "ct").grid.index_to_world() @ [3, 1, 2, 1]
    np.testing.assert_allclose(world[:3], np.array(where(2)) + [6.0, 0.5, 0.0], atol=1e-9)


def test_a_single_slice_is_as_thick_as_its_header_says(tmp_path: Path) -> None:
    write_series(tmp_path / "ct", voxels()[:1])
    assert load_volume(tmp_path / "ct").grid.spacing == (2.0, 0.5, 7.0)


@pytest.mark.parametrize(
    "stored, slope, intercept, dtype",
    [
        ("uint16", 1, -1024, "int16"),
        ("int16", 1, -1024, "int16"),
        ("uint8", 1, -5, "int16"),
        ("uint16", 2, 0, "uint8"),
        ("uint16", 0.25, 0, "float32"),
        ("uint16", 0.1, 0, "float64"),
        ("uint16", 3000, 0, "float32"),
    ],
)
def test_rescaled_values_are_exact_in_the_smallest_type(
    tmp_path: Path, stored, slope, intercept, dtype
) -> None:
    write_series(tmp_path / "ct", voxels(stored), slope=lambda k: slope, intercept=intercept)
    volume = load_volume(tmp_path / "ct")
    assert np.array_equal(volume.data, voxels(stored).astype(float) * slope + intercept)
    assert volume.dtype == np.dtype(dtype)


def test_each_slice_has_its_own_rescaling(tmp_path: Path) -> None:
    """As in PET: reading all slices in the first one's type would round the others."""
    slopes = [1.0, 0.5, 0.25, 2.0]
    write_series(tmp_path / "pt", voxels(), slope=lambda k: slopes[k])
    volume = load_volume(tmp_path / "pt")
    expected = voxels().astype(float) * np.array(slopes)[:, None, None]
    assert np.array_equal(volume.data, expected)


def test_several_series_are_listed(tmp_path: Path, capfd) -> None:
    write_series(tmp_path / "ct", voxels())
    write_series(tmp_path / "ct", voxels()[:2], prefix="t")
    message = refused(tmp_path / "ct")
    assert "2 series: 0 1.2." in message and "volume.series" in message
    assert "(4 files)" in message and "(2 files)" in message
    assert capfd.readouterr() == ("", "")


def test_folders_without_a_series(tmp_path: Path, capfd) -> None:
    assert "no DICOM series" in refused(tmp_path)
    (tmp_path / "notes.txt").write_text("no image")
    assert "no DICOM series" in refused(tmp_path)
    assert capfd.readouterr() == ("", "")


def test_other_files_beside_the_series_do_no_harm(tmp_path: Path) -> None:
    write_series(tmp_path / "ct", voxels())
    (tmp_path / "ct" / "notes.txt").write_text("no image")
    (tmp_path / "ct" / "more").mkdir()
    assert np.array_equal(load_volume(tmp_path / "ct").data, voxels())


def test_a_missing_a_doubled_and_a_coinciding_slice(tmp_path: Path, capfd) -> None:
    paths = write_series(tmp_path / "ct", voxels())
    paths[2].unlink()
    assert "missing" in refused(tmp_path / "ct")
    write_series(
        tmp_path / "twice", voxels(), position=lambda k: (0.0, 0.0, 2.5 * min(k, 2))
    )
    assert "doubled" in refused(tmp_path / "twice")
    write_series(tmp_path / "same", voxels(), position=lambda k: (0.0, 0.0, 0.0))
    assert "one position" in refused(tmp_path / "same")
    assert capfd.readouterr() == ("", "")


def test_slices_of_another_size_and_colour(tmp_path: Path) -> None:
    odd = write_series(tmp_path / "odd", voxels())
    one = write_series(tmp_path / "one", np.zeros((4, 2, 5), "u2"))
    from pydicom import dcmread

    other = dcmread(one[3])
    other.SeriesInstanceUID = dcmread(odd[0]).SeriesInstanceUID
    other.save_as(odd[3])
    assert "another size" in refused(tmp_path / "odd")
    write_series(tmp_path / "rgb", np.zeros((2, 3, 4, 3), "u1"), colour=True)
    assert "colour" in refused(tmp_path / "rgb")


@pytest.mark.parametrize("which", [0, 1, 3])
@pytest.mark.parametrize("left", [0.3, 0.9, 0.99])
def test_a_truncated_slice_is_refused_not_left_out(tmp_path: Path, capfd, which, left) -> None:
    path = write_series(tmp_path / "ct", voxels())[which]
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * left)])
    refused(tmp_path / "ct")
    assert capfd.readouterr() == ("", "")


def test_the_memory_cap_holds(tmp_path: Path) -> None:
    write_series(tmp_path / "ct", voxels())
    assert load_volume(tmp_path / "ct", memory_cap=120).nbytes == 120
    with pytest.raises(VolumeError, match="needs 120 bytes"):
        load_volume(tmp_path / "ct", memory_cap=119)
