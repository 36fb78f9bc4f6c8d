"""A rendered picture, with its statistics and its provenance."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from clvol.features import called_for
from clvol.image import save_frame, write_frame
from clvol.image.develop import shown_picture
from clvol.image.files import checked
from clvol.overlay import DrawnOverlay
from clvol.overlay.description import describe_overlay
from clvol.render.load_frame import load_frame
from clvol.render.made_from import MadeFrom
from clvol.scene.display import Display

if TYPE_CHECKING:
    from PIL.Image import Image

    from clvol.scene.camera import Camera
    from clvol.scene.resolve import ResolvedScene

STAGES = ("load", "prepare", "compile", "render", "write")


@dataclass(eq=False)
class Frame:
    """``rgba`` float32 [height, width, 4]: linear, premultiplied, without the background.

    ``depth`` float32 [height, width]: world distance along the ray from the eye (orthographic: from the
    camera plane) to where opacity reaches one half; infinite where it never does.
    ``background`` [3], linear. ``stats``: as ``--stats`` writes them. ``scene_source``: the scene as the
    text of a scene file, whose file names are relative to ``scene_folder``. ``made_from``: a function that returns what
    the picture was made from (``clvol.render.made_from``). ``display``: exposure and tone curve of displayed pictures,
    which may be replaced (``frame.display = clvol.Display(exposure=1.0)``); ``overlay``: what is drawn over them.

    A notebook shows a frame that is the value of its cell.
    """

    rgba: np.ndarray
    depth: np.ndarray | None = None
    background: np.ndarray = field(default_factory=lambda: np.zeros(3))
    stats: dict[str, Any] = field(default_factory=dict)
    scene_source: str | None = None
    made_from: Callable[[], dict[str, Any]] | None = None
    display: Display | None = None
    overlay: DrawnOverlay | None = None
    scene_folder: str | None = None

    def save(self, path: str | os.PathLike[str] | BinaryIO, format: str | None = None) -> None:
        """Writes .exr, .png, .jpg, .tif (16 bits) or .npy, according to the ending; the file appears whole or not at
        all.

        ``path`` may also be a binary file that is open for writing (``io.BytesIO()``); ``format`` is then one of these
        endings without its dot, "png" by default. Raises UsageError for another ending, RenderError where writing
        fails.
        """
        if isinstance(path, (str, os.PathLike)):
            save_frame(self, path)
        else:
            write_frame(self, path, f".{(format or 'png').removeprefix('.').lower()}")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Frame:
        """The frame of an .exr or .npy that clvol has written: its light, background, stats, scene, display and
        overlay, to be saved with another ``display``; nothing is rendered.

        Raises UsageError for other files and for damaged ones, SceneError for a wrong [display] in its scene.
        """
        return load_frame(cls, path)

    def image(self) -> Image:
        """The picture as displayed, as in a .png: a PIL image, mode "RGB", or "RGBA" where the display is transparent.
        ``numpy.asarray`` makes it uint8 [height, width, 3 or 4]."""
        from PIL import Image

        return Image.fromarray(shown_picture(self, checked(self.rgba)))

    def _repr_png_(self) -> bytes:
        """What a notebook shows."""
        file = io.BytesIO()
        self.image().save(file, format="PNG")
        return file.getvalue()

    def __repr__(self) -> str:
        """One line: an array of pixels would fill the page."""
        height, width = np.shape(self.rgba)[:2]
        told = [f"{width} x {height} pixels"]
        if "method" in self.stats:
            told.append(str(self.stats["method"]))
        if "seconds" in self.stats:
            told.append(f"{self.stats['seconds'].get('render', 0.0):.3g} s")
        return f"<Frame {', '.join(told)}>"


def make_frame(
    resolved: ResolvedScene,
    rgba: np.ndarray,
    depth: np.ndarray | None,
    seconds: dict[str, float],
    counted: dict[str, Any],
    devices: list[str],
    made_from: Callable[[], dict[str, Any]] | None = None,
    camera: Camera | None = None,
) -> Frame:
    """A frame of ``resolved`` with stats: ``seconds`` by stage (a missing stage took no time) and
    everything else that was ``counted``. ``made_from``: its ``made_from``; determined now where it is None. ``camera``:
    that of the picture, where it is another than the scene's."""
    if made_from is None:
        made_from = MadeFrom(resolved)
        made_from()
    stages = {stage: seconds.get(stage, 0.0) for stage in STAGES}
    stats = {
        "seconds": {**stages, "total": sum(stages.values())},
        **{name: value for name, value in counted.items() if name != "seconds"},
        "devices": list(devices),
        "effects": called_for(resolved),
        "method": resolved.integration.method,
    }
    chosen = resolved.chosen_classification
    if chosen is not None and chosen.name == resolved.integration.classification:
        stats["classification"] = {"name": chosen.name, "reason": chosen.reason}
    if resolved.chosen is not None:
        stats["chosen"] = resolved.chosen
    return Frame(
        np.asarray(rgba, np.float32),
        None if depth is None else np.asarray(depth, np.float32),
        resolved.background,
        stats,
        resolved.source,
        made_from,
        resolved.display,
        DrawnOverlay(describe_overlay(resolved, camera or resolved.camera)),
        None if resolved.folder is None else os.path.abspath(resolved.folder),
    )
