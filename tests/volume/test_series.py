"""A series has the facts of all its steps, holds two of them at most, and names the one that is wrong."""

from __future__ import annotations

import gc
import threading
import warnings
import weakref

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clvol import Volume, VolumeSeries
from clvol.errors import ClvolWarning, VolumeError

RNG = np.random.default_rng(5)
STEPS = RNG.integers(0, 200, (6, 3, 4, 5)).astype(np.uint8)


class Counted:
    """Steps that count how often they are read, and how many of their arrays exist at once."""

    def __init__(self, count: int, shape=(4, 5, 6), fails=()) -> None:
        self.reads: list[int] = []
        self.alive = self.most = 0
        self._fails, self._shape, self._lock = set(fails), shape, threading.Lock()
        self.steps = [lambda k=k: self._read(k) for k in range(count)]

    def _read(self, k: int) -> Volume:
        self.reads.append(k)
        if k in self._fails:
            raise VolumeError(f"step {k}", "is damaged", "whole data")
        array = np.full(self._shape, k, np.uint8)
        array[0, 0, 0] = 255 - k
        with self._lock:
            self.alive += 1
            self.most = max(self.most, self.alive)
        weakref.finalize(array, self._gone)
        return Volume(array)

    def _gone(self) -> None:
        with self._lock:
            self.alive -= 1


@settings(max_examples=40, deadline=None)
@given(arrays(np.float32, (4, 2, 3, 2), elements=st.floats(-1e6, 1e6, width=32) | st.sampled_from(
    [np.nan, np.inf, -np.inf]
)))  # fmt: skip
def test_range_and_holes_are_those_of_all_times(array):
    step = VolumeSeries(array).step(1)
    finite = array[np.isfinite(array)]
    expected = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    assert step.value_range == expected
    assert (step.nan_count > 0) == bool(np.isnan(array).any())
    assert step.nan_count + step.inf_count < step.data.size or not finite.size  # some voxel may be shown
    np.testing.assert_array_equal(step.data, array[1])


@pytest.mark.parametrize("slope", [2.0, -0.5])
def test_values_and_stored_numbers_of_a_series(slope):
    series = VolumeSeries(STEPS, slope=slope, offset=3.0)
    whole = Volume(STEPS.reshape(-1, 4, 5), slope=slope, offset=3.0)
    assert series.step(4).value_range == whole.value_range
    plain, axis = series.step(4).plain
    assert axis.slope > 0 and plain.value_range == whole.plain[0].value_range
    np.testing.assert_array_equal(axis.values(plain.data.astype(float)), slope * STEPS[4] + 3.0)
    assert plain.at(2).plain[0] is plain.at(2)
    np.testing.assert_array_equal(axis.values(plain.at(2).data.astype(float)), slope * STEPS[2] + 3.0)


def test_all_steps_are_read_once_for_what_they_have_in_common():
    counted = Counted(7)
    series = VolumeSeries(counted.steps)
    assert counted.reads == []
    assert series.facts.census.upper == 255 and series.facts.widest == 0
    assert counted.reads == list(range(7)) and counted.most <= 2


def test_a_stated_range_saves_reading_them():
    counted = Counted(7)
    series = VolumeSeries(counted.steps, value_range=(0, 255))
    assert series.step(3).value_range == (0.0, 255.0)
    assert counted.reads == [0]


def test_at_most_two_steps_are_in_memory_and_each_is_read_once():
    counted = Counted(9)
    series = VolumeSeries(counted.steps, value_range=(0, 255))
    for k in range(9):
        assert series.step(k).data[1, 1, 1] == k
        series.read_ahead(k + 1)
    assert counted.reads == list(range(9)) and counted.most == 2
    series.close()
    gc.collect()
    assert counted.alive == 0


def test_steps_that_were_not_expected_are_read_all_the_same():
    counted = Counted(9)
    series = VolumeSeries(counted.steps, value_range=(0, 255))
    for k in (0, 5, 5, 2, 8, 0):
        series.read_ahead(k + 1)
        assert series.step(k).data[1, 1, 1] == k
    assert counted.most <= 2


def test_threads_get_the_step_that_they_ask_for():
    series = VolumeSeries(Counted(5).steps, value_range=(0, 255))
    wrong = []

    def work(seed: int) -> None:
        for k in np.random.default_rng(seed).integers(0, 5, 50).tolist():
            if series.step(k).data[1, 1, 1] != k:
                wrong.append(k)
            series.read_ahead((k + seed) % 5)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert wrong == []


def test_a_step_that_cannot_be_read_is_named_and_the_others_are_there():
    series = VolumeSeries(Counted(5, fails={0, 3}).steps)
    with pytest.warns(ClvolWarning, match=r"2 steps of 5 cannot be read: step 0, step 0: is damaged.*; the others"):
        assert series.facts.census.lower == 1
    assert sorted(series.failures) == [0, 3]
    assert series.step(4).data[1, 1, 1] == 4
    series.read_ahead(3)
    with pytest.raises(VolumeError, match="step 3: is damaged"):
        _ = series.step(3).data
    assert series.step(2).data[1, 1, 1] == 2


