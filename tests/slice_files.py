"""Voxels and DICOM files that the tests of the readers of slices share."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import (
    CTImageStorage,
    EnhancedCTImageStorage,
    ExplicitVRLittleEndian,
    generate_uid,
)

from clvol.errors import ClvolWarning, VolumeError
from clvol.readers import load_volume
from clvol.text import one_line
from clvol.volume import Volume

SHAPE = (6, 7, 8)


def voxels(dtype: str = "int16", low: int = 2) -> np.ndarray:
    """[z, y, x], all different along every axis."""
    z, y, x = np.indices(SHAPE)
    return (low + 20 * z + 3 * y + x).astype(dtype)


def loaded(path: Path, **options) -> tuple[Volume, str]:
    """The volume with its voxels, and all warnings in one text."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        volume = load_volume(path, **options)
        assert volume.data is not None
    assert all(issubclass(one.category, ClvolWarning) for one in caught)
    return volume, "; ".join(str(one.message) for one in caught)


def refusal(path: Path, **options) -> str:
    """The message of the VolumeError, one line that begins with the path as it is shown."""
    try:
        loaded(path, **options)
    except VolumeError as error:
        message = str(error)
        assert message.startswith(f"{one_line(path)}: ") and "\n" not in message
        assert error.exit_status == 2
        return message
    raise AssertionError(f"{path} was read")


def dicom(
    path: Path,
    plane: np.ndarray,
    *,
    position: tuple = (1.0, 2.0, 3.0),
    orientation: tuple = (1, 0, 0, 0, 1, 0),
    series: str = "1.2.3.4",
    number: int = 1,
    edit: Callable[[Dataset], None] | None = None,
    syntax: str = ExplicitVRLittleEndian,
) -> Path:
    """One CT slice with square pixels 1 mm apart; ``edit`` changes the dataset before it is written."""
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = CTImageStorage
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
    data.file_meta.TransferSyntaxUID = syntax
    data.Modality, data.SeriesInstanceUID, data.StudyInstanceUID = "CT", series, "1.2.3"
    data.InstanceNumber = number
    data.Rows, data.Columns = plane.shape[-2:]
    data.ImagePositionPatient = [f"{c:.10g}" for c in position]
    data.ImageOrientationPatient = [f"{c:.6g}" for c in orientation]
    data.PixelSpacing, data.SliceThickness = ["1", "1"], "2"
    data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
    data.BitsAllocated = data.BitsStored = 8 * plane.dtype.itemsize
    data.HighBit = data.BitsStored - 1
    data.PixelRepresentation = int(plane.dtype.kind == "i")
    data.PixelData = plane.tobytes() + b"\0" * (plane.nbytes % 2)
    if edit is not None:
        edit(data)
    path.parent.mkdir(parents=True, exist_ok=True)
    data.save_as(path, enforce_file_format=True)
    return path


def dicom_series(
    folder: Path,
    array: np.ndarray | None = None,
    *,
    places: list[float] | None = None,
    prefix: str = "s",
    edit: Callable[[Dataset, int], None] | None = None,
    **options,
) -> list[Path]:
    """One file a slice, 2 mm apart or at ``places`` along z."""
    array = voxels() if array is None else array
    places = [3.0 + 2.0 * k for k in range(len(array))] if places is None else places
    return [
        dicom(
            folder / f"{prefix}{k}.dcm",
            plane,
            position=(1.0, 2.0, places[k]),
            number=k + 1,
            edit=None if edit is None else lambda data, k=k: edit(data, k),
            **options,
        )
        for k, plane in enumerate(array)
    ]


def item(**values) -> Dataset:
    data = Dataset()
    for name, value in values.items():
        setattr(data, name, value)
    return data


def group(**sequences: Dataset) -> Dataset:
    """A functional group: one item in each sequence."""
    return item(**{name: Sequence([one]) for name, one in sequences.items()})


def enhanced(
    path: Path,
    frames: np.ndarray,
    positions: list[tuple],
    *,
    shared: Dataset | None = None,
    per_frame: Callable[[int], Dataset] = lambda k: Dataset(),
    edit: Callable[[Dataset], None] | None = None,
) -> Path:
    """An enhanced multi-frame file; nothing but functional groups says where its frames lie."""

    def change(data: Dataset) -> None:
        data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = EnhancedCTImageStorage
        for name in ("ImagePositionPatient", "ImageOrientationPatient", "PixelSpacing"):
            delattr(data, name)
        del data.SliceThickness
        data.NumberOfFrames = len(frames)
        common = group(
            PlaneOrientationSequence=item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0]),
            PixelMeasuresSequence=item(PixelSpacing=[0.5, 0.25], SliceThickness=9.0),
        )
        common.update(shared or Dataset())
        data.SharedFunctionalGroupsSequence = Sequence([common])
        own = []
        for k, position in enumerate(positions):
            one = group(PlanePositionSequence=item(ImagePositionPatient=list(position)))
            one.update(per_frame(k))
            own.append(one)
        data.PerFrameFunctionalGroupsSequence = Sequence(own)
        if edit is not None:
            edit(data)

    return dicom(path, frames, edit=change)
