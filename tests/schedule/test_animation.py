"""Frames of an animation: their times, and the camera's orbit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_scenes import make_scene

from clvol import Renderer
from clvol.scene import Animation, Camera
from clvol.schedule.animation import frames, orbited

CAMERA = Camera(position=(7.0, 3.0, 12.0), target=(1.0, 2.0, 3.0), up=(0.1, 1.0, -0.2))


def scene_of(**animation):
    return replace(make_scene(), animation=Animation(**animation))


def test_frames_are_evenly_apart_in_time():
    found = list(frames(scene_of(time=2.0, frames=5, fps=4.0)))
    assert [index for index, *_ in found] == [0, 1, 2, 3, 4]
    assert [time for _, time, _ in found] == [2.0, 2.25, 2.5, 2.75, 3.0]


def test_without_an_orbit_the_camera_stands_still():
    resolved = scene_of(frames=3)
    assert all(camera is resolved.camera for *_, camera in frames(resolved))


def test_a_full_turn_ends_where_the_next_would_begin():
    resolved = scene_of(frames=8, orbit_degrees=360.0)
    cameras = [camera for *_, camera in frames(resolved)]
    assert cameras[0] is resolved.camera
    target = np.asarray(resolved.camera.target)
    away = np.array([np.subtract(camera.position, target) for camera in cameras])
    distances = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(distances, distances[0])
    np.testing.assert_allclose(away.mean(axis=0) @ np.array([1.0, 0.0, 1.0]), 0.0, atol=1e-9)
    steps = np.linalg.norm(away - np.roll(away, 1, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0])


@pytest.mark.parametrize("degrees", [10.0, -75.0, 180.0, 400.0])
def test_an_orbit_turns_about_up_and_keeps_all_else(degrees):
    turned = orbited(CAMERA, degrees)
    up = np.asarray(CAMERA.up) / np.linalg.norm(CAMERA.up)
    before, after = (np.subtract(c.position, c.target) for c in (CAMERA, turned))
    assert after @ up == pytest.approx(before @ up)
    flat_before, flat_after = (v - (v @ up) * up for v in (before, after))
    assert np.linalg.norm(flat_after) == pytest.approx(np.linalg.norm(flat_before))
    cosine = flat_before @ flat_after / np.linalg.norm(flat_before) ** 2
    assert cosine == pytest.approx(np.cos(np.radians(degrees)))
    assert (turned.target, turned.up, turned.fov_degrees) == (CAMERA.target, CAMERA.up, 30.0)


def test_a_positive_turn_goes_to_the_right():
    _, right, _ = CAMERA.basis()
    moved = np.subtract(orbited(CAMERA, 5.0).position, CAMERA.position)
    assert moved @ right > 0.99 * np.linalg.norm(moved)


def test_turning_back_leads_back():
    there_and_back = orbited(orbited(CAMERA, 37.0), -37.0)
    np.testing.assert_allclose(there_and_back.position, CAMERA.position)


def test_a_frame_compiles_and_uploads_nothing(device, monkeypatch):
    from clvol.device.volume import DeviceVolume
    from clvol.opencl.context import DeviceContext

    resolved = scene_of(frames=3, orbit_degrees=90.0)
    with Renderer(resolved, [device]) as renderer:
        first = renderer.render()

        def never(*_, **__):
            raise AssertionError("compiled or uploaded anew")

        monkeypatch.setattr(DeviceContext, "_program", never)
        monkeypatch.setattr(DeviceVolume, "__init__", never)
        pictures = [renderer.render(camera=c, time=t).rgba.copy() for _, t, c in frames(resolved)]
        again = renderer.render()
    assert np.array_equal(pictures[0], first.rgba)
    assert not np.array_equal(pictures[1], pictures[0])
    assert np.array_equal(again.rgba, first.rgba)  # the scene's own time and camera
