"""Warnings about a scene and its pictures, each given once."""

from __future__ import annotations

import copy
import sys
import warnings
from typing import Any

import numpy as np

from clvol.errors import ClvolWarning
from clvol.features.compression import compression_warnings
from clvol.features.scene_warnings import camera_warning, scene_warnings
from clvol.quietly import FILTERS
from clvol.render.picture_warnings import picture_warning
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene


class Notices:
    """Warnings about the frames of one scene, whose transfer function and camera may change."""

    def __init__(self, resolved: ResolvedScene) -> None:
        self._told: set[tuple[str, str]] = set()
        self.of_scene(resolved)

    def of_scene(self, resolved: ResolvedScene) -> None:
        self._of_scene = scene_warnings(resolved)

    def anew(self) -> Notices:
        """Those of another scene whose warnings are the same, none of which has been given."""
        other = copy.copy(self)
        other._told = set()
        return other

    def of_picture(
        self,
        resolved: ResolvedScene,
        camera: Camera,
        rgba: np.ndarray,
        depth: np.ndarray | None,
        compression: dict[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Gives the warnings that have not been given yet, and returns "warnings" for a frame's stats, or nothing.
        ``compression``: the entry of that name in these stats."""
        height, width = rgba.shape[:2]
        found = list(self._of_scene)
        away = camera_warning(camera, resolved.volume.grid, width, height)
        if away is not None:
            found.append(away)
        elif not found and (of_picture := picture_warning(resolved, camera, rgba, depth)) is not None:
            found.append(of_picture)
        if compression is not None:
            found += compression_warnings(resolved.compression, compression)
        for warning in found:
            self._tell(warning)
        return {"warnings": [str(warning) for warning in found]} if found else {}

    def of_devices(self, lost: dict[str, str | None], left: list[str]) -> None:
        """Warns once of each device that failed: ``lost``, by name with the reason; ``left``: those that work."""
        for name, reason in lost.items():
            what = f"failed and is left out from now on ({reason})"
            self._tell(ClvolWarning(f"device {name}", what, f"nothing: {' and '.join(left)} did its work"))

    def _tell(self, warning: ClvolWarning) -> None:
        # One cause is reported once, although its numbers may differ from frame to frame.
        cause = warning.where, warning.what.partition(":")[0]
        if cause not in self._told:
            self._told.add(cause)
            with FILTERS:
                warnings.warn(warning, stacklevel=_callers_level())


def _callers_level() -> int:
    """The stack level for ``warnings.warn``: the first frame outside this package, counted from the caller."""
    level, frame = 1, sys._getframe(1)
    package = __name__.partition(".")[0]
    while frame.f_back is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] not in (package, "contextlib"):
            break
        level, frame = level + 1, frame.f_back
    return level
