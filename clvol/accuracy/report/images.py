"""The pictures of a report, as separate files and in a size that fits the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from clvol.accuracy.difference import (
    Scale,
    linear_scale,
    logarithmic_scale,
    magnitude,
    palette,
    signed_difference,
)
from clvol.image.png import display

_WIDTHS = (640, 512, 400, 320, 256, 192, 128, 96)  # widths in pixels of a picture on the page
_BUDGET = 4_000_000  # bytes for all pictures on the page, before base64 adds a third


@dataclass
class PageImages:
    """The pictures of the page, ``width`` by ``height`` pixels each, and ``full_width`` pixels wide originally.

    ``pictures``, ``shared`` and ``own`` map points to data URIs: of the picture, of its difference on the scale that
    all share, and of its difference on a scale of its own (``scales``). ``shared_scale`` is None if there is nothing
    to compare.
    """

    width: int = 0
    height: int = 0
    full_width: int = 0
    pictures: dict[str, str] = field(default_factory=dict)
    shared: dict[str, str] = field(default_factory=dict)
    own: dict[str, str] = field(default_factory=dict)
    scales: dict[str, Scale] = field(default_factory=dict)
    shared_scale: Scale | None = None


def page_images(
    pictures: Mapping[str, np.ndarray], background: Sequence[float], keys: Sequence[str]
) -> PageImages:
    """The pictures of "reference" and ``keys`` for the page, as large as the size limit of the page allows.

    ``pictures`` are [height, width, 4], linear, premultiplied; ``background`` [3] is linear. When pictures are made
    smaller, each pixel is the mean of the linear light of the pixels that it replaces, and in difference pictures the
    root of their mean square.
    """
    keys = [key for key in keys if key in pictures]
    if "reference" not in pictures:
        return PageImages()
    reference = pictures["reference"]
    height, width = reference.shape[:2]
    values = {key: magnitude(signed_difference(pictures[key], reference)) for key in keys}
    shared = logarithmic_scale(values.values())
    scales = {key: linear_scale(values[key]) for key in keys}
    for small in sorted({min(width, w) for w in _WIDTHS}, reverse=True):
        size = (max(1, round(height * small / width)), small)
        encoded = {
            key: _png(display(_resize(pictures[key], size), background))
            for key in ["reference", *keys]
        }
        less = {key: _resize_magnitude(values[key], size) for key in keys}
        on_shared = {key: _indexed_png(shared.indices(less[key])) for key in keys}
        on_own = {key: _indexed_png(scales[key].indices(less[key])) for key in keys}
        if sum(len(b) for d in (encoded, on_shared, on_own) for b in d.values()) <= _BUDGET:
            break
    return PageImages(
        width=size[1], height=size[0], full_width=width,
        pictures={key: _uri(b) for key, b in encoded.items()},
        shared={key: _uri(b) for key, b in on_shared.items()},
        own={key: _uri(b) for key, b in on_own.items()},
        scales=scales, shared_scale=shared if keys else None,
    )


def picture_file(rgba: np.ndarray, background: Sequence[float]) -> bytes:
    """A PNG of the picture over ``background`` ([3], linear) in full size."""
    return _png(display(rgba, background))


def shown_file(pixels: np.ndarray) -> bytes:
    """A PNG of uint8 [height, width, 3]."""
    return _png(pixels)


def color_stops(count: int = 12) -> list[str]:
    """The colours of differences from zero to the end of the scale, in CSS notation."""
    colors = palette()[:-1]
    rows = np.linspace(0, len(colors) - 1, count).round().astype(int)
    return ["#%02x%02x%02x" % tuple(colors[row]) for row in rows]


def _resize(rgba: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """``rgba`` in another size; each new pixel is the mean over its area."""
    if rgba.shape[:2] == size:
        return rgba
    return np.stack([_box(rgba[..., c], size) for c in range(rgba.shape[2])], axis=-1)


def _resize_magnitude(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    if values.shape == size:
        return values
    return np.sqrt(_box(np.square(values), size))


def _box(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(values, dtype=np.float32))
    return np.asarray(image.resize(size[::-1], Image.Resampling.BOX))


def _png(pixels: np.ndarray) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def _indexed_png(indices: np.ndarray) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    image = Image.fromarray(indices)
    image.putpalette(palette().tobytes())
    image.save(stream, format="PNG", optimize=True)
    return stream.getvalue()


def _uri(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
