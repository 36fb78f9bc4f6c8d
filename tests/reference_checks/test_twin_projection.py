"""The twin's other compositing modes, on rays whose values are known."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.twin_scenes import along_z, ramp, scene

from clvol import TransferFunction

GREY = TransferFunction([0.0, 30.0], [0.0, 1.0], [[0.0, 0.0, 0.0], [1.0, 0.5, 0.25]])
MIDDLES = np.arange(15) + 0.5


def shown(value, factor=1.0):
    """What GREY shows of a value."""
    alpha = value / 30 * factor
    return [*(np.array([1, 0.5, 0.25]) * value / 30 * alpha), alpha]


def mode(name, array=None, **keys):
    integration = {"compositing": name, **keys.pop("integration", {})}
    return scene(ramp() if array is None else array, GREY, integration=integration, **keys)


@pytest.mark.parametrize("name, value", [("maximum", 14.5), ("minimum", 0.5), ("average", 7.5)])
def test_extremes_and_mean_of_a_ramp(name, value):
    assert along_z(mode(name), step=1.0) == pytest.approx(shown(value))


def test_segments_are_sampled_at_their_middles_and_the_last_is_shorter():
    assert along_z(mode("maximum"), step=4.0) == pytest.approx(shown(13.5))
    assert along_z(mode("average"), step=4.0) == pytest.approx(shown(7.5))  # by length


def test_the_maximum_of_a_wave():
    wave = 20 + 10 * np.cos(np.arange(64) / 7.0 - 1.3)
    array = np.broadcast_to(wave[:, None, None], (64, 2, 2)).copy()
    for name, extreme in (("maximum", 30.0), ("minimum", 10.0)):
        s = mode(name, array, integration={"filter": "catmull-rom"})
        assert along_z(s, 0.5, 0.5, step=0.1) == pytest.approx(shown(extreme), abs=1e-3)


@pytest.mark.parametrize("attenuation", [0.0, 1.5, 20.0])
@pytest.mark.parametrize("step", [1.0, 4.0])
@pytest.mark.parametrize("falls", [True, False])
def test_attenuated_maximum(attenuation, step, falls):
    """By the definition, one segment after the other; what counts is what lies before a segment."""
    ends = np.minimum(np.arange(0, 15 + step, step), 15.0)
    best, passed = (-1.0, 0.0, 0.0), 0.0
    for start, end in zip(ends, ends[1:]):
        middle = 0.5 * (start + end)
        value = 15 - middle if falls else middle
        factor = np.exp(-attenuation * passed / 15)
        best = max(best, (value / 15 * factor, value, factor))
        passed += value / 15 * (end - start)
    array = 15 - ramp() if falls else ramp()
    s = mode("attenuated-maximum", array, integration={"attenuation": attenuation})
    assert along_z(s, step=step) == pytest.approx(shown(best[1], best[2]))


def test_nan_does_not_count_and_no_sample_is_nothing():
    array = ramp()
    array[6:] = np.nan
    assert along_z(mode("maximum", array), step=1.0) == pytest.approx(shown(4.5))
    assert along_z(mode("average", array), step=1.0) == pytest.approx(shown(2.5))
    for name in ("maximum", "minimum", "average", "attenuated-maximum"):
        assert np.all(along_z(mode(name), x=-1.0) == 0)
        assert np.all(along_z(mode(name, array), start=9.0) == 0)


def test_clips_cut_projections_and_nothing_is_lit():
    keys = {
        "clip": [{"point": [0, 0, 9], "normal": [0, 0, -1]}],
        "light": [{"type": "headlight"}],
        "isosurface": [{"value": 3.0}],
        "shadow": {"method": "rays"},
    }
    assert along_z(mode("maximum", **keys), step=1.0) == pytest.approx(shown(8.5))
