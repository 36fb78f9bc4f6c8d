"""Cameras and values of a scene between keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import Camera, Scene, Volume, load_scene
from clvol.batch.frames import Frames
from clvol.errors import SceneError
from clvol.schedule.animation import frames
from clvol.schedule.keyframes import camera_at, check_scenes, scene_at

POINTS = [{"value": 0, "opacity": 0, "color": [0, 0, 0]}, {"value": 80, "opacity": 0.2, "color": [1, 0.5, 0]}]
LATER = [{"value": 20, "opacity": 0, "color": [0, 0, 0]}, {"value": 120, "opacity": 0.6, "color": [1, 1, 1]}]


def scene(*keyframes, **tables) -> Scene:
    volume = Volume(np.arange(6 * 5 * 4, dtype=np.uint8).reshape(6, 5, 4))
    tables = {
        "volume": volume, "transfer_function": {"points": POINTS}, "camera": {"position": [0, 0, 60]},
        "noise": [{"target": "value", "amplitude": 10.0}], "isosurface": [{"value": 30.0, "opacity": 0.5}], **tables,
    }  # fmt: skip
    return Scene(animation={"frames": 5, "fps": 2.0, "keyframe": list(keyframes)}, **tables)


def refused(*keyframes, **tables) -> str:
    with pytest.raises(SceneError) as caught:
        check_scenes(scene(*keyframes, **tables))
    return str(caught.value)


def test_the_camera_moves_along_its_keyframes():
    film = scene(
        {"time": 0.0, "camera": {"position": [0, 0, 60], "fov_degrees": 30}},
        {"time": 1.0, "camera": {"position": [60, 0, 0], "up": [0, 1, 0]}},
        {"time": 2.0, "camera": {"position": [0, 0, -60], "target": [2, 2, 2], "fov_degrees": 10, "up": [0, 1, 1]}},
    ).resolve()
    found = list(frames(film))
    assert [seconds for _, seconds, _ in found] == [0.0, 0.5, 1.0, 1.5, 2.0]
    cameras = [camera for _, _, camera in found]
    assert cameras[0].position == (0, 0, 60) and cameras[2].position == (60, 0, 0)
    assert cameras[1].position == pytest.approx((30 + 60 * 0.125, 0, 30 + 0.0))  # tangents -60 and 0; 60 and -60
    assert cameras[1].target == cameras[4].target == (2, 2, 2)  # of one keyframe, all the time
    assert [camera.fov_degrees for camera in cameras] == pytest.approx([30, 25, 20, 15, 10])
    assert cameras[0].up == (0, 1, 0) and cameras[4].up == pytest.approx((0, 0.5**0.5, 0.5**0.5))
    assert cameras[3].up == pytest.approx((0, np.cos(np.pi / 8), np.sin(np.pi / 8)))


def test_the_orbit_is_added():
    film = scene({"time": 0.0, "camera": {"position": [0, 2, 60], "target": [0, 2, 0]}}).resolve()
    film = film.__class__(**{**vars(film), "animation": film.animation.model_copy(update={"orbit_degrees": 360.0})})
    cameras = [camera for _, _, camera in frames(film)]
    assert cameras[0].position == (0, 2, 60)
    assert cameras[1].position == pytest.approx((60 * np.sin(np.radians(72)), 2, 60 * np.cos(np.radians(72))))


def test_values_of_all_kinds_move():
    film = scene(
        {"time": 0.0, "set": {"noise.0.amplitude": 10.0, "isosurface.0.value": 30, "transfer_function.points": POINTS}},
        {"time": 2.0, "set": {"noise.0.amplitude": 50.0, "transfer_function.points": LATER}},
        {"time": 4.0, "set": {"isosurface.0.value": 90, "transfer_function.opacity_unit": 2.0}},
    )
    check_scenes(film)
    half = scene_at(film, 1.0)
    assert half.noise[0].amplitude == pytest.approx(30.0) and half.isosurface[0].value == pytest.approx(45.0)
    assert [point.value for point in half.transfer_function.points] == [10, 100]
    assert half.transfer_function.points[1].opacity == pytest.approx(0.4)
    assert half.isosurface[0].opacity == 0.5 and half.transfer_function.opacity_unit == 2.0
    assert not half.animation.keyframe and half.animation.frames == 5
    assert half.resolve().volume is film.resolve().volume
    end = scene_at(film, 9.0)
    assert end.noise[0].amplitude == 50.0 and end.isosurface[0].value == 90


def test_clip_planes_move():
    film = scene(
        {"time": 0.0, "set": {"clip.0.point": [0, 0, 0]}}, {"time": 1.0, "set": {"clip.0.point": [3, 0, 8]}},
        clip=[{"point": [0, 0, 0], "normal": [1, 0, 0]}],
    )  # fmt: skip
    assert scene_at(film, 0.5).clip[0].point == pytest.approx((1.5, 0, 4))


def test_frames_say_what_they_were_made_from():
    film = scene({"time": 0.0, "set": {"noise.0.amplitude": 1.0}}, {"time": 2.0, "set": {"noise.0.amplitude": 5.0}})
    all_frames = Frames(film, film.resolve(), [])
    told = [all_frames.made_from(frame)() for frame in all_frames.all]
    assert len({facts["scene"] for facts in told}) == 5
    still = scene({"time": 0.0, "camera": {"position": [0, 0, 70]}})
    told = [made() for made in map(Frames(still, still.resolve(), []).made_from, frames(still.resolve()))]
    assert len({facts["scene"] for facts in told}) == 1


def test_a_scene_file_with_keyframes_reads_back(tmp_path):
    film = scene({"time": 0.0, "camera": {"position": [0, 0, 9]}, "set": {"noise.0.amplitude": 1.5}}, volume={
        "field": "radial", "size": [8, 8, 8]})  # fmt: skip
    path = tmp_path / "film.toml"
    path.write_text(film.to_toml())
    assert load_scene(path).animation == film.animation
    path.write_text(film.to_toml().replace('"noise.0.amplitude"', "noise.0.amplitude"))  # tables in tables
    assert load_scene(path).animation == film.animation


@pytest.mark.parametrize(("keyframes", "said"), [
    ([{"time": 0.0}], "keyframe.0.set: missing, expected a camera or values to set"),
    ([{"time": 1.0, "set": {"noise.0.amplitude": 1}}] * 2, "keyframe.1.time: got 1.0, expected ascending times"),
    ([{"time": 0.0, "set": {"volume.file": 1}}], "expected a key such as 'noise.0.amplitude'"),
    ([{"time": 0.0, "set": {"noise.0.target": "value"}}], "expected numbers, or lists and tables of numbers"),
    ([{"time": 0.0, "set": {"clip.0.point": [1, 2]}}, {"time": 1.0, "set": {"clip.0.point": [1, 2, 3]}}],
     "expected as many numbers as in the keyframes before"),
    ([{"time": 0.0, "set": {"shadow.factor": 1.0}}], "the scene does not state that table"),
    ([{"time": 0.0, "set": {"noise.0.amplitud": 1.0}}], "noise.0.amplitud: unknown key"),
    ([{"time": 0.0, "set": {"isosurface.0.opacity": 0.0}}, {"time": 1.0, "set": {"isosurface.0.opacity": 3.0}}],
     "sets, at 0.5 s, what is not allowed: scene: isosurface.0.opacity: got 1.5"),
    ([{"time": 0.0, "camera": {"fov_degrees": 200}}], "camera.fov_degrees: got 200"),
])  # fmt: skip
def test_what_is_refused(keyframes, said):
    assert said in refused(*keyframes)


def test_views_that_are_none_are_refused():
    keyframes = scene(
        {"time": 0.0, "camera": {"position": [0, 0, 9], "target": [0, 0, 0]}},
        {"time": 1.0, "camera": {"position": [0, 0, 5], "target": [0, 0, 5.0]}},
    ).animation.keyframe
    camera = Camera(position=[0, 0, 9], target=[0, 0, 0], up=[0, 1, 0])
    with pytest.raises(SceneError, match="keyframe at 1 s"):
        camera_at(camera, keyframes, 1.0)
    ups = scene({"time": 0, "camera": {"up": [0, 1, 0]}}, {"time": 1, "camera": {"up": [0, -1, 0]}}).animation.keyframe
    with pytest.raises(SceneError, match="opposite to the one before"):
        camera_at(camera, ups, 0.5)
