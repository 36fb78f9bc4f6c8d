"""Selecting the slices of the volume: one series, channel and time, without localizers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clvol.errors import VolumeError
from clvol.readers.dicom.files import Image
from clvol.readers.dicom.frames import CHANNELS, TIMES, Frame, frames_of
from clvol.readers.options import Key, ReadOptions

_NAMED = 3
_SAME_PLACE = 1e-4  # mm


def chosen_frames(path: Path, images: list[Image], options: ReadOptions) -> list[Frame]:
    """The slices of the selected series, channel and time, which agree in size, spacing and orientation."""
    frames = _one_series(path, images, options)
    frames = _alike(path, _without_localizers(frames, options))
    frames = _split(path, frames, "channel", CHANNELS, options)
    frames = _split(path, frames, "time", TIMES, options)
    return frames


def _one_series(path: Path, images: list[Image], options: ReadOptions) -> list[Frame]:
    series: dict[str, list[Image]] = {}
    for image in images:
        series.setdefault(str(image.header.get("SeriesInstanceUID") or ""), []).append(image)
    if options.series is None:
        series = _without_others(path, series, options)
    uids = list(series)
    firsts = [series[uid][0].header for uid in uids]
    numbers = [header.get("SeriesNumber") for header in firsts]
    # Users know a series by its number, if each series has one.
    distinct = None not in numbers and len(set(numbers)) == len(numbers)
    shown = [_shown(uid, series[uid]) for uid in uids]
    chosen = options.choose(
        "series",
        str(path),
        uids,
        numbers=[int(number) for number in numbers] if distinct and len(uids) > 1 else None,
        shown=shown,
    )
    frames = [frame for image in series[uids[chosen]] for frame in frames_of(image, str(path))]
    return frames


def _shown(uid: str, images: list[Image]) -> str:
    files = f"{len(images)} file{'s' if len(images) > 1 else ''}"
    said = str(images[0].header.get("SeriesDescription") or "").strip()
    return f"{uid or 'no UID'} ({files}{f', {said}' if said else ''})"


def _without_others(
    path: Path, series: dict[str, list[Image]], options: ReadOptions
) -> dict[str, list[Image]]:
    """The series without localizers and screenshots, if any are left."""
    kept = {}
    left_out = []
    placed = {uid: any(_has_place(image) for image in images) for uid, images in series.items()}
    for uid, images in series.items():
        first = images[0].header
        try:
            localizer = all(
                frame.is_localizer for image in images for frame in frames_of(image, str(path))
            )
        except VolumeError:  # for example colour; it is an error if this series is selected
            localizer = False
        if localizer or any(placed.values()) and not placed[uid]:
            kind = "a localizer" if localizer else "no place in space"
            left_out.append(f"{images[0].name} ({kind}, series {first.get('SeriesInstanceUID')})")
        else:
            kept[uid] = images
    if not kept:
        return series
    if left_out:
        more = f" and {len(left_out) - _NAMED} more series" if len(left_out) > _NAMED else ""
        options.warn(f"left out: {', '.join(left_out[:_NAMED])}{more}")
    return kept


def _has_place(image: Image) -> bool:
    header = image.header
    return any(
        header.get(name)
        for name in (
            "ImagePositionPatient",
            "PerFrameFunctionalGroupsSequence",
            "DetectorInformationSequence",
            "SliceLocation",
        )
    )


def _without_localizers(frames: list[Frame], options: ReadOptions) -> list[Frame]:
    """The slices without localizers, which are often part of the series but have another orientation."""
    others = [frame for frame in frames if not frame.is_localizer]
    if not others or len(others) == len(frames):
        return frames
    names = [frame.name for frame in frames if frame.is_localizer]
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    options.warn(f"localizers, left out: {', '.join(names[:_NAMED])}{more}")
    return others


def _alike(path: Path, frames: list[Frame]) -> list[Frame]:
    """All frames, if they are parallel and of one size; else VolumeError that names those that differ."""
    kinds: list[list[Frame]] = []
    for frame in frames:
        for kind in kinds:
            if _difference(frame, kind[0]) is None:
                kind.append(frame)
                break
        else:
            kinds.append([frame])
    if len(kinds) == 1:
        return frames
    kinds.sort(key=len, reverse=True)
    odd = [frame for kind in kinds[1:] for frame in kind]
    names = ", ".join(frame.name for frame in odd[:_NAMED])
    more = f" and {len(odd) - _NAMED} more" if len(odd) > _NAMED else ""
    verb = _difference(odd[0], kinds[0][0]) or "is different"
    if len(odd) > 1:
        verb = verb.replace("has ", "have ").replace("lies ", "lie ").replace("is ", "are ")
    raise VolumeError(
        str(path),
        f"{names}{more} {verb}, unlike the other {len(kinds[0])} slices",
        "parallel slices of one size and spacing",
    )


def _difference(one: Frame, other: Frame) -> str | None:
    if (one.rows, one.columns) != (other.rows, other.columns):
        return f"has another size ({one.columns} x {one.rows})"
    if (one.position is None) != (other.position is None):
        return "has no position in space" if one.position is None else "has a position in space"
    if not np.allclose(one.axes, other.axes, atol=1e-3):
        return "lies otherwise"
    if not np.allclose(one.spacing, other.spacing, rtol=1e-3):
        return f"is spaced otherwise ({one.spacing[1]:g} x {one.spacing[0]:g} mm)"
    return None


# ---- several slices at one position -----------------------------------------------------------------


def levels_of(frames: list[Frame]) -> np.ndarray:
    """The index of each frame's position along the normal, from 0; -1 without a position."""
    if any(frame.position is None for frame in frames):
        return np.full(len(frames), -1)
    normal = frames[0].normal
    along = np.array([frame.position @ normal for frame in frames])
    order = np.argsort(along, kind="stable")
    apart = np.diff(along[order]) > _SAME_PLACE
    levels = np.empty(len(frames), int)
    levels[order] = np.concatenate([[0], np.cumsum(apart)])
    return levels


