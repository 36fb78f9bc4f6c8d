"""The frames of an animation, and the numbered pictures that are made of them."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from clvol.batch.claims import Claims
from clvol.batch.made import is_made_from
from clvol.batch.names import numbered
from clvol.image import atomic_paths, save_picture
from clvol.image.develop import shown_picture
from clvol.integrators.base import Progress
from clvol.render.frame import Frame
from clvol.render.made_from import MadeFrom
from clvol.render.renderer import Renderer
from clvol.scene import Scene, load_scene
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.schedule.animation import frames as frames_of
from clvol.schedule.keyframes import check_scenes, scene_at

Timed = tuple[int, float, Camera]  # number from 0, time in seconds, camera


class Frames:
    """All frames of ``scene``, resolved: ``resolved``; ``stills`` are the patterns of the names of their pictures."""

    def __init__(self, scene: Scene, resolved: ResolvedScene, stills: Sequence[str]) -> None:
        self.resolved, self._scene, self._stills = resolved, scene, list(stills)
        self.all: list[Timed] = list(frames_of(resolved))
        self._sets_values = any(keyframe.set for keyframe in scene.animation.keyframe)
        check_scenes(scene)

    def _at(self, seconds: float) -> ResolvedScene:
        """The scene at a time."""
        if self._sets_values:
            return scene_at(self._scene, seconds).resolve().at(seconds)
        return self.resolved

    def names(self, index: int) -> list[str]:
        return [numbered(path, index) for path in self._stills]

    def made_from(self, frame: Timed) -> MadeFrom:
        index, seconds, camera = frame
        return MadeFrom(self._at(seconds).at(seconds), camera, index)

    def is_there(self, frame: Timed) -> bool:
        """Whether all its pictures exist, are whole, and were made as they would be made now."""
        names = self.names(frame[0])
        if not all(map(os.path.exists, names)):
            return False
        made_from = self.made_from(frame)()
        resolved = self._at(frame[1])
        return all(is_made_from(name, resolved, made_from) for name in names)

    def render(
        self, renderer: Renderer, frame: Timed, progress: Progress | None, depth: bool, following: Timed | None = None
    ) -> Frame:
        """``following``: the frame that will be rendered next, whose step of a series is read meanwhile; None where
        that depends on other processes."""
        _, seconds, camera = frame
        if self._sets_values:
            renderer.set_scene(self._at(seconds))
        ahead = {} if following is None or self.resolved.steps is None else {"next_time": following[1]}
        rendered = renderer.render(camera=camera, time=seconds, progress=progress, depth=depth, **ahead)
        rendered.made_from = self.made_from(frame)
        return rendered

    def write(self, frame: Frame, index: int) -> list[str]:
        """Writes the pictures of a frame, which appear together, and returns their names."""
        names = self.names(index)
        with atomic_paths(names) as places:
            for name, place in zip(names, places):
                save_picture(frame, place, name)
        return names


@dataclass
class Animation:
    """What a process needs to know to make frames of a scene in the file ``scene``. ``shown``: frames are returned as
    displayed, for a video. ``resume``: pictures that are there already are kept. The rest is as for ``Renderer``."""

    scene: str
    overrides: list[str]
    stills: list[str]
    shown: bool = False
    resume: bool = False
    devices: list[str] | None = None
    memory_cap: int | None = None
    isolate: bool = False

    def as_request(self) -> dict[str, Any]:
        return asdict(self)


class FramesRun:
    """Makes frames of an animation in this process, one by one; the scene is loaded and prepared once."""

    def __init__(self, animation: Animation) -> None:
        self._animation = animation
        scene = load_scene(animation.scene, animation.overrides)
        scene.load(animation.memory_cap)
        self._frames = Frames(scene, scene.resolve(animation.memory_cap), animation.stills)
        self._depth = any(path.lower().endswith(".exr") for path in animation.stills)
        self._renderer = Renderer(
            scene, devices=animation.devices, memory_cap=animation.memory_cap, isolate=animation.isolate
        )

    @classmethod
    def from_request(cls, described: dict[str, Any]) -> FramesRun:
        return cls(Animation(**described))

    def close(self) -> None:
        self._renderer.close()

    def make(self, index: int) -> dict[str, Any]:
        """Makes frame ``index``: {"stats", "write"} (seconds that writing took), {"kept": True} if its pictures exist
        already, or {"busy": True} while another process is making them. "pixels": uint8 [height, width, 3], if shown
        frames are wanted."""
        names = self._frames.names(index)
        if not names:
            return self._made(index)
        with Claims() as claims, claims.of(names[0]) as claimed:
            if not claimed:
                return {"busy": True}
            if self._animation.resume and self._frames.is_there(self._frames.all[index]):
                return {"kept": True}
            return self._made(index, claims)

    def _made(self, index: int, claims: Claims | None = None) -> dict[str, Any]:
        frame = self._frames.render(self._renderer, self._frames.all[index], None, self._depth)
        start = time.perf_counter()
        if claims is not None:
            if not claims.owns(self._frames.names(index)[0]):
                return {"busy": True}  # this process was stopped for so long that another one has taken over
            self._frames.write(frame, index)
        answer = {"stats": frame.stats, "write": time.perf_counter() - start}
        if self._animation.shown:
            answer["pixels"] = shown_picture(frame, frame.rgba, may_be_transparent=False)
        return answer
