"""Renderers whose devices have processes of their own."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from clvol import Renderer, Scene, Volume
from clvol.errors import ClvolWarning
from clvol.render.isolation.process import DeviceProcess
from helpers.small_scenes import SMOOTH, waves

KINDS = {
    "plain": {},
    "fewer rays": {"image": {"ray_spacing": 4, "ray_tolerance": 0.02}},
    "surfaces": {"isosurface": [{"value": 120.0, "color": [1, 0.5, 0.2]}], "light": [{"type": "headlight"}]},
    "pyramid": {"integration": {"method": "pyramid"}},
    "reference": {"integration": {"method": "reference"}, "image": {"width": 20, "height": 10}},
    "multiresolution": {"integration": {"method": "multiresolution"}},
    "codes": {"compression": {"codec": "rvq"}},
}


def scene(kind: str = "plain", width: int = 150, height: int = 100, **more):
    tables = {**KINDS[kind], **more}
    image = {"width": width, "height": height, **tables.pop("image", {})}
    return Scene(
        **{"volume": Volume(waves((19, 17, 23))), "transfer_function": SMOOTH, "image": image, **tables}
    )  # fmt: skip


def assert_same(frame, other) -> None:
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    np.testing.assert_array_equal(frame.depth, other.depth)
    for key in ("samples", "rays"):
        assert frame.stats[key] == other.stats[key]
    for key in ("counters", "compression"):
        assert frame.stats.get(key, {}) == other.stats.get(key, {})


def states(frame) -> list[str]:
    return [each["state"] for each in frame.stats["schedule"]["devices"]]


def workers(renderer: Renderer) -> list[DeviceProcess]:
    return [member.process for member in renderer._on_device.members]


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def told_by(call):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = call()
    return result, [str(w.message) for w in caught if issubclass(w.category, ClvolWarning)]