def test_a_series_without_a_readable_step_is_refused():
    with pytest.raises(VolumeError, match="step 0: is damaged"):
        _ = VolumeSeries(Counted(3, fails={0, 1, 2}).steps).facts


@pytest.mark.parametrize(
    ("other", "what"),
    [
        (Volume(STEPS[0, :2]), "5 x 4 x 2 voxels, expected 5 x 4 x 3, as step 0 has"),
        (Volume(STEPS[0].astype(np.int16)), "voxels of type int16, expected uint8"),
        (Volume(STEPS[0], spacing=(1, 1, 1.01)), r"spacing \[1.0, 1.0, 1.01\], expected \[1.0, 1.0, 1.0\]"),
        (Volume(STEPS[0], origin=(0, 0.5, 0)), "origin"),
        (Volume(STEPS[0], direction=np.diag([1.0, -1.0, 1.0])), "direction"),
        (Volume(STEPS[0], slope=2.0), "slope 2, offset 0, expected slope 1, offset 0"),
    ],
)
@pytest.mark.parametrize("stated", [None, (0, 255)])
def test_a_step_that_differs_is_named(other, what, stated):
    series = VolumeSeries([Volume(STEPS[0]), other, Volume(STEPS[1])], value_range=stated)
    with pytest.raises(VolumeError, match=f"^step 1: {what}"):
        _ = series.step(1).data


def test_grids_that_differ_by_rounding_are_one():
    steps = [Volume(STEPS[k], spacing=(0.1, 0.1, 0.1 + 1e-9 * k), origin=(1e-8 * k, 0, 0)) for k in range(3)]
    assert VolumeSeries(steps).step(2).grid == steps[0].grid


@pytest.mark.parametrize("stated", [None, (0, 70_000)])
def test_wide_integers_get_one_type(stated):
    """Each step alone would get a smaller one."""
    wide = np.stack([np.full((2, 2, 2), most, np.int32) for most in (9, 60_000, 70_000)])
    assert [Volume(each).dtype.name for each in wide] == ["uint8", "uint16", "float32"]
    series = VolumeSeries(wide, value_range=stated)
    for k in range(3):
        assert series.step(k).data.dtype == np.float32
        np.testing.assert_array_equal(series.step(k).data, wide[k])


def test_values_beyond_a_stated_range_are_refused():
    series = VolumeSeries(STEPS, value_range=(0, 250))
    assert series.step(2).value_range == (0.0, 250.0)
    beyond = VolumeSeries([STEPS[0] // 4, STEPS[1]], value_range=(0, 60))
    with pytest.raises(VolumeError, match=r"^step 1: values from .*, beyond volume.value_range, expected"):
        _ = beyond.step(1).data
    for wrong in ((3, 1), (0,), (0, np.nan), "ab"):
        with pytest.raises(VolumeError, match="two finite numbers"):
            VolumeSeries(STEPS, value_range=wrong)


def test_a_series_of_one_step():
    series = VolumeSeries([STEPS[0]])
    assert len(series) == 1 and series.step(0).value_range == Volume(STEPS[0]).value_range
    for wrong in (-1, 1):
        with pytest.raises(VolumeError, match="0 to 0"):
            series.step(wrong)


@pytest.mark.parametrize(
    ("steps", "what"),
    [([], "no step"), (STEPS[0], "a 3-D array"), (STEPS[..., None], "a 5-D array"), (7, "a int"), ("t_*.npy", "a str")],
)
def test_what_is_no_series_is_refused(steps, what):
    with pytest.raises(VolumeError, match=f"series: {what}"):
        VolumeSeries(steps)


def test_names_of_steps():
    series = VolumeSeries(STEPS, names=list("abcdef"))
    assert series.index("c") == 2 and series.index(4) == 4 and series.index("5") == 5
    with pytest.raises(VolumeError, match="'x', which is the name of 0 steps"):
        series.index("x")
    with pytest.raises(VolumeError, match="2 names for 6 steps"):
        VolumeSeries(STEPS, names=["a", "b"])


def test_xarray_with_a_dimension_of_time():
    xarray = pytest.importorskip("xarray", reason="xarray comes with an extra")
    array = xarray.DataArray(
        STEPS.transpose(1, 0, 2, 3), dims=("z", "time", "y", "x"), coords={"x": np.arange(5) * 0.5, "time": range(6)}
    )
    series = VolumeSeries(array)
    assert len(series) == 6 and series.step(0).grid.spacing == (0.5, 1.0, 1.0)
    for k in (0, 5):
        np.testing.assert_array_equal(series.step(k).data, STEPS[k])
    with pytest.raises(VolumeError, match=r"6 times along time, .*x.isel\(time=0\); clvol.VolumeSeries\(x\)"):
        Volume(array)
    with pytest.raises(VolumeError, match="the dimensions z, c, y, x"):
        VolumeSeries(array.rename(time="c"))


def test_nothing_is_said_of_a_series_without_faults():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert VolumeSeries(STEPS).step(3).data.shape == (3, 4, 5)
