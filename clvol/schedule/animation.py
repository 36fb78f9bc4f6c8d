"""Time and camera of each frame of an animation."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from clvol.errors import UsageError
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.keyframes import camera_at


def frames(resolved: ResolvedScene) -> Iterator[tuple[int, float, Camera]]:
    """(index from 0, time in seconds, camera) of each frame.

    Frames are 1 / ``animation.fps`` apart. The rotation of ``animation.orbit_degrees`` is divided evenly, so that
    it would be complete one frame after the last: a rotation of 360 degrees loops seamlessly. It is added to the view
    of the keyframes.
    """
    animation = resolved.animation
    for index in range(animation.frames):
        turn = animation.orbit_degrees * index / animation.frames
        seconds = animation.time + index / animation.fps
        camera = camera_at(resolved.camera, animation.keyframe, seconds, resolved.origin)
        yield index, seconds, orbited(camera, turn)


def orbited(camera: Camera, degrees: float) -> Camera:
    """``camera`` rotated about its target, around ``up``. With positive ``degrees`` the camera moves to the right, so
    the object appears to turn to the left. UsageError for a camera that is not complete."""
    if degrees == 0:
        return camera
    if camera.position is None or camera.target is None or camera.up is None:
        raise UsageError("camera", "lacks a position, a target or an up", "a complete camera")
    up = np.asarray(camera.up) / np.linalg.norm(camera.up)
    away = np.subtract(camera.position, camera.target)
    angle = math.radians(math.fmod(degrees, 360.0))
    along = (away @ up) * up
    across = away - along
    turned = along + math.cos(angle) * across + math.sin(angle) * np.cross(up, across)
    position = tuple(float(x) for x in np.asarray(camera.target) + turned)
    return camera.model_copy(update={"position": position})
