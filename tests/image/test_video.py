"""Videos: every frame as PNG shows it, for the right time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image, ImageSequence

from clvol.errors import RenderError, UsageError
from clvol.image import check_video, open_video
from clvol.image.png import display
from clvol.image.video import frame_times

PILLOW = [".gif", ".webp", ".apng"]


def frame(level=0.3, shape=(5, 7), background=(0.1, 0.2, 0.4)):
    rgba = np.zeros((*shape, 4), np.float32)
    rgba[..., :] = (level, 0.5 * level, 0.1, 0.6)
    rgba[:, : shape[1] // 2] = 0.0
    return SimpleNamespace(rgba=rgba, background=background)


def written(path, frames, fps=10.0):
    with open_video(path, fps) as video:
        for one in frames:
            video.add(one)
    return path


def shown(path) -> list[np.ndarray]:
    with Image.open(path) as video:
        return [np.array(one.convert("RGB")) for one in ImageSequence.Iterator(video)]


@pytest.mark.parametrize(("ending", "atol"), [(".gif", 3), (".webp", 12), (".apng", 0)])
def test_frames_come_back_as_displayed(tmp_path, ending, atol):
    frames = [frame(level, (16, 24)) for level in (0.1, 0.3, 0.6)]
    found = shown(written(tmp_path / f"a{ending}", frames))
    assert len(found) == 3
    for one, picture in zip(frames, found):
        difference = np.abs(picture.astype(int) - display(one.rgba, one.background))
        assert difference.mean() <= atol


@pytest.mark.parametrize("ending", PILLOW)
@pytest.mark.parametrize("fps", [4.0, 24.0, 30.0])
def test_it_takes_as_long_as_it_should(tmp_path, ending, fps):
    levels = np.linspace(0.05, 0.6, 12)
    path = written(tmp_path / f"a{ending}", [frame(level) for level in levels], fps)
    with Image.open(path) as video:
        assert video.n_frames == 12
        times = []
        for index in range(12):
            video.seek(index)
            video.load()
            times.append(video.info["duration"])
    assert sum(times) == pytest.approx(12000 / fps, abs=5 if ending == ".gif" else 1)


def test_rounding_of_times_does_not_add_up():
    assert frame_times(4, 25.0, 10) == [40, 40, 40, 40]
    times = frame_times(300, 30.0, 10)
    assert set(times) == {30, 40} and sum(times) == 10000
    assert sum(frame_times(700, 7.0)) == 100000


@pytest.mark.parametrize("ending", PILLOW)
def test_frames_that_are_alike_take_their_time_too(tmp_path, ending):
    path = written(tmp_path / f"a{ending}", [frame(), frame(), frame(0.6)], 10.0)
    with Image.open(path) as video:
        total = 0
        for index in range(getattr(video, "n_frames", 1)):
            video.seek(index)
            video.load()
            total += video.info["duration"]
    assert total == pytest.approx(300, abs=1)


@pytest.mark.parametrize("ending", PILLOW)
def test_frames_of_another_size_and_no_frames_are_refused(tmp_path, ending):
    with pytest.raises(RenderError, match="frame 1: 6 x 5 pixels, expected 7 x 5 pixels"):
        written(tmp_path / f"a{ending}", [frame(), frame(shape=(5, 6))])
    with pytest.raises(RenderError, match="without any frame"):
        written(tmp_path / f"b{ending}", [])


@pytest.mark.parametrize(
    ("name", "fps", "size", "line"),
    [
        ("a.avi", 25.0, (8, 8), 'a.avi: unknown ending ".avi" of a video, expected .gif or .webp'),
        ("a.gif", 51.0, (8, 8), "a.gif: 51 frames per second, expected 0.1 to 50"),
        ("a.webp", 0.05, (8, 8), "a.webp: 0.05 frames per second, expected 0.1 to 1000"),
        ("a.webp", 25.0, (20000, 8), "a.webp: 20000 x 8 pixels, expected at most 16383 pixels"),
    ],
)
def test_what_a_format_cannot_say_is_refused(name, fps, size, line):
    with pytest.raises(UsageError) as caught:
        check_video(name, fps, *size)
    assert str(caught.value).startswith(line)


def test_an_mp4_is_written_where_the_package_is(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    check_video("a.mp4", 25.0, 31, 17)
    frames = [frame(level, (17, 31)) for level in np.linspace(0.1, 0.6, 10)]
    path = written(tmp_path / "a.mp4", frames, 5.0)
    count, seconds = ffmpeg.count_frames_and_secs(str(path))
    assert count == 10 and seconds == pytest.approx(2.0, abs=0.05)
    reader = ffmpeg.read_frames(str(path))
    assert next(reader)["size"] == (32, 18)
    first = np.frombuffer(next(reader), np.uint8).reshape(18, 32, 3)[:17, :31]
    expected = display(frames[0].rgba, frames[0].background).astype(int)
    assert np.abs(first - expected).mean() < 12
    reader.close()
