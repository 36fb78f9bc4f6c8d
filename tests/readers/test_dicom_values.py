"""DICOM values: stored ones, times slope plus intercept, whatever they are displayed as."""

from __future__ import annotations

from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import SimpleITK
from helpers.slice_files import dicom_series, enhanced, group, item, loaded, refusal, voxels
from pydicom.encaps import encapsulate
from pydicom.uid import (
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
    JPEG2000Lossless,
    JPEGBaseline8Bit,
    JPEGLosslessSV1,
    JPEGLSLossless,
    RLELossless,
)


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16"])
@pytest.mark.parametrize("photometric", ["MONOCHROME1", "MONOCHROME2"])
@pytest.mark.parametrize("slope, intercept", [(1, 0), (1, -1024), (-0.5, 0.25)])
def test_display_does_not_change_values(tmp_path, dtype, photometric, slope, intercept) -> None:
    array = voxels(dtype, low=-60 if dtype.startswith("i") else 0)

    def edit(data, k):
        data.PhotometricInterpretation = photometric
        data.RescaleSlope, data.RescaleIntercept = slope, intercept
        data.WindowCenter, data.WindowWidth = "40", "400"

    dicom_series(tmp_path / "ct", array, edit=edit)
    volume, warned = loaded(tmp_path / "ct")
    assert np.array_equal(volume.data, array.astype(float) * slope + intercept)
    assert warned == "" and volume.unit == "mm"


@pytest.mark.parametrize("signed", [False, True])
def test_twelve_of_sixteen_bits(tmp_path, signed) -> None:
    """Overlay bits above them are no values, and the sign is that of the twelve."""
    array = voxels("int16", low=-60 if signed else 0)

    def edit(data, k):
        data.BitsStored, data.HighBit, data.PixelRepresentation = 12, 11, int(signed)
        data.PixelData = ((array[k].astype("uint16") & 0x0FFF) | 0xA000).tobytes()

    dicom_series(tmp_path / "ct", array, edit=edit)
    assert np.array_equal(loaded(tmp_path / "ct")[0].data, array)


def test_each_slice_has_its_own_slope_and_bits(tmp_path) -> None:
    slopes, array = [1, 0.5, 0.25, 2, 3, 0.125], voxels("uint16")
    dicom_series(tmp_path / "pt", array, edit=lambda data, k: setattr(data, "RescaleSlope", slopes[k]))
    volume, _ = loaded(tmp_path / "pt")
    assert np.array_equal(volume.data, array * np.array(slopes)[:, None, None])


def test_a_rescaling_of_each_frame_or_of_all(tmp_path) -> None:
    array = voxels("int16")
    places = [(0.0, 0.0, 3.0 * k) for k in range(6)]
    own = lambda k: group(  # noqa: E731
        PixelValueTransformationSequence=item(RescaleSlope=k + 1, RescaleIntercept=-k)
    )
    enhanced(tmp_path / "own.dcm", array, places, per_frame=own)
    volume, _ = loaded(tmp_path / "own.dcm")
    k = np.arange(6)[:, None, None]
    assert np.array_equal(volume.data, array * (k + 1) - k)
    enhanced(tmp_path / "all.dcm", array, places, shared=own(1))
    assert np.array_equal(loaded(tmp_path / "all.dcm")[0].data, array * 2 - 1)


@pytest.mark.parametrize(
    "syntax, encode",
    [
        (JPEGLosslessSV1, lambda plane: imagecodecs.ljpeg_encode(plane, bitspersample=16)),
        (JPEGLSLossless, imagecodecs.jpegls_encode),
        (JPEG2000Lossless, lambda plane: imagecodecs.jpeg2k_encode(plane, level=0)),
    ],
    ids=["JPEG lossless", "JPEG-LS", "JPEG 2000"],
)
def test_compressed_slices(tmp_path, syntax, encode) -> None:
    array = voxels("uint16")

    def edit(data, k):
        data.PixelData = encapsulate([encode(np.ascontiguousarray(array[k]))])

    dicom_series(tmp_path / "ct", array, edit=edit, syntax=syntax)
    assert np.array_equal(loaded(tmp_path / "ct")[0].data, array)


