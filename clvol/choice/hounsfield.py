"""Recognises CT whose values are Hounsfield units, or Hounsfield units and an offset."""

from __future__ import annotations

import numpy as np

from clvol.choice.sample import Sample

_OFFSETS = (0.0, 1000.0, 1024.0)
AIR, TISSUE = (-1100.0, -880.0), (-150.0, 130.0)


def hounsfield_offset(sample: Sample) -> float | None:
    """What was added to Hounsfield units: 0, 1000 or 1024; None if the values are not Hounsfield units.

    CT has a peak of air near -1000 and one of soft tissue (fat about -100, muscle about 50), few values in between, and
    something that is denser.
    """
    known = sample.values[np.isfinite(sample.values)]
    if known.size < 1000:
        return None
    low, high = np.percentile(known, [0.05, 99.95])
    if not (600.0 <= high - low <= 9000.0 and np.unique(known[:: max(1, known.size // 20000)]).size > 100):
        return None
    best, offset = 0.0, None
    for candidate in _OFFSETS:
        units = known - candidate
        if units.min() < -3100.0 or units.max() > 32000.0 or low - candidate > -700.0:
            continue
        air = float(np.mean(units <= AIR[1]))
        soft = (units >= TISSUE[0]) & (units <= TISSUE[1])
        between = (units >= -700.0) & (units <= 700.0)
        if air < 0.03 or soft.mean() < 0.03 or np.percentile(units, 99.9) < 150.0:
            continue
        share = float(soft.sum() / max(between.sum(), 1))
        # The finer position of the peak: muscle and water lie at 0 to 80.
        counts, ends = np.histogram(units[between], bins=70, range=(-700.0, 700.0))
        peak = float(ends[int(np.argmax(counts))] + 10.0)
        score = share * (1.0 if -130.0 <= peak <= 110.0 else 0.5)
        score *= 1.0 - min(abs(peak - 45.0), 200.0) / 1000.0
        if score > best:
            best, offset = score, candidate
    return offset if best > 0.45 else None
