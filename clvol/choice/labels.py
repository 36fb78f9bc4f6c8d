"""Whether voxels are labels or a mask, and colours for them."""

from __future__ import annotations

import colorsys

import numpy as np

from clvol.choice.sample import Sample

MOST_LABELS = 4096
_GOLDEN = 0.618033988749895  # turns between hues: neighbours in the list differ, and no two of many are the same


def label_values(sample: Sample, said: bool) -> np.ndarray | None:
    """The values of labels or of a mask, ascending; None if the voxels are something else.

    ``said``: the file says that they are labels. Otherwise they are if they are whole numbers (or just two values) of
    which most have neighbours of the same value, and if between two different neighbours along a line there is rarely
    a voxel with a value between theirs: measured intensities rise over several voxels, labels jump.
    """
    values = sample.values
    known = values[np.isfinite(values)]
    if known.size == 0:
        return None
    if not said and not _is_even(values, known):
        return None
    found = np.unique(known)
    if found.size > MOST_LABELS or (found.size < 2 and not (said and found[0] != 0)):
        return None
    return found if said or found.size == 2 or np.all(found == np.rint(found)) else None


def _is_even(values: np.ndarray, known: np.ndarray) -> bool:
    """Whether most neighbours outside the background have the same value, and the others differ by a jump."""
    some = known[:: max(1, known.size // 50_000)]
    if np.unique(some).size > MOST_LABELS:
        return False
    found, counts = np.unique(some, return_counts=True)
    background = found[int(np.argmax(counts))]
    same, differ, between = 0, 0, 0
    for axis in range(3):
        if values.shape[axis] < 3:
            continue
        length = values.shape[axis] - 2
        a, b, c = (values[(slice(None),) * axis + (slice(k, k + length),)] for k in range(3))
        equal = a == b
        matters = (a != background) | (b != background)
        same += int(np.count_nonzero(matters & equal))
        differ += int(np.count_nonzero(~equal))
        between += int(np.count_nonzero((a < b) & (b < c)) + np.count_nonzero((a > b) & (b > c)))
    return differ > 0 and same > (0.5 if found.size == 2 else 0.6) * (same + differ) and between < 0.25 * differ


def label_background(sample: Sample, labels: np.ndarray) -> float | None:
    """The label that is outside of everything: 0 if there is one, otherwise the most frequent on the faces if it is on
    most of them, otherwise None."""
    if (labels == 0).any():
        return 0.0
    values = sample.values
    faces = np.concatenate([values.take(end, axis).ravel() for axis in range(3) for end in (0, -1)])
    faces = faces[np.isfinite(faces)]
    if faces.size == 0:
        return None
    found, counts = np.unique(faces, return_counts=True)
    best = int(np.argmax(counts))
    return float(found[best]) if counts[best] > 0.5 * faces.size else None


def palette(count: int) -> list[tuple[float, float, float]]:
    """``count`` sRGB colours that differ from their neighbours in the list, bright enough to show shading."""
    colors = []
    for k in range(count):
        hue = (0.07 + k * _GOLDEN) % 1.0
        saturation, value = ((0.55, 0.92), (0.72, 0.80), (0.40, 0.97))[k % 3]
        red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
        colors.append((round(red, 3), round(green, 3), round(blue, 3)))
    return colors


def label_points(labels: np.ndarray, background: float | None) -> list[tuple[float, float, tuple[float, float, float]]]:
    """Control points (value, opacity, colour) that give every label a colour of its own; the background has none.

    Steps lie half-way between labels, where no voxel is.
    """
    shown = [float(value) for value in labels if value != background]
    colors = dict(zip(shown, palette(len(shown))))
    cuts = 0.5 * (labels[1:] + labels[:-1])
    points = []
    for k, label in enumerate(float(value) for value in labels):
        color = colors.get(label, (0.5, 0.5, 0.5))
        opacity = 0.0 if label == background else 1.0
        if k > 0:
            points.append((float(cuts[k - 1]), opacity, color))
        if k < len(cuts):
            points.append((float(cuts[k]), opacity, color))
        if labels.size == 1:
            points.append((label, opacity, color))
    return points
