"""``Renderer.set_environment``: another environment between frames, without compiling."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import LIGHTS, blobs, oblique, scene

import clvol
from clvol import Renderer
from clvol.errors import SceneError, UsageError
from clvol.opencl import context

SHAPE = (15, 17, 19)


@pytest.fixture(scope="module")
def skies(tmp_path_factory):
    """Two files: all red, and green above."""
    import OpenEXR

    folder = tmp_path_factory.mktemp("skies")
    red, green = np.zeros((8, 16, 3), np.float32), np.zeros((8, 16, 3), np.float32)
    red[..., 0], green[:4, :, 1] = 1.0, 1.0
    for name, rgb in (("red", red), ("green", green)):
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": rgb}).write(str(folder / f"{name}.exr"))
    return folder


def lit_by(environment):
    tables = {"environment": environment} if environment else {}
    return scene(blobs(SHAPE), camera=oblique(SHAPE), light=LIGHTS, gradient={"storage": "on-the-fly"}, **tables)


def test_another_environment_compiles_nothing_and_is_what_a_scene_with_it_is(device, skies, monkeypatch):
    red, green = ({"file": str(skies / f"{name}.exr")} for name in ("red", "green"))
    turned = {**green, "layout": "latlong", "rotation_degrees": 70.0, "intensity": 2.0}
    with Renderer(lit_by(red), devices=[device]) as renderer:
        first = renderer.render().rgba
        built, of_file = [], context.build_file
        monkeypatch.setattr(context, "build_file", lambda *a: built.append(a[1]) or of_file(*a))
        for environment in (green, clvol.Environment(**turned), red):
            renderer.set_environment(environment)
            frame = renderer.render()
            tables = environment if isinstance(environment, dict) else turned
            renderer.set_scene(lit_by(tables))
            np.testing.assert_array_equal(frame.rgba, renderer.render().rgba)
            renderer.set_scene(lit_by(red))
        assert not built
        np.testing.assert_array_equal(frame.rgba, first)  # red, as at first
        assert np.abs(renderer.render().rgba - first).max() == 0.0
        renderer.set_environment(green)
        assert np.abs(renderer.render().rgba - first).max() > 0.05


def test_what_is_no_environment_is_refused_and_changes_nothing(device, skies):
    with Renderer(lit_by({"file": str(skies / "red.exr")}), devices=[device]) as renderer:
        first = renderer.render().rgba
        with pytest.raises(SceneError, match="no such file"):
            renderer.set_environment({"file": str(skies / "blue.exr")})
        with pytest.raises(SceneError, match="environment.layout"):
            renderer.set_environment({"file": str(skies / "red.exr"), "layout": "spiral"})
        with pytest.raises(SceneError, match="a square around a mirror ball"):
            renderer.set_environment({"file": str(skies / "red.exr"), "layout": "sphere"})
        with pytest.raises(UsageError, match="set_environment.*a str"):
            renderer.set_environment(str(skies / "red.exr"))
        np.testing.assert_array_equal(renderer.render().rgba, first)
        renderer.set_environment(None)  # compiles: what is lit by an environment is another program
        assert np.abs(renderer.render().rgba - first).max() > 0.05
