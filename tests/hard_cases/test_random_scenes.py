"""Whatever the scene, less step is less error (tests/helpers/random_scenes.py runs more of them)."""

from __future__ import annotations

import pytest
from helpers.random_scenes import errors, random_scene, shrinks


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(16))
def test_the_error_shrinks_with_the_step(device, seed):
    scene = random_scene(seed)
    found = errors(device, scene)
    assert shrinks(found), f"{scene}: {found}"
