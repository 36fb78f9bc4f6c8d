"""One vocabulary in Python and in OpenCL C; what is called for, and what identifies a kernel."""

from __future__ import annotations

import re

import numpy as np
import pytest
from small_scenes import SMOOTH, make_scene, waves

from clvol import TransferFunction, Volume
from clvol.errors import SceneError
from clvol.features import (
    CLASSIFICATIONS,
    FILTERS,
    GRADIENTS,
    explain,
    kernel_hash,
    refuse_unknown,
)
from clvol.opencl.kernels_path import kernel_folder
from clvol.scene import Clip, ImageSettings, Isosurface, Light, Scene


@pytest.mark.parametrize(
    "prefix, table",
    [("FILTER", FILTERS), ("CLASSIFICATION", CLASSIFICATIONS), ("GRADIENT", GRADIENTS)],
)
def test_the_vocabulary_is_one(prefix, table):
    text = (kernel_folder() / "features.h").read_text()
    matches = re.finditer(rf"#define {prefix}_(\w+) (\d+)", text)
    found = {m[1].lower().replace("_", "-"): int(m[2]) for m in matches}
    assert found == table


def scene_with(**tables):
    volume = Volume(waves((8, 8, 8), np.uint8))
    return Scene(
        volume=volume, transfer_function=SMOOTH, image=ImageSettings(width=8, height=8), **tables
    ).resolve()


def called(resolved) -> dict[str, bool]:
    return {e["name"]: e["called_for"] for e in explain(resolved)["effects"]}


def test_effects_without_a_consequence_are_not_called_for_and_compile_the_same_kernel():
    plain = scene_with()
    idle = scene_with(
        light=(Light(type="headlight", intensity=0.0),),
        isosurface=(Isosurface(value=300.0, opacity=1.0), Isosurface(value=100.0, opacity=0.0)),
        clip=(Clip(point=(-50.0, 0.0, 0.0), normal=(1.0, 0.0, 0.0)),),
    )
    assert called(plain) == called(idle)
    assert kernel_hash(plain) == kernel_hash(idle)
    reasons = {e["name"]: e["reason"] for e in explain(idle)["effects"]}
    assert "outside the data's range 0 to 255" in reasons["isosurfaces"]
    assert "no clip plane meets the volume" in reasons["clipping"]


@pytest.mark.parametrize(
    "tables",
    [
        {"light": (Light(type="headlight"),)},
        {"isosurface": (Isosurface(value=100.0),)},
        {"clip": (Clip(point=(3.0, 0.0, 0.0), normal=(1.0, 0.0, 0.0)),)},
    ],
)
def test_what_is_called_for_and_cannot_be_rendered_is_refused(tables):
    with pytest.raises(SceneError, match=f"{next(iter(tables))}: .* cannot be rendered"):
        refuse_unknown(scene_with(**tables))


def test_the_kernel_hash_tells_kernels_apart_and_nothing_else():
    array = waves((8, 8, 8), np.uint8)
    plain = kernel_hash(make_scene(array))
    assert plain == kernel_hash(make_scene(array, width=7, step=0.3, table_size=300))
    other = TransferFunction([0, 255], [0, 0.5], [[1, 0, 0]] * 2)
    assert plain == kernel_hash(make_scene(array, other, camera={"projection": "orthographic"}))
    different = [
        make_scene(array, filter="nearest"),
        make_scene(array, filter="cubic"),
        make_scene(array, classification="post"),
        make_scene(array.astype(np.int16)),
        make_scene(array, method="reference"),
        make_scene(array, method="reference", filter="cubic"),
    ]
    assert len({plain, *map(kernel_hash, different)}) == 7


def test_a_transparent_transfer_function_calls_for_nothing():
    hidden = make_scene(waves((8, 8, 8), np.uint8), TransferFunction([0, 255, 400], [0, 0, 1], [[1, 1, 1]] * 3))
    assert called(hidden) == {
        "emission-absorption": False, "lighting": False, "isosurfaces": False, "clipping": False,
    }  # fmt: skip
