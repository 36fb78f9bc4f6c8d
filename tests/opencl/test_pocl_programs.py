"""What PoCL compiles for a picture depends neither on the size of the volume nor on that of the picture."""

from __future__ import annotations

import os

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, waves

from clvol import GradientSettings, ImageSettings, Integration, Light, Renderer, Scene, Volume
from clvol.opencl import pocl_programs
from clvol.opencl.build import is_pocl


def _compiled() -> int:
    """The number of kernels that PoCL has compiled in this process, once per size of work-groups."""
    assert pocl_programs._folder is not None
    return sum(name.endswith(".so") for _, _, names in os.walk(pocl_programs._folder) for name in names)


def _render(context, shape: tuple[int, int, int], size: int, **settings) -> None:
    scene = Scene(
        volume=Volume(waves(shape, np.uint8)),
        transfer_function=SMOOTH,
        image=ImageSettings(width=size, height=size + 3),
        **settings,
    )
    with Renderer(scene, devices=[context.name]) as renderer:
        renderer.render(depth=False)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"integration": Integration(method="pyramid")},
        {"light": (Light(type="headlight"),), "gradient": GradientSettings(storage="precomputed")},
    ],
    ids=["raycast", "pyramid", "lit"],
)
def test_another_size_compiles_nothing(context, settings):
    if not is_pocl(context.device):
        pytest.skip("PoCL alone compiles kernels again for each size of groups")
    _render(context, (12, 17, 9), 20, **settings)
    before = _compiled()
    assert before > 0
    _render(context, (40, 31, 53), 37, **settings)
    assert _compiled() == before
