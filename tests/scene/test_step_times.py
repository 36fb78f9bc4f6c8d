"""Which step of a series is shown when: every step once where there is a frame for each, whatever the frame rate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol import Animation, Scene, VolumeSeries
from clvol.errors import SceneError, VolumeError
from clvol.scene.step_times import StepTimes, frames_of, rate_of

counts = st.integers(1, 2000)
rates = st.floats(0.01, 1000.0)


@given(counts, rates, st.integers(0, 1999))
def test_a_frame_per_step_shows_every_step_once(count, fps, index):
    times = StepTimes(count, rate_of(count, count, fps))
    index %= count
    assert times.at(index / fps) == index


@settings(max_examples=60)
@given(counts, rates, st.integers(1, 300))
def test_steps_are_spread_evenly_over_any_number_of_frames(count, fps, frames):
    shown = [StepTimes(count, rate_of(count, frames, fps)).at(k / fps) for k in range(frames)]
    assert shown[0] == 0 and shown == sorted(shown)
    if frames > 1:
        assert shown == [k * count // frames for k in range(frames)]


@settings(max_examples=60)
@given(st.integers(1, 200), st.integers(1, 60), st.integers(1, 60))
def test_an_animation_without_a_length_ends_with_the_last_step(count, rate, fps):
    frames, times = frames_of(count, float(rate), float(fps)), StepTimes(count, float(rate))
    assert times.at((frames - 1) / fps) == (frames - 1) * rate // fps <= count - 1
    assert frames * rate // fps >= count  # one frame more would show what is beyond it
    assert frames_of(count, None, float(fps)) == count


@given(counts, rates, st.floats(-1e6, 1e6))
def test_any_time_has_a_step_that_exists(count, rate, time):
    for loop in (False, True):
        assert 0 <= StepTimes(count, rate, loop).at(time) < count


@given(st.integers(1, 50), st.integers(0, 500))
def test_a_loop_begins_again(count, index):
    assert StepTimes(count, 10.0, loop=True).at(index / 10.0) == index % count
    assert StepTimes(count, 10.0, loop=False).at(index / 10.0) == min(index, count - 1)


def series(count: int) -> VolumeSeries:
    return VolumeSeries(np.arange(count * 8, dtype=np.uint8).reshape(count, 2, 2, 2))


@pytest.mark.parametrize(
    ("animation", "expected"),
    [
        ({}, [0, 0]),
        ({"time": 0.08}, [2, 2]),  # 25 frames per second, a frame per step
        ({"time": 1.0, "fps": 4.0}, [4, 4]),
        ({"frames": 3}, [0, 4]),  # 6 steps in 3 frames
    ],
)
def test_the_animation_says_which_step_is_shown(animation, expected):
    scene = Scene(volume=series(6), animation=Animation(**animation))
    resolved = scene.resolve()
    assert resolved.volume.number == expected[0]
    last = resolved.animation.time + (resolved.animation.frames - 1) / resolved.animation.fps
    assert resolved.at(last).volume.number == expected[1]


def test_the_rate_and_the_loop_of_a_series_from_python():
    steps = VolumeSeries(np.zeros((4, 2, 2, 2), np.uint8), steps_per_second=2.0, loop=True)
    resolved = Scene(volume=steps).resolve()
    assert [resolved.at(t).volume.number for t in (0.0, 0.49, 0.5, 1.9, 2.0)] == [0, 0, 1, 3, 0]


def test_a_step_by_number_and_by_name(tmp_path):
    for k in (1, 2, 10):
        np.save(tmp_path / f"t_{k}.npy", np.full((2, 2, 2), k, np.uint8))
    for step, expected in ((0, 1), (2, 10), ("t_2", 2), ("t_10.npy", 10)):
        scene = Scene(volume={"file": str(tmp_path / "t_*.npy"), "step": step, "loop": True})
        assert scene.load_volume().data.max() == expected
        assert scene.resolve().at(5.0).volume.data.max() == expected  # at all times
        assert scene.load_volume().value_range == (1.0, 10.0)
    for step, word in ((3, "0 to 2"), ("t_3", "t_1.npy")):
        with pytest.raises(VolumeError, match=word):
            Scene(volume={"file": str(tmp_path / "t_*.npy"), "step": step}).load_volume()


@pytest.mark.parametrize("key", [{"step": 0}, {"steps_per_second": 3.0}, {"value_range": [0.0, 9.0]}])
def test_keys_of_series_are_refused_for_one_volume(tmp_path, key):
    np.save(tmp_path / "a.npy", np.zeros((2, 2, 2), np.uint8))
    with pytest.raises(SceneError, match=rf"volume.{next(iter(key))}: got .* for one volume, expected a series"):
        Scene(volume={"file": str(tmp_path / "a.npy"), **key}).resolve()
