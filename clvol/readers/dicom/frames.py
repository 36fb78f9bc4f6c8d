"""The properties of each slice: of a file, or of one frame of a multi-frame file."""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from typing import Any

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.dicom.files import Image

# The functional groups of an enhanced file that hold what other files have at the top level.
_GROUPS = {
    "ImagePositionPatient": "PlanePositionSequence",
    "ImageOrientationPatient": "PlaneOrientationSequence",
    "PixelSpacing": "PixelMeasuresSequence",
    "SliceThickness": "PixelMeasuresSequence",
    "SpacingBetweenSlices": "PixelMeasuresSequence",
    "RescaleSlope": "PixelValueTransformationSequence",
    "RescaleIntercept": "PixelValueTransformationSequence",
    "EffectiveEchoTime": "MREchoSequence",
    "InversionTimes": "MRModifierSequence",
    "DiffusionBValue": "MRDiffusionSequence",
    "ReferencedSegmentNumber": "SegmentIdentificationSequence",
    "TemporalPositionTimeOffset": "TemporalPositionSequence",
    "NominalCardiacTriggerDelayTime": "CardiacSynchronizationSequence",
    "TemporalPositionIndex": "FrameContentSequence",
    "FrameAcquisitionNumber": "FrameContentSequence",
    "FrameAcquisitionDateTime": "FrameContentSequence",
    "FrameReferenceDateTime": "FrameContentSequence",
    "StackID": "FrameContentSequence",
    "InStackPositionNumber": "FrameContentSequence",
}
_FRAME_TYPES = ("MRImageFrameTypeSequence", "CTImageFrameTypeSequence", "PETFrameTypeSequence")
# Properties in which slices at one position may differ; the first one that distinguishes them is used.
CHANNELS = (
    "EchoNumbers", "EchoTime", "EffectiveEchoTime", "ReferencedSegmentNumber", "DiffusionBValue",
    "ComplexImageComponent", "ImageType", "InversionTime", "InversionTimes", "StackID",
)  # fmt: skip
TIMES = (
    "TemporalPositionIdentifier", "TemporalPositionIndex", "TemporalPositionTimeOffset",
    "TriggerTime", "NominalCardiacTriggerDelayTime", "FrameReferenceTime", "FrameAcquisitionNumber",
    "AcquisitionNumber", "AcquisitionDateTime", "AcquisitionTime", "FrameAcquisitionDateTime",
    "FrameReferenceDateTime", "ContentTime", "FrameInTime",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Frame:
    """The properties of one slice.

    ``axes`` are the unit directions (LPS) in which columns and rows count up; ``spacing`` is the distance between
    (rows, columns) in mm. ``position`` is the centre of the first pixel, None if the file does not state it;
    ``rounding`` is the largest error of its digits along x, y, z. ``facts`` hold properties in which slices at one
    position may differ; ``lacks`` says what is missing from the file, and what is used instead.
    """

    image: Image
    index: int
    position: np.ndarray | None
    rounding: np.ndarray
    axes: np.ndarray
    spacing: tuple[float, float]
    thickness: float | None
    slope: float
    intercept: float
    facts: dict[str, Any] = field(default_factory=dict)
    lacks: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        count = int(self.image.header.get("NumberOfFrames") or 1)
        return f"frame {self.index + 1} of {self.image.name}" if count > 1 else self.image.name

    @property
    def rows(self) -> int:
        return int(self.image.header.Rows)

    @property
    def columns(self) -> int:
        return int(self.image.header.Columns)

    @property
    def bits_allocated(self) -> int:
        return max(8, int(self.image.header.get("BitsAllocated") or 16))

    @property
    def normal(self) -> np.ndarray:
        return np.cross(self.axes[0], self.axes[1])

    @property
    def is_localizer(self) -> bool:
        header = self.image.header
        said = " ".join([*map(str, header.get("ImageType") or ()), *map(str, self.facts.values())])
        said = f"{said} {header.get('SeriesDescription') or ''}".lower()
        return any(word in said for word in ("localizer", "localiser", "scout", "topogram"))


def frames_of(image: Image, where: str) -> list[Frame]:
    """All frames of a file; VolumeError, naming it, for colour and for malformed numbers."""
    header = image.header
    colours = str(header.get("PhotometricInterpretation") or "MONOCHROME2")
    if int(header.get("SamplesPerPixel") or 1) != 1 or not colours.startswith("MONOCHROME"):
        raise VolumeError(where, f"{image.name} is in colour ({colours})", "one scalar per pixel")
    count = int(header.get("NumberOfFrames") or 1)
    groups = header.get("PerFrameFunctionalGroupsSequence")
    if count < 1 or groups and len(groups) < count:
        what = f"{image.name} describes {len(groups or ())} of {count} frames"
        raise VolumeError(where, what, "a whole multi-frame file")
    stored = image.path.stat().st_size
    if count > stored:
        what = f"{image.name} says that it has {count} frames in {stored} bytes"
        raise VolumeError(where, what, "a whole multi-frame file")
    try:
        return [_frame(image, k, count) for k in range(count)]
    except (TypeError, ValueError, AttributeError, IndexError, ArithmeticError) as error:
        raise VolumeError(
            where, f"{image.name} has a damaged header ({error})", "whole slices"
        ) from None


def _frame(image: Image, index: int, count: int) -> Frame:
    header = image.header
    look = _Lookup(header, index)
    axes = _unit_axes(look("ImageOrientationPatient"))
    position = look("ImagePositionPatient")
    point = None if position is None else _numbers(position, 3)
    rounding = np.zeros(3) if position is None else _rounding(position)
    offsets = header.get("GridFrameOffsetVector")
    has_groups = bool(header.get("PerFrameFunctionalGroupsSequence"))
    facts = {key: value for key in (*CHANNELS, *TIMES) if (value := look(key)) is not None}
    if count > 1 and not has_groups:
        normal = np.cross(axes[0], axes[1])
        if not offsets and (header.get("FrameTime") or header.get("FrameTimeVector")):
            facts["FrameInTime"] = index
        elif point is None:
            pass
        elif offsets:  # relative to the first frame, or positions along the patient's axis
            point = point + normal * (float(offsets[index]) - float(offsets[0]))
        elif look("SpacingBetweenSlices"):
            point = point + normal * float(look("SpacingBetweenSlices")) * index
    if kind := look.frame_type():
        facts["ImageType"] = kind
    spacing = (
        look("PixelSpacing") or look("ImagerPixelSpacing") or look("NominalScannedPixelSpacing")
    )
    thickness = look("SpacingBetweenSlices") or look("SliceThickness")
    if header.get("DoseGridScaling") is not None:
        slope, intercept = float(header.DoseGridScaling), 0.0
    else:
        slope, intercept = look("RescaleSlope"), look("RescaleIntercept")
        slope = 1.0 if slope is None else float(slope)
        intercept = 0.0 if intercept is None else float(intercept)
    if not (np.isfinite([slope, intercept]).all() and slope != 0.0):
        raise ValueError(f"rescale slope {slope:g}, intercept {intercept:g}")
    return Frame(
        image,
        index,
        point,
        rounding,
        axes,
        (1.0, 1.0) if spacing is None else tuple(_numbers(spacing, 2)),
        abs(float(thickness)) if thickness else None,
        slope,
        intercept,
        {key: _plain(value) for key, value in facts.items()},
        tuple(
            text
            for known, text in (
                (spacing, "PixelSpacing, so pixels are taken to be 1 mm apart"),
                (look("ImageOrientationPatient"), "ImageOrientationPatient, so slices are axial"),
            )
            if known is None
        ),
    )


class _Lookup:
    """Looks an attribute up in the frame, then in the shared groups, then at the top level."""

    def __init__(self, header: Any, index: int) -> None:
        own = header.get("PerFrameFunctionalGroupsSequence")
        shared = header.get("SharedFunctionalGroupsSequence")
        detectors = header.get("DetectorInformationSequence")
        self._groups = [own[index]] if own else []
        self._groups += [shared[0]] if shared else []
        self._tops = [header, *([detectors[0]] if detectors else [])]

    def __call__(self, keyword: str) -> Any:
        sequence = _GROUPS.get(keyword)
        for group in self._groups:
            items = group.get(sequence) if sequence else None
            if items and items[0].get(keyword) not in (None, ""):
                return items[0].get(keyword)
        for top in self._tops:
            if top.get(keyword) not in (None, ""):
                return top.get(keyword)
        return None

    def frame_type(self) -> Any:
        for group in self._groups:
            for name in _FRAME_TYPES:
                if group.get(name):
                    return group.get(name)[0].get("FrameType")
        return None


def _numbers(values: Any, count: int) -> np.ndarray:
    numbers = np.array([float(value) for value in values])
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ValueError(f"{list(values)} for {count} numbers")
    return numbers


def _unit_axes(values: Any) -> np.ndarray:
    if values is None:
        return np.eye(3)[:2]
    axes = _numbers(values, 6).reshape(2, 3)
    lengths = np.linalg.norm(axes, axis=1)
    if lengths.min() < 1e-6 or np.linalg.norm(np.cross(*axes)) < 1e-3 * lengths.prod():
        raise ValueError("an orientation that spans no plane")
    return axes / lengths[:, None]


def _rounding(values: Any) -> np.ndarray:
    """One unit in the last digit of each number."""
    texts = [f"{float(value):.10g}" for value in values]  # without the rounding noise of float32
    return np.array([10.0 ** min(0, int(Decimal(text).as_tuple().exponent)) for text in texts])


def _plain(value: Any) -> Any:
    """A number or text from the value types of pydicom."""
    if isinstance(value, (str, bytes)):
        return str(value)
    try:
        return float(value)
    except (TypeError, ValueError):
        return "\\".join(str(part) for part in value) if hasattr(value, "__iter__") else str(value)
