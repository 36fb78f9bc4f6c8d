"""Writes videos of animations: .gif, .webp and .apng with Pillow, and .mp4 if imageio-ffmpeg is installed.

Frames are shown as in a PNG (``clvol.image.develop``), over their background, sRGB-encoded, never transparent. Pillow
takes all frames at once, so a video needs 4 bytes of memory per pixel and frame until it is written. An .mp4 is
written frame by frame.
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
from clvol.image.develop import shown_picture

# ending -> largest frame rate (per second), largest width or height (pixels)
_LIMITS = {
    ".gif": (50.0, 65535),  # delays are in 1/100 s, and viewers slow down delays of 1/100 s
    ".webp": (1000.0, 16383),
    ".apng": (1000.0, 65535),
    ".mp4": (1000.0, 16384),
}
VIDEO_ENDINGS = tuple(_LIMITS)
_SLOWEST = 0.1  # frames per second, which every format can express
_QUALITY = 90  # of .webp, 0 to 100


class VideoWriter(Protocol):
    """Takes the frames of a video one by one."""

    def add(self, frame: Any) -> None:
        """Adds the next frame. All frames have the same size."""

    def add_shown(self, shown: np.ndarray) -> None:
        """As ``add``, of a frame as displayed: uint8 [height, width, 3]."""

    def finish(self) -> None:
        """Writes the rest of the file, after which no frame can be added."""


def is_video(path: str | os.PathLike[str]) -> bool:
    return _ending(path) in VIDEO_ENDINGS


def check_video(path: str | os.PathLike[str], fps: float, width: int, height: int) -> None:
    """Raises UsageError now if ``open_video`` could not write such frames later. The folder is not checked."""
    ending = _ending(path)
    if ending not in _LIMITS:
        known = " or ".join(VIDEO_ENDINGS)
        raise UsageError(str(path), f'unknown ending "{Path(path).suffix}" of a video', known)
    fastest, largest = _LIMITS[ending]
    if not _SLOWEST <= fps <= fastest:
        expected = f"{_SLOWEST:g} to {fastest:g} in a video that ends in {ending}"
        raise UsageError(str(path), f"{fps:g} frames per second", expected)
    if max(width, height) > largest:
        expected = f"at most {largest} pixels per edge in a video that ends in {ending}"
        raise UsageError(str(path), f"{width} x {height} pixels", expected)
    if ending == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
        others = ", ".join(VIDEO_ENDINGS[:-1])
        expected = f"that package (pip install imageio-ffmpeg), or one of {others}"
        raise UsageError(str(path), "needs the package imageio-ffmpeg", expected)


@contextmanager
def open_video(
    path: Path, fps: float, made_from: Callable[[], dict[str, Any]] | None = None
) -> Iterator[VideoWriter]:
    """Yields a writer for the video file ``path``, which is complete after the block, or after the writer's
    ``finish``.

    ``made_from`` is called when the file's metadata are written, and its result is stored as JSON: in the comment of
    a GIF or an MP4, the XMP of a WebP, the text "made_from" of an APNG. If the block ends early, the file is
    incomplete, so write to a temporary one (``clvol.image.atomic_path``). Raises RenderError if there is no frame, or
    if the frames differ in size.
    """
    kind = _Mp4 if _ending(path) == ".mp4" else _Pillow
    writer = kind(path, fps, made_from)
    try:
        yield writer
        writer.finish()
    finally:
        writer.close()


class _Frames:
    """The common part of the writers: takes frames as displayed, all of the first one's size."""

    def __init__(
        self, path: Path, fps: float, made_from: Callable[[], dict[str, Any]] | None
    ) -> None:
        self.path, self.fps = path, fps
        self._made_from = made_from
        self.count, self.finished = 0, False
        self._shape: tuple[int, ...] | None = None

    def add(self, frame: Any) -> None:
        self.add_shown(shown_picture(frame, np.asarray(frame.rgba, np.float32), may_be_transparent=False))

    def add_shown(self, shown: np.ndarray) -> None:
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
        """The metadata of the video as JSON, if there are any."""
        return None if self._made_from is None else json.dumps(self._made_from())

    def finish(self) -> None:
        if self.finished:
            return
        if not self.count:
            raise RenderError(self.path.name, "a video without any frame", "at least one")
        self._write()
        self.finished = True

    def close(self) -> None:
        """Releases resources; called at the end, also if the video is not finished."""


class _Pillow(_Frames):
    """Collects all frames, and writes them with Pillow."""

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
        options: dict[str, Any] = {"duration": frame_times(self.count, self.fps, unit), "loop": 0}
        if self.ending == ".webp":
            options |= {"quality": _QUALITY, "method": 4}
        elif self.ending == ".gif":
            options |= {"optimize": False}
        about = self.about()
        if about is not None and self.ending == ".apng":
            options["pnginfo"] = PngImagePlugin.PngInfo()
            options["pnginfo"].add_itxt(MADE_FROM, about, zip=True)
        elif about is not None:
            options["xmp" if self.ending == ".webp" else "comment"] = about.encode()
        first, *others = self._images
        form = {".gif": "GIF", ".webp": "WEBP", ".apng": "PNG"}[self.ending]
        with open(self.path, "wb") as file:
            first.save(file, format=form, save_all=True, append_images=others, **options)

    def close(self) -> None:
        self._images.clear()


class _Mp4(_Frames):
    """H.264 with chroma subsampling, which players support. Width and height are padded to even numbers."""

    _process: Any = None

    def _take(self, shown: np.ndarray) -> None:
        height, width = shown.shape[:2]
        shown = np.pad(shown, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        if self._process is None:
            import imageio_ffmpeg

            about = self.about()
            metadata = [] if about is None else ["-metadata", f"comment={about}"]
            self._process = imageio_ffmpeg.write_frames(
                str(self.path), shown.shape[1::-1], fps=self.fps, codec="libx264", quality=8,
                macro_block_size=2, ffmpeg_log_level="error", output_params=metadata,
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
    """The duration of each frame in milliseconds, a multiple of ``unit``. Rounding errors do not accumulate: the
    first n frames together take n / fps to within half a unit."""
    ends = np.rint(np.arange(count + 1) * (1000.0 / unit) / fps).astype(int) * unit
    return np.diff(ends).tolist()


def _ending(path: str | os.PathLike[str]) -> str:
    return Path(path).suffix.lower()
