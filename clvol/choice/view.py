"""Where a picture is taken from: what is up, which side is the front, and what has to be in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.choice.sample import Sample
from clvol.volume.volume import Volume

_MOST_POINTS = 40_000
_FAINT = 0.008  # share of the largest opacity that shows
_CUT_SHARE = 0.06  # of its largest cross-section with which an object is cut off
_NEAR = 0.02  # of the volume, from its faces inwards
# World directions towards left, anterior and superior.
_FRAMES = {
    "LPS": np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]),
    "RAS": np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "LAS": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
}
_SLICES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])  # rows of pixels go down, slices away
_SAGITTAL = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # such slices, the face to the left
_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
_SIDES = {
    "left": (1, 0, 0), "right": (-1, 0, 0), "front": (0, 1, 0), "back": (0, -1, 0), "top": (0, 0, 1),
    "bottom": (0, 0, -1),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class View:
    """``up`` and ``towards_eye``: unit world vectors [3]. ``axes``: world directions towards the object's left, front
    and up (rows). ``points`` [n, 3]: world positions that have to be in view. ``why``: in words."""

    up: np.ndarray
    towards_eye: np.ndarray
    axes: np.ndarray
    points: np.ndarray
    why: str


def anatomical_axes(frame: str) -> np.ndarray | None:
    """World directions towards left, anterior and superior (rows), or None for a frame that is not anatomical."""
    return _FRAMES.get(frame.split(" ")[0].upper())


def axes_of(frame: str) -> np.ndarray:
    """World directions towards left, front and up (rows): of the patient in an anatomical frame; as slices lie on a
    screen in the frame "image"; otherwise z is the front and y is up."""
    known = anatomical_axes(frame)
    if known is not None:
        return known
    return _SLICES if frame == "image" else _Y_UP


def is_view(name: str) -> bool:
    """Whether ``name`` is one of the six sides, or of two or three that meet, joined by hyphens."""
    words = name.split("-")
    if not all(word in _SIDES for word in words):
        return False
    return len({tuple(np.abs(_SIDES[word])) for word in words}) == len(words)


def named_view(name: str, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(towards_eye, up) of the view called ``name``, as unit world vectors. Left and right are those of the object.

    From the top the front is at the bottom of the picture, from the bottom at its top.
    """
    parts = np.array([_SIDES[word] for word in name.split("-")], dtype=float)
    towards = parts.sum(axis=0)
    up = axes[2]
    if towards[0] == 0 and towards[1] == 0:
        up = axes[1] * -towards[2]
    return _unit(towards @ axes), up


def view_of(volume: Volume, sample: Sample, opacity: np.ndarray, is_body: bool = False) -> View:
    """The view of what has ``opacity`` [z, y, x] (of the sample). ``is_body``: a person or an animal, whose axes are
    those of LPS where the file does not say otherwise."""
    mask = _solid(opacity, 0.25)
    shows = bool(mask.any())
    points = _hull_points(sample, _solid(opacity, 0.0)) if shows else sample.grid.world_corners()
    axes, why = _orientation(volume, _solid(opacity, 0.02), is_body)
    left, front, up = axes
    extent = np.ptp(points @ axes.T, axis=0)
    thin = int(np.argmin(extent))
    if extent[thin] < 0.25 * np.sort(extent)[1]:
        return _view_of_slab(sample, axes, thin, points, why)
    if is_body or anatomical_axes(volume.frame) is not None:
        degrees: tuple[float, ...] = (35.0,)
    else:
        degrees = tuple(range(20, 380, 30))
    candidates = []
    for angle in np.radians(degrees):
        side = np.cos(angle) * front + np.sin(angle) * left
        candidates.append(_unit(side + 0.30 * up))
    best = candidates[0]
    if len(candidates) > 1 and shows:
        surface, normals = _surface(sample, opacity, mask)
        scores = [_shown(surface, normals, eye, up) for eye in candidates]
        best = candidates[int(np.argmax(np.round(scores, 6)))]
        why += ", from where it shows most"
    return View(up, best, axes, points, why)


def _view_of_slab(sample: Sample, axes: np.ndarray, thin: int, points: np.ndarray, why: str) -> View:
    left, front, up = axes
    if thin == 2:  # lies flat: seen from above, its depth pointing up in the picture
        if min(sample.values.shape) <= 2:
            return View(-front, up, axes, points, f"a slice from above ({why})")
        return View(-front, _unit(up + 0.35 * front), axes, points, f"a flat volume from above ({why})")
    if min(sample.values.shape) <= 2:
        return View(up, (front, left)[thin == 0], axes, points, f"a slice from the front ({why})")
    if thin == 1:
        return View(up, _unit(front + 0.25 * left + 0.2 * up), axes, points, f"a thin volume from the front ({why})")
    return View(up, _unit(left + 0.25 * front + 0.2 * up), axes, points, f"a thin volume from the side ({why})")