@pytest.mark.parametrize("syntax", [ImplicitVRLittleEndian, ExplicitVRBigEndian])
def test_other_ways_to_write_numbers(tmp_path, syntax) -> None:
    array = voxels()

    def edit(data, k):
        if syntax == ExplicitVRBigEndian:
            data.PixelData = array[k].astype(">i2").tobytes()

    dicom_series(tmp_path / "ct", array, edit=edit, syntax=syntax)
    assert np.array_equal(loaded(tmp_path / "ct")[0].data, array)


def test_floating_point_pixels(tmp_path) -> None:
    def edit(data, k):
        del data.PixelData, data.BitsStored, data.HighBit, data.PixelRepresentation
        data.FloatPixelData, data.BitsAllocated = (voxels("float32")[k] / 3).tobytes(), 32

    dicom_series(tmp_path / "map", edit=edit)
    assert np.array_equal(loaded(tmp_path / "map")[0].data, voxels("float32") / 3)


@pytest.mark.parametrize("compressed", [False, True])
def test_a_series_that_itk_has_written(tmp_path, compressed) -> None:
    image = SimpleITK.GetImageFromArray(voxels("uint16"))
    image.SetSpacing((0.5, 0.75, 1.0))
    writer = SimpleITK.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    writer.SetUseCompression(compressed)
    for k in range(6):
        plane = image[:, :, k]
        for tag, value in {
            "0008|0060": "CT",
            "0020|000e": "1.2.3.77",
            "0020|0037": "1\\0\\0\\0\\1\\0",
            "0020|0032": f"10\\20\\{30 + 1.5 * k}",
        }.items():
            plane.SetMetaData(tag, value)
        writer.SetFileName(str(tmp_path / f"{9 - k}.dcm"))
        writer.Execute(plane)
    volume, _ = loaded(tmp_path)
    assert np.array_equal(volume.data, voxels("uint16"))
    assert volume.grid.spacing == (0.5, 0.75, 1.5) and volume.grid.origin == (10, 20, 30)


def test_run_lengths(tmp_path) -> None:
    array = voxels("uint16")
    dicom_series(tmp_path / "ct", array, edit=lambda data, k: data.compress(RLELossless))
    assert np.array_equal(loaded(tmp_path / "ct")[0].data, array)


def test_a_stream_of_more_pixels_than_the_header_says(tmp_path) -> None:
    huge = imagecodecs.jpeg_encode(np.zeros((2048, 2048), "u1"))

    def edit(data, k):
        data.PixelData = encapsulate([huge])

    dicom_series(tmp_path / "ct", voxels("uint8"), edit=edit, syntax=JPEGBaseline8Bit)
    message = refusal(tmp_path / "ct")
    assert "s0.dcm" in message and "2048" in message


def test_colour_and_palettes_are_refused(tmp_path) -> None:
    def edit(data, k):
        data.PhotometricInterpretation = "PALETTE COLOR"

    dicom_series(tmp_path / "ct", voxels("uint8"), edit=edit)
    assert "s0.dcm is in colour (PALETTE COLOR)" in refusal(tmp_path / "ct")


def test_a_dose_grid(tmp_path) -> None:
    """Planes at offsets, 32 bits, and a scaling of its own."""
    array = voxels("uint32") * np.uint32(100000)

    def edit(data, k):
        data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.481.2"
        data.NumberOfFrames, data.Rows, data.Columns = 6, 7, 8
        data.GridFrameOffsetVector = [0, 2.5, 5, 7.5, 10, 12.5]
        data.DoseGridScaling = "0.25"

    dicom_series(tmp_path / "rt", array.reshape(1, 42, 8), edit=edit)
    volume, _ = loaded(tmp_path / "rt")
    assert np.array_equal(volume.data, array * 0.25)
    assert volume.grid.spacing == (1, 1, 2.5) and volume.grid.origin == (1, 2, 3)


def test_a_file_that_says_it_has_many_frames(tmp_path: Path) -> None:
    def edit(data, k):
        data.NumberOfFrames = 2**31 - 1
        data.Rows = data.Columns = 1

    dicom_series(tmp_path / "ct", voxels()[:1], edit=edit)
    assert "2147483647 frames" in refusal(tmp_path / "ct")
