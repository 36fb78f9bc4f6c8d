"""Finding the DICOM images of a folder, and reading their headers."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clvol.errors import VolumeError
from clvol.readers.options import ReadOptions
from clvol.readers.recognise import MAGIC, MAGIC_AT, begins, files_below
from clvol.volume.memory import check_memory

# The first element of a file without a preamble: group 2 or 8, little-endian.
_BARE = (b"\x02\x00\x00\x00", b"\x02\x00\x02\x00", b"\x08\x00")
DEFLATED = "1.2.840.10008.1.2.1.99"
_DEFLATE_RATIO = 1032  # zlib's technical notes
_NAMED = 3
# Classes of objects that hold pixels although their names do not contain "image".
_IMAGES = ("Image Storage", "RT Dose Storage", "Segmentation Storage", "Parametric Map Storage")

_HEADER = """
    SOPClassUID SOPInstanceUID ImageType Modality SeriesInstanceUID SeriesNumber SeriesDescription
    AcquisitionDateTime AcquisitionTime ContentTime AcquisitionNumber InstanceNumber
    TemporalPositionIdentifier TemporalPositionIndex TriggerTime FrameReferenceTime
    NominalCardiacTriggerDelayTime EchoNumbers EchoTime InversionTime DiffusionBValue
    ComplexImageComponent FrameTime FrameTimeVector
    ImagePositionPatient ImageOrientationPatient SliceLocation SliceThickness SpacingBetweenSlices
    PixelSpacing ImagerPixelSpacing NominalScannedPixelSpacing GridFrameOffsetVector
    Rows Columns NumberOfFrames SamplesPerPixel PhotometricInterpretation BitsAllocated BitsStored
    HighBit PixelRepresentation RescaleSlope RescaleIntercept DoseGridScaling ModalityLUTSequence
    DetectorInformationSequence SharedFunctionalGroupsSequence PerFrameFunctionalGroupsSequence
    SegmentSequence
""".split()


@dataclass(frozen=True, eq=False)
class Image:
    """A file with pixels. ``name`` is its path below the folder, ``header`` a pydicom Dataset."""

    path: Path
    name: str
    header: Any


def find_images(path: Path, options: ReadOptions) -> list[Image]:
    """The images in a folder or, if there are none, in the folders below; for a file, the image in it.

    Files that are not images are left out with a warning; VolumeError for a damaged file.
    """
    if path.is_file():
        image = _read(path, path, options)
        if image is None:
            raise VolumeError(str(path), "not a DICOM file", "a DICOM image or a folder of them")
        if not isinstance(image, Image):
            raise VolumeError(str(path), f"not an image ({image})", "a DICOM image")
        if int(image.header.get("NumberOfFrames") or 1) == 1:
            options.warn("only one slice was read; open its folder to read the whole series")
        return [image]
    images: list[Image] = []
    left_out: list[str] = []
    above = None
    for file in files_below(path):
        if images and file.parent != above and above == path:
            break
        above = file.parent
        if file.name.upper() == "DICOMDIR":
            continue
        found = _read(path, file, options)
        if isinstance(found, Image):
            images.append(found)
        elif found is not None:
            left_out.append(f"{_name(path, file)} ({found})")
    if not images:
        raise VolumeError(
            str(path), "no DICOM series in the folder", "a folder with DICOM or TIFF slices"
        )
    if left_out:
        more = f" and {len(left_out) - _NAMED} more files" if len(left_out) > _NAMED else ""
        options.warn(f"not images, left out: {', '.join(left_out[:_NAMED])}{more}")
    return _without_copies(images, options)


def _name(folder: Path, file: Path) -> str:
    return file.name if folder == file else str(file.relative_to(folder))


def _read(folder: Path, path: Path, options: ReadOptions) -> Image | str | None:
    """The image; for another DICOM object, its kind; None for a file that is not DICOM."""
    start = begins(path)
    marked = start[MAGIC_AT:] == MAGIC
    if not marked and not start.startswith(_BARE):
        return None
    name = _name(folder, path)
    try:
        header = _header(path, marked, options)
    except (VolumeError, MemoryError):
        raise
    except Exception as error:  # pydicom raises many types for damaged bytes
        if not marked:
            return None
        raise VolumeError(
            str(folder), f"{name} is damaged ({type(error).__name__}: {error})", "undamaged slices"
        ) from error
    if header.get("Rows") and header.get("Columns"):
        return Image(path, name, header)
    kind = header.get("SOPClassUID") or header.file_meta.get("MediaStorageSOPClassUID")
    if not marked and kind is None:
        return None
    said = getattr(kind, "name", None) or "an unknown object"
    if any(said.endswith(image) for image in _IMAGES):
        raise VolumeError(str(folder), f"{name} is damaged (no rows or columns)", "whole slices")
    return said


def _header(path: Path, marked: bool, options: ReadOptions) -> Any:
    from pydicom import dcmread
    from pydicom.filereader import read_file_meta_info

    if marked and read_file_meta_info(path).get("TransferSyntaxUID") == DEFLATED:
        _check_deflated(path, options)
    return dcmread(path, stop_before_pixels=True, specific_tags=_HEADER, force=not marked)


def _check_deflated(path: Path, options: ReadOptions) -> None:
    """VolumeError if the file does not fit into memory: pydicom inflates it whole."""
    least = path.stat().st_size * _DEFLATE_RATIO
    try:
        check_memory(str(path), least, options.memory_cap)
        return
    except VolumeError:
        pass
    size = 0
    stream = zlib.decompressobj(-zlib.MAX_WBITS)
    with path.open("rb") as file:
        file.seek(_deflated_start(path))
        pending = file.read(1 << 16)
        while pending and not stream.eof:
            size += len(stream.decompress(pending, 1 << 20))
            check_memory(str(path), size, options.memory_cap)
            pending = stream.unconsumed_tail or file.read(1 << 16)


def _deflated_start(path: Path) -> int:
    """The offset after preamble, mark and file meta information, whose length comes first."""
    with path.open("rb") as file:
        start = file.read(144)
    return 144 + int.from_bytes(start[140:144], "little")


def _without_copies(images: list[Image], options: ReadOptions) -> list[Image]:
    """The images without duplicates, which the folder may hold under several names."""
    seen: dict[Any, Image] = {}
    kept = []
    for image in images:
        uid = image.header.get("SOPInstanceUID")
        other = seen.setdefault(uid, image) if uid else image
        if other is not image and _same_bytes(other.path, image.path):
            options.warn(f"{image.name} is a copy of {other.name} and is left out")
            continue
        kept.append(image)
    return kept


def _same_bytes(one: Path, other: Path) -> bool:
    import filecmp

    return filecmp.cmp(one, other, shallow=False)
