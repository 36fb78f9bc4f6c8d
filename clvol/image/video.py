"""Videos of an animation: .gif, .webp and .apng by Pillow, .mp4 where imageio-ffmpeg is installed.

Frames are shown as PNG shows them (``clvol.image.png.display``): over their background, sRGB.
Pillow takes them all at once, so a video needs 4 bytes of memory a pixel and frame until it is
written; an .mp4 is written frame by frame.
"""

from __future__ import annotations

import importlib.util
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from clvol.errors import RenderError, UsageError
from clvol.image.about import MADE_FROM
from clvol.image.png import display

# ending -> most frames a second, largest width and height
_LIMITS = {
    ".gif": (50.0, 65535),  # delays are hundredths of a second, and viewers slow down those of one
    ".webp": (1000.0, 16383),
    ".apng": (1000.0, 65535),
    ".mp4": (1000.0, 16384),
}
VIDEO_ENDINGS = tuple(_LIMITS)
_SLOWEST = 0.1  # frames a second: what every format can say
_QUALITY = 90  # of .webp, of 100


class VideoWriter(Protocol):
    def add(self, frame: Any) -> None:
        """The next frame; all are of one size."""

    def finish(self) -> None:
        """Writes what is still to be written; no frame can follow."""


def is_video(path: str | os.PathLike[str]) -> bool:
    return _ending(path) in VIDEO_ENDINGS


def check_video(path: str | os.PathLike[str], fps: float, width: int, height: int) -> None:
    """UsageError now if ``open_video`` could not write such frames; the folder is not looked at."""
    ending = _ending(path)
    if ending not in _LIMITS:
        known = " or ".join(VIDEO_ENDINGS)
        raise UsageError(str(path), f'videos have no ending "{Path(path).suffix}"', known)
    fastest, largest = _LIMITS[ending]
    if not _SLOWEST <= fps <= fastest:
        expected = f"{_SLOWEST:g} to {fastest:g} in a video that ends in {ending}"
        raise UsageError(str(path), f"{fps:g} frames a second", expected)
    if max(width, height) > largest:
        expected = f"at most {largest} pixels an edge in a video that ends in {ending}"
        raise UsageError(str(path), f"{width} x {height} pixels", expected)
    if ending == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        others = ", ".join(VIDEO_ENDINGS[:-1])
        expected = f"that package (pip install imageio-ffmpeg), or one of {others}"
        raise UsageError(str(path), "needs the package imageio-ffmpeg", expected)


@contextmanager
def open_video(
    path: Path, fps: float, made_from: Callable[[], dict[str, Any]] | None = None
) -> Iterator[VideoWriter]:
    """Yields a writer for the video file ``path``, which is complete after the block, or after the
    writer's ``finish``. What ``made_from`` gives when the first frame comes goes into the file, as
    JSON: a GIF's and an MP4's comment, WebP's XMP, the text "made_from" of an APNG. A block that ends
    early leaves a file that is no video: write to a temporary one (``clvol.image.atomic_path``). RenderError for no frame at all or frames of several sizes.
    """
    kind = _Mp4 if _ending(path) == ".mp4" else _Pillow
    writer = kind(path, fps, made_from)
    try:
        yield writer
        writer.finish()
    finally:
        writer.close()


class _Frames:
    """Frames as displayed, all of the first one's size."""

    def __init__(
        self, path: Path, fps: float, made_from: Callable[[], dict[str, Any]] | None
    ) -> None:
        self.path, self.fps = path, fps
        self._made_from = made_from
        self.count, self.finished = 0, False
        self._shape: tuple[int, ...] | None = None

    def add(self, frame: Any) -> None:
        background = getattr(frame, "background", None)
        shown = display(frame.rgba, (0.0, 0.0, 0.0) if background is None else background)
        if self._shape not in (None, shown.shape):
            was, now = (f"{s[1]} x {s[0]} pixels" for s in (self._shape, shown.shape))
            raise RenderError(f"{self.path.name}: frame {self.count}", now, f"{was}, as before")
        self._shape = shown.shape
        self._take(shown)
        self.count += 1

    def _take(self, shown: np.ndarray) -> None:
        """Keeps or encodes one frame, uint8 [height, width, 3]."""
        raise NotImplementedError

    def _write(self) -> None:
        """Completes the file; called once."""
        raise NotImplementedError

    def about(self) -> str | None:
        """What the video says about itself."""
        return None if self._made_from is None else json.dumps(self._made_from())

    def finish(self) -> None:
        if self.finished:
            return
        if not self.count:
            raise RenderError(self.path.name, "a video without any frame", "at least one")
        self._write()
        self.finished = True

    def close(self) -> None:
        """Called at the end, also of a video that is not finished."""


class _Pillow(_Frames):
    def __init__(
        self, path: Path, fps: float, made_from: Callable[[], dict[str, Any]] | None
    ) -> None:
        super().__init__(path, fps, made_from)
        self.ending = _ending(path)
        self._images: list[Any] = []

    def _take(self, shown: np.ndarray) -> None:
        from PIL import Image

        image = Image.fromarray(shown)
        if self.ending == ".gif":
            palette = image.quantize(256)
            image = image.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
        self._images.append(image)

    def _write(self) -> None:
        from PIL import PngImagePlugin

        unit = 10 if self.ending == ".gif" else 1
        how: dict[str, Any] = {"duration": frame_times(self.count, self.fps, unit), "loop": 0}
        if self.ending == ".webp":
            how |= {"quality": _QUALITY, "method": 4}
        elif self.ending == ".gif":
            how |= {"optimize": False}
        about = self.about()
        if about is not None and self.ending == ".apng":
            how["pnginfo"] = PngImagePlugin.PngInfo()
            how["pnginfo"].add_itxt(MADE_FROM, about, zip=True)
        elif about is not None:
            how["xmp" if self.ending == ".webp" else "comment"] = about.encode()
        first, *others = self._images
        form = {".gif": "GIF", ".webp": "WEBP", ".apng": "PNG"}[self.ending]
        with open(self.path, "wb") as file:
            first.save(file, format=form, save_all=True, append_images=others, **how)

    def close(self) -> None:
        self._images.clear()


class _Mp4(_Frames):
    """H.264 with half the colour resolution, which is what players can show; its sizes are even."""

    _process: Any = None

    def _take(self, shown: np.ndarray) -> None:
        height, width = shown.shape[:2]
        shown = np.pad(shown, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        if self._process is None:
            import imageio_ffmpeg

            about = self.about()
            told = [] if about is None else ["-metadata", f"comment={about}"]
            self._process = imageio_ffmpeg.write_frames(
                str(self.path), shown.shape[1::-1], fps=self.fps, codec="libx264", quality=8,
                macro_block_size=2, ffmpeg_log_level="error", output_params=told,
            )  # fmt: skip
            self._process.send(None)
        self._process.send(np.ascontiguousarray(shown))

    def _write(self) -> None:
        self.close()
        if not os.path.getsize(self.path):
            raise RenderError(self.path.name, "ffmpeg wrote nothing", "a video")

    def close(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None


def frame_times(count: int, fps: float, unit: int = 1) -> list[int]:
    """How long each frame is shown, in milliseconds, multiples of ``unit``. Rounding does not add
    up: the first n frames together take n / fps to within half a unit."""
    ends = np.rint(np.arange(count + 1) * (1000.0 / unit) / fps).astype(int) * unit
    return np.diff(ends).tolist()


def _ending(path: str | os.PathLike[str]) -> str:
    return Path(path).suffix.lower()
