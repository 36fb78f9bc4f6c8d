"""The method "pyramid" by the renderer: other functions, and what they make a scene call for."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.pyramid_scenes import SHELL, pyramid_scene
from helpers.small_scenes import SMOOTH, rms

from clvol import Renderer
from clvol.errors import SceneError
from clvol.scene.clip import Clip

BLANK = SMOOTH.__class__([0.0, 255.0], [0.0, 0.0], [[1, 1, 1]] * 2)
PLANE = Clip(point=(20.0, 15.0, 18.0), normal=(1.0, 0.6, 0.3))
SPHERE = Clip(type="sphere", center=(20.0, 15.0, 18.0), radius=9.0)


def test_another_function_has_tables_and_maps_of_its_own(device):
    scene = pyramid_scene(clips=(PLANE,))
    with Renderer(scene, [device]) as renderer:
        first = renderer.render()
        renderer.set_transfer_function(SHELL)
        shell = renderer.render()
        renderer.set_transfer_function(BLANK)
        assert not renderer.render().rgba.any()
        renderer.set_transfer_function(SMOOTH)
        again = renderer.render()
    np.testing.assert_array_equal(first.rgba, again.rgba)
    with Renderer(pyramid_scene(function=SHELL, clips=(PLANE,)), [device]) as renderer:
        np.testing.assert_array_equal(renderer.render().rgba, shell.rgba)
    assert rms(first.rgba, shell.rgba) > 0.01


def test_what_a_blank_scene_asks_for_is_refused_once_it_shows(device):
    with Renderer(pyramid_scene(function=BLANK, clips=(SPHERE,)), [device]) as renderer:
        assert not renderer.render().rgba.any()
        with pytest.raises(SceneError, match="clip"):
            renderer.set_transfer_function(SMOOTH)
        assert not renderer.render().rgba.any()