def _solid(opacity: np.ndarray, share: float) -> np.ndarray:
    """What has more than ``share`` of the largest opacity, and is visible at all, without specks."""
    from scipy.ndimage import uniform_filter

    mask = opacity > max(share * opacity.max(), _FAINT * opacity.max())
    dense = mask & (uniform_filter(mask.astype(np.float32), 3, mode="constant") > 5.5 / 27.0)
    return dense if dense.any() else mask


def _hull_points(sample: Sample, mask: np.ndarray) -> np.ndarray:
    """World positions [n, 3] of the outermost of ``mask``: the first and last along each line of x."""
    first, last = mask.argmax(axis=2), mask.shape[2] - 1 - mask[:, :, ::-1].argmax(axis=2)
    z, y = np.nonzero(mask.any(axis=2))
    ends = np.concatenate([np.stack([z, y, x[z, y]], axis=1) for x in (first, last)])
    around = 0.5 if np.ptp(ends, axis=0).max() > 6 else 2.0  # a few voxels are not shown as large as the picture
    nearby = np.concatenate([ends - around, ends + around])
    return sample.world(nearby)


def _surface(sample: Sample, opacity: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World positions and outward normals, both [n, 3], of samples on the surface of ``mask``."""
    from scipy.ndimage import binary_erosion, gaussian_filter

    shell = np.argwhere(mask & ~binary_erosion(mask, border_value=0))
    shell = shell[:: max(1, shell.shape[0] // _MOST_POINTS)]
    soft = gaussian_filter(mask.astype(np.float32), 1.0)
    z, y, x = np.gradient(soft) if min(soft.shape) > 1 else (np.zeros_like(soft),) * 3
    at = tuple(shell.T)
    gradient = -np.stack([x[at], y[at], z[at]], axis=1) / sample.spacing
    normals = gradient @ sample.grid.direction.T
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return sample.world(shell), normals / np.maximum(length, 1e-12)


def _shown(points: np.ndarray, normals: np.ndarray, eye: np.ndarray, up: np.ndarray) -> float:
    """How much a view shows: the area of the visible surface, and the variety of its normals.

    The idea of viewpoint entropy (Bordoloi and Shen, "View selection for volume rendering", IEEE Visualization 2005),
    with the directions of visible surface in place of the visibility of voxels.
    """
    right = _unit(np.cross(up, eye))
    above = np.cross(eye, right)
    across = np.stack([points @ right, points @ above], axis=1)
    depth = points @ eye
    low = across.min(axis=0)
    size = float(np.max(np.ptp(across, axis=0))) or 1.0
    cell = np.minimum((across - low) / size * 72, 71).astype(int)
    key = cell[:, 1] * 72 + cell[:, 0]
    nearest = np.full(72 * 72, -np.inf)
    np.maximum.at(nearest, key, depth)
    seen = depth >= nearest[key] - 0.03 * size
    facing = normals[seen]
    area = np.count_nonzero(np.isfinite(nearest)) * (size / 72) ** 2
    bins = np.clip(((facing + 1.0) * 2.5).astype(int), 0, 4)
    counts = np.bincount(bins[:, 0] * 25 + bins[:, 1] * 5 + bins[:, 2], minlength=125)
    share = counts[counts > 0] / max(counts.sum(), 1)
    entropy = -float(np.sum(share * np.log(share))) / np.log(125)
    box = float(np.max(np.ptp(points, axis=0))) or 1.0
    return area / box**2 + 0.6 * entropy


def _orientation(volume: Volume, mask: np.ndarray, is_body: bool) -> tuple[np.ndarray, str]:
    """World directions towards left, front and up (rows), and what they were taken from."""
    known = anatomical_axes(volume.frame)
    if known is None and is_body:
        known = _FRAMES["LPS"]
    if known is not None and not is_placeholder(volume):
        return known, f"upright in {volume.frame}"
    if known is not None:
        axes, name = known, f"upright in {volume.frame}" if volume.frame != "index" else "upright as a body"
        if mask.any() and min(mask.shape) > 0.25 * max(mask.shape):
            alike = _symmetries(mask)
            if alike[0] > 0.75 and alike[0] > alike[2] + 0.15:  # from ear to ear along z: sagittal slices
                axes, name = _SAGITTAL, "as its slices are"
    else:
        axes, name = axes_of(volume.frame), "as its slices are" if volume.frame == "image" else "y is up"
    base = _base(volume, mask, axes[2])
    if base is None:
        return axes, name
    if float(base @ axes[2]) < -0.9:
        return axes, name
    return _stood_up(axes, -base), "standing where it is cut off"


def is_placeholder(volume: Volume) -> bool:
    """Whether a header says no more than the axes' default: converted files often state a frame and do not have it."""
    grid = volume.grid
    return volume.format != "DICOM" and not any(grid.origin) and np.array_equal(grid.direction, np.eye(3))


def _stood_up(axes: np.ndarray, up: np.ndarray) -> np.ndarray:
    """``axes`` with another ``up``: the front is kept where it can be, otherwise what was up becomes the front."""
    front = axes[1] if abs(float(axes[1] @ up)) < 0.5 else axes[2]
    front = _unit(front - (front @ up) * up)
    return np.stack([np.cross(up, front), front, up])


def _base(volume: Volume, mask: np.ndarray, up: np.ndarray) -> np.ndarray | None:
    """The world direction towards the side on which the object is cut off, as the neck of a head or the nozzle of a
    flame; None where no side is it clearly. ``up``: what is up otherwise, which stays if the object is cut off both
    above and below, as a trunk is."""
    if min(mask.shape) < 8 or not mask.any():
        return None
    inside = np.argwhere(mask)
    low, high = inside.min(axis=0), inside.max(axis=0)
    shape = np.array(mask.shape)
    near = np.maximum(1, _NEAR * shape)
    below, above = inside < near, inside >= shape - near
    cut = (below | above).any(axis=1)
    directions = volume.grid.direction[:, ::-1]  # columns by z, y, x
    sections = [np.asarray(mask.sum(axis=tuple(k for k in range(3) if k != axis))) for axis in range(3)]
    largest = max(int(np.max(section)) for section in sections)
    if np.count_nonzero(cut) > _CUT_SHARE * float(np.max(near)) * largest:
        along = int(np.argmax(np.abs(up @ directions)))
        ends = float(np.mean(below[cut, along])), float(np.mean(above[cut, along]))
        if min(ends) > max(0.05, 0.25 * max(ends)):
            return None
        half = np.maximum(0.5 * (high - low), 1.0)
        offset = ((inside[cut] - 0.5 * (low + high)) / half).mean(axis=0)
    else:
        offset = _flat_ends(mask, low, high)
    order = np.argsort(-np.abs(offset))
    if abs(offset[order[0]]) < 0.5 or abs(offset[order[1]]) > 0.6 * abs(offset[order[0]]):
        return None
    return _nearest_axis(directions[:, order[0]] * np.sign(offset[order[0]]))


def _flat_ends(mask: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Along z, y and x, how much flatter one end is than the other, from -1 to 1: flat ends have a large cross-section
    at once, others taper."""
    found = np.zeros(3)
    for axis in range(3):
        sums = mask.sum(axis=tuple(k for k in range(3) if k != axis))
        areas = np.asarray(sums, np.float64)[low[axis] : high[axis] + 1]
        if areas.size < 4:
            continue
        inward = max(1, int(0.04 * areas.size))
        largest = max(float(np.max(areas)), 1.0)
        first, last = float(np.mean(areas[:inward])) / largest, float(np.mean(areas[-inward:])) / largest
        if max(first, last) > 0.5:
            found[axis] = (last - first) / max(first, last)
    return found


def _nearest_axis(vector: np.ndarray) -> np.ndarray:
    axis = int(np.argmax(np.abs(vector)))
    return np.eye(3)[axis] * np.sign(vector[axis])


def _symmetries(mask: np.ndarray) -> np.ndarray:
    """How alike ``mask`` is to its mirror image along z, y and x, from 0 to 1: intersection over union."""
    inside = np.argwhere(mask)
    low, high = inside.min(axis=0), inside.max(axis=0) + 1
    box = mask[tuple(slice(a, b) for a, b in zip(low, high))]
    found = []
    for axis in range(3):
        other = np.flip(box, axis)
        common, either = int(np.count_nonzero(box & other)), int(np.count_nonzero(box | other))
        found.append(common / max(either, 1))
    return np.array(found)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
