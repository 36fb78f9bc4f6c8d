"""The frames of a video that survive the process: numbered pictures beside it until it is complete, so that --resume
goes on where a process ended, however it did."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from clvol.batch.names import numbered
from clvol.errors import RenderError, UsageError
from clvol.scene import Scene


class VideoParts:
    """The pictures in the folder ``VIDEO.frames`` of the first of ``videos``, which are made if they are not there."""

    def __init__(self, scene: Scene, videos: Sequence[str]) -> None:
        if scene.display.transparent:
            what = f"given with {videos[0]} and display.transparent"
            raise UsageError("--resume", what, "display.transparent = false")
        self._folder = f"{videos[0]}.frames"
        self.pattern = os.path.join(self._folder, "%06d.png")

    def begin(self) -> None:
        """Makes the folder. RenderError where that fails."""
        try:
            os.makedirs(self._folder, exist_ok=True)
        except OSError as error:
            raise RenderError(self._folder, f"cannot be made ({error.strerror})", "a folder to write into") from None

    def add_to(self, writers: Iterable[Any], indices: Iterable[int]) -> None:
        """Adds the pictures, frame after frame, to the videos."""
        from PIL import Image

        for index in indices:
            with Image.open(numbered(self.pattern, index)) as picture:
                shown = np.asarray(picture.convert("RGB"))
            for writer in writers:
                writer.add_shown(shown)

    def remove(self, indices: Iterable[int]) -> None:
        """Removes the pictures, which the videos hold now, and the folder if nothing else is in it."""
        for index in indices:
            with suppress(OSError):
                os.remove(numbered(self.pattern, index))
        with suppress(OSError):
            os.rmdir(self._folder)