def _split(
    path: Path, frames: list[Frame], key: Key, names: tuple[str, ...], options: ReadOptions
) -> list[Frame]:
    """The selected slices where several share each position."""
    levels = levels_of(frames)
    if levels[0] < 0:  # slices without positions can be split only if they form a film
        levels, names = np.zeros(len(frames), int), tuple({"FrameInTime"} & {*names})
    count = int(levels.max()) + 1
    if count == len(frames):
        return frames
    for name in names:
        groups = _groups(frames, name)
        places = [{levels[k] for k in group} for group in groups.values()]
        if len(groups) > 1 and all(len(place) == count for place in places):
            return _one_group(path, frames, key, groups, f"{name} ", options)
    repeats = np.bincount(levels, minlength=count)
    if key == "time" and count > 1 and (repeats == repeats[0]).all():
        turns = _in_turn(frames, levels)
        return _one_group(path, frames, key, turns, "by InstanceNumber: ", options)
    return frames


def _groups(frames: list[Frame], name: str) -> dict:
    """Indices of frames by their value of ``name``, in the order of values; empty unless all frames have one."""
    values = [frame.facts.get(name) for frame in frames]
    if any(value is None for value in values):
        return {}
    groups: dict = {}
    for k, value in enumerate(values):
        groups.setdefault(value, []).append(k)
    numbers = all(isinstance(value, float) for value in groups)
    return dict(sorted(groups.items(), key=lambda item: item[0] if numbers else str(item[0])))


def _in_turn(frames: list[Frame], levels: np.ndarray) -> dict:
    """The first slice at each position, the second at each position, and so on, in the order of their numbers."""
    order = sorted(
        range(len(frames)),
        key=lambda k: (int(frames[k].image.header.get("InstanceNumber") or 0), frames[k].index, k),
    )
    seen: dict = {}
    groups: dict = {}
    for k in order:
        turn = seen[levels[k]] = seen.get(levels[k], -1) + 1
        groups.setdefault(turn, []).append(k)
    return groups


def _one_group(
    path: Path, frames: list[Frame], key: Key, groups: dict, label: str, options: ReadOptions
) -> list[Frame]:
    values = [f"{value:g}" if isinstance(value, float) else str(value) for value in groups]
    shown = [f"({label}{value})" for value in values]
    named = [value if not value.replace(".", "").isdecimal() else None for value in values]
    chosen = options.choose(key, str(path), named, shown=shown)
    return [frames[k] for k in list(groups.values())[chosen]]
