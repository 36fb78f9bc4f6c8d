"""What a sample of a volume says about the object in it: background, polarity, boundaries and materials.

The *signal* of a voxel is how far it is from the background, in units of what is bright in the object: 0 is the
background, about 1 the brightest material. Metal and other rare outliers lie above 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clvol.choice.sample import Sample

_NOISE = 3.0  # standard deviations that separate the background from what stands out
_BINS = 256
_PARTIAL = 8  # bins next to the object's edge


@dataclass(frozen=True, eq=False)
class Statistics:
    """``low``, ``high``: range of the finite samples. ``background``: value of the background; ``noise``: its standard
    deviation. ``sign``: 1 if the object is brighter than the background, -1 if it is darker. ``scale``: difference in
    value that is a signal of 1. ``is_filled``: the volume's faces show no common background. ``stands_out``: share of
    samples whose signal is above the noise. ``both``: ratio of what is below the background to what is above it.

    ``signal``: float32 [z, y, x], 0 where there is no value; ``contrast``: float32, its range in the 3x3x3 samples
    around. ``sharpness``: contrast of the steepest boundaries relative to the object's brightness, about 0.5 and more
    where scans meet air, less than 0.2 in smooth simulations. ``edge``: signal of the boundary between background and
    object. ``materials``: signals, ascending, that separate the object's materials (from none to two).
    """

    sample: Sample
    low: float
    high: float
    background: float
    noise: float
    sign: int
    scale: float
    is_filled: bool
    stands_out: float
    both: float
    signal: np.ndarray
    contrast: np.ndarray
    sharpness: float
    edge: float
    materials: tuple[float, ...]

    def value(self, signal: float) -> float:
        """The value whose signal is ``signal``, within the range of the volume."""
        return float(np.clip(self.background + self.sign * self.scale * signal, self.low, self.high))

    @property
    def noise_signal(self) -> float:
        """Standard deviation of the background, as a signal."""
        return self.noise / self.scale


def half_sample_mode(values: np.ndarray) -> float:
    """The most frequent value of a sample, found by halving the shortest interval that holds half of it.

    Bickel and Frühwirth, "On a fast, robust estimator of the mode", Computational Statistics and Data Analysis 50
    (2006). ``values``: 1-D, finite, at least one.
    """
    left = np.sort(values)
    while left.size > 2:
        half = (left.size + 1) // 2
        widths = left[half - 1 :] - left[: left.size - half + 1]
        start = int(np.argmin(widths))
        if widths[start] == 0:
            return float(left[start])
        left = left[start : start + half]
    return float(left.mean())


def statistics_of(sample: Sample) -> Statistics | None:
    """What the finite values of ``sample`` show; None if there are none, or if all are the same."""
    values = sample.values
    finite = np.isfinite(values)
    if not finite.any():
        return None
    known = values[finite]
    low, high = float(known.min()), float(known.max())
    if not low < high:
        return None
    border = _faces(values)
    border = border[np.isfinite(border)]
    is_filled = border.size < 0.05 * _faces(finite).size
    if is_filled:
        border = known
    background = half_sample_mode(border)
    far = np.abs(border - background)
    spread = high - low
    near = far[far < 0.15 * spread]
    noise = 1.4826 * float(np.median(near)) if near.size else 0.0
    is_filled = is_filled or float(np.mean(far <= max(_NOISE * noise, 0.03 * spread))) < 0.35
    if is_filled:
        background, noise = float(np.percentile(known, 0.5)), 0.0
    above, below = _amounts(known - background, noise)
    sign = -1 if below > 2.0 * above and not is_filled else 1
    distance = sign * (known - background)
    out = distance[distance > _NOISE * noise]
    if out.size == 0:
        out = distance[distance > 0] if (distance > 0).any() else np.array([spread])
    scale = float(np.percentile(out, 99.5))
    signal = np.zeros(values.shape, np.float32)
    signal[finite] = np.clip(distance / scale, -4.0, 4.0)
    contrast = _contrast(signal, finite)
    threshold = max(_NOISE * noise / scale, 0.02)
    edge = _edge(signal, contrast, threshold)
    inside = signal > edge
    steep = contrast[inside & (contrast > 0)]
    return Statistics(
        sample=sample,
        low=low,
        high=high,
        background=background,
        noise=noise,
        sign=sign,
        scale=scale,
        is_filled=is_filled,
        stands_out=float(np.mean(distance > _NOISE * noise + 1e-3 * scale)),
        both=(min(above, below) / max(above, below)) if max(above, below) > 0 else 0.0,
        signal=signal,
        contrast=contrast,
        sharpness=float(np.percentile(steep, 90)) if steep.size else 0.0,
        edge=edge,
        materials=_materials(signal, contrast, edge),
    )


def _faces(values: np.ndarray) -> np.ndarray:
    """The values on the six faces of an array [z, y, x], 1-D."""
    faces = [values.take(end, axis).ravel() for axis in range(3) if values.shape[axis] > 2 for end in (0, -1)]
    return np.concatenate(faces) if faces else values.ravel()


def _amounts(distance: np.ndarray, noise: float) -> tuple[float, float]:
    """Means of what is above and what is below the background by more than noise, without rare outliers."""
    lowest, highest = np.percentile(distance, [0.02, 99.98])
    if lowest == highest == 0:
        lowest, highest = distance.min(), distance.max()
    clipped = np.clip(distance, lowest, highest)
    return (
        float(np.mean(np.maximum(clipped - _NOISE * noise, 0.0))),
        float(np.mean(np.maximum(-clipped - _NOISE * noise, 0.0))),
    )


def _contrast(signal: np.ndarray, finite: np.ndarray) -> np.ndarray:
    """Range of the signal in 3x3x3 samples; 0 where one of them has no value."""
    from scipy.ndimage import maximum_filter, minimum_filter

    contrast = maximum_filter(signal, 3, mode="nearest") - minimum_filter(signal, 3, mode="nearest")
    if not finite.all():
        contrast[~minimum_filter(finite, 3, mode="nearest")] = 0.0
    return contrast


def _edge(signal: np.ndarray, contrast: np.ndarray, threshold: float) -> float:
    """The signal on the boundary between background and object.

    Boundary samples lie where contrast is high; their mean, weighted by contrast, is on the middle of the boundary
    whatever the sizes of object and background (the simple image statistic of Kittler, Illingworth and Föglein,
    "Threshold selection based on a simple image statistic", Computer Vision, Graphics and Image Processing 30
    (1985)). Only samples next to the background count, so that boundaries inside the object do not raise it.
    """
    from scipy.ndimage import minimum_filter

    beside = minimum_filter(signal, 3, mode="nearest") <= threshold
    strong = beside & (signal > -1.0) & (contrast > 2.0 * threshold)
    if not strong.any():
        return max(0.5, threshold)
    weights, where = contrast[strong], np.clip(signal[strong], 0.0, 1.0)
    least = 0.5 * np.percentile(weights, 95)
    kept = weights >= least
    middle = float(np.sum(weights[kept] * where[kept]) / np.sum(weights[kept]))
    solid = signal[(signal > middle) & (contrast < 0.3)]
    if solid.size > 100:  # half-way to the object's dimmer parts, past foam and noise
        middle = float(np.clip(0.5 * np.percentile(solid, 25), middle, 1.5 * middle))
    return float(np.clip(middle, 1.5 * threshold, 0.7))


def _materials(signal: np.ndarray, contrast: np.ndarray, edge: float) -> tuple[float, ...]:
    """Signals in valleys of the object's histogram, which separate its materials.

    Otsu's thresholds for three classes and for two; one is kept if both of its sides are frequent, and if there are
    few samples at it in comparison.
    """
    from skimage.filters import threshold_multiotsu

    inside = signal[(signal > edge) & (contrast < 0.5)]
    if inside.size < 200:
        return ()
    top = float(np.percentile(inside, 99.9))
    if not edge < top:
        return ()
    counts, ends = np.histogram(np.clip(inside, edge, top), bins=_BINS, range=(edge, top))
    smooth = np.convolve(counts, np.hanning(11) / np.hanning(11).sum(), mode="same")
    if np.count_nonzero(counts) < 8:
        return ()
    for classes in (3, 2):
        centres = 0.5 * (ends[1:] + ends[:-1])
        found = threshold_multiotsu(classes=classes, hist=(counts.astype(float), centres), nbins=_BINS)
        bins = [int(np.searchsorted(ends, value)) for value in found]
        cuts = [_valley(smooth, bin) for bin in bins]
        if all(_is_valley(smooth, counts, cut, others) for cut, others in zip(cuts, _neighbours(cuts))):
            return tuple(float(ends[cut]) for cut in cuts)
    return ()


def _neighbours(cuts: list[int]) -> list[tuple[int, int]]:
    ends = [0, *cuts, _BINS]
    return [(ends[k], ends[k + 2]) for k in range(len(cuts))]


def _valley(smooth: np.ndarray, near: int, reach: int = 24) -> int:
    """The middle of the lowest place within ``reach`` bins of ``near``."""
    start = max(near - reach, 1)
    around = smooth[start : near + reach]
    return start + int(np.median(np.flatnonzero(around <= around.min() * 1.001)))


def _is_valley(smooth: np.ndarray, counts: np.ndarray, cut: int, within: tuple[int, int]) -> bool:
    left, right = smooth[within[0] : cut], smooth[cut : within[1]]
    if left.size == 0 or right.size == 0:
        return False
    if within[0] == 0 and int(np.argmax(left)) < _PARTIAL:  # the tail of partial volumes, no material
        return False
    lower = min(left.max(), right.max())
    shares = counts[within[0] : cut].sum() / counts.sum(), counts[cut : within[1]].sum() / counts.sum()
    return bool(smooth[cut] < 0.5 * lower and min(shares) > 0.02)
