"""The positions of slices: their order, and the step from each to the next."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.dicom.choice import levels_of
from clvol.readers.dicom.frames import Frame
from clvol.readers.options import ReadOptions

# Positions are written with few digits; errors up to this share of a gap cause no warning.
_GAP_TOLERANCE = 0.01
# Largest ratio of gaps between rounded positions; a missing slice makes it about 2.
_ROUNDED_RATIO = 1.5


def in_order(
    path: Path, frames: list[Frame], options: ReadOptions
) -> tuple[list[Frame], np.ndarray]:
    """The slices in order along their normal, and the world vector from one to the next (mm)."""
    if any(frame.position is None for frame in frames):
        frames = _placed(path, frames, options)
    normal = frames[0].normal
    frames = sorted(frames, key=lambda frame: float(frame.position @ normal))
    if len(frames) == 1:
        return frames, normal * (frames[0].thickness or 1.0)
    _check_doubled(path, frames)
    positions = np.array([frame.position for frame in frames])
    step = (positions[-1] - positions[0]) / (len(frames) - 1)
    gap = float(step @ normal)
    off = np.abs(positions - (positions[0] + np.arange(len(frames))[:, None] * step))
    worst = float(np.linalg.norm(off, axis=1).max())
    if worst <= _GAP_TOLERANCE * gap:
        return frames, step
    rounding = np.min([frame.rounding for frame in frames], axis=0)  # trailing zeros are dropped
    gaps = np.diff(positions @ normal)
    alike = gaps.max() <= _ROUNDED_RATIO * gaps.min() * (1 + 1e-9)
    if alike and (off <= rounding * 1.0001 + 1e-9).all():
        options.warn(
            f"slice positions seem to be rounded (they are up to {worst:.3g} mm off); slices are "
            f"taken to be {gap:.6g} mm apart"
        )
        return frames, step
    raise _uneven(path, frames, positions @ normal)


def _check_doubled(path: Path, frames: list[Frame]) -> None:
    levels = levels_of(frames)
    if levels[-1] == 0:
        names = f"{frames[0].name} to {frames[-1].name}"
        what = f"all {len(frames)} slices at one position ({names})"
        raise VolumeError(str(path), what, "slices side by side")
    same = np.flatnonzero(np.diff(levels) == 0)
    if same.size:
        one, other = frames[same[0]], frames[same[0] + 1]
        raise VolumeError(
            str(path),
            f"doubled slices: {one.name} and {other.name} are at one position",
            "one slice a position",
        )


def _uneven(path: Path, frames: list[Frame], along: np.ndarray) -> VolumeError:
    """The error that names the two slices whose distance differs most from the usual one."""
    gaps = np.diff(along)
    usual = float(np.median(gaps))
    if len(gaps) == 2:  # of two gaps neither is usual; a missing slice makes one longer
        usual = float(gaps.min())
    k = int(np.argmax(np.abs(gaps - usual)))
    pair = f"{frames[k].name} and {frames[k + 1].name} are {gaps[k]:.6g} mm apart"
    share = gaps[k] / usual
    if share > 1.5 and abs(share - round(share)) < 0.1:
        missing = round(share) - 1
        said = "a slice is" if missing == 1 else f"{missing} slices are"
        what = f"{said} missing: {pair}, others {usual:.6g} mm"
    else:
        what = f"slices are unevenly spaced: {pair}, others {usual:.6g} mm"
    expected = f"positions evenly apart, within {_GAP_TOLERANCE:.0%}"
    return VolumeError(str(path), what, expected)


def _placed(path: Path, frames: list[Frame], options: ReadOptions) -> list[Frame]:
    """Positions for slices that have none: by SliceLocation, else in the order of their numbers, with a warning."""
    if len(frames) == 1:
        return [replace(frames[0], position=np.zeros(3))]
    normal = frames[0].normal
    places = [frame.image.header.get("SliceLocation") for frame in frames]
    if None not in places and len(set(map(float, places))) == len(frames):
        options.warn("no slice has a position in space; SliceLocation is used instead")
        return [
            replace(frame, position=normal * float(place)) for frame, place in zip(frames, places)
        ]
    numbers = [
        (int(frame.image.header.get("InstanceNumber") or 0), frame.index) for frame in frames
    ]
    if len(set(numbers)) < len(frames):
        raise VolumeError(
            str(path),
            f"slices without a position in space ({frames[0].name})",
            "ImagePositionPatient",
        )
    apart = frames[0].thickness or frames[0].spacing[0]
    options.warn(
        f"slices have no position in space; they are ordered by number, {apart:.6g} mm apart"
    )
    ordered = [frame for _, frame in sorted(zip(numbers, frames), key=lambda pair: pair[0])]
    return [replace(frame, position=normal * (apart * k)) for k, frame in enumerate(ordered)]
