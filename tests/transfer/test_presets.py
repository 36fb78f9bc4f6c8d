"""Presets show something whatever the range of the volume is."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from clvol.errors import SceneError
from clvol.transfer import PRESETS, preset

RANGES = [
    (0.0, 255.0),
    (-1024.0, 3071.0),
    (0.0, 1e-30),
    (5.0, np.nextafter(5.0, 6.0)),
    (5.0, np.nextafter(np.nextafter(5.0, 6.0), 6.0)),
    (-1.7e308, 1.7e308),
    (0.0, sys.float_info.min * sys.float_info.epsilon),
    (3.0, 3.0),
    (0.0, 0.0),
    (-2.0, -1.0),
]


@pytest.mark.parametrize("value_range", RANGES)
@pytest.mark.parametrize("name", [n for n, p in PRESETS.items() if p.scale == "relative"])
def test_relative_presets_show_the_highest_value_of_any_range(name, value_range):
    function = preset(name, value_range)
    assert function.opacity(value_range[1]) >= 0.2
    assert function.color(value_range[1]).max() > 0.3
    assert value_range[0] == function.values[0] and value_range[1] == function.values[-1]


@pytest.mark.parametrize("value_range", RANGES)
def test_the_default_is_not_blank(value_range):
    function = preset("grayscale", value_range)
    assert function.opacity(value_range[1]) == 0.5
    assert function.color(value_range[1]).min() > 0.5


@pytest.mark.parametrize("name", [n for n, p in PRESETS.items() if p.scale == "hounsfield"])
def test_hounsfield_presets_do_not_move_with_the_range(name):
    assert preset(name, (0, 1)) == preset(name, (-1024, 3071))
    function = preset(name, (0, 1))
    assert function.opacity(-1000.0) == 0.0 and function.opacity(1500.0) > 0.6


def test_the_opacity_unit_is_handed_on():
    assert preset("hot", (0, 1), 2.5).opacity_unit == 2.5


def test_an_unknown_name_is_refused_and_the_nearest_named():
    with pytest.raises(SceneError, match=r"got 'greyscale', expected one of .*'grayscale'\?"):
        preset("greyscale", (0, 1))


@pytest.mark.parametrize("value_range", [(np.nan, 1), (0, np.inf), (1, 0)])
def test_an_impossible_range_is_refused(value_range):
    with pytest.raises(SceneError, match="value range"):
        preset("hot", value_range)
