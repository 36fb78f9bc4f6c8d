"""Wrong settings of effects: one line that names the key, status 2, no file."""

from __future__ import annotations

import numpy as np
import pytest

GOOD = """\
version = 1
[volume]
file = "cube.npy"
[image]
width = 8
height = 6
"""
LIGHT = '[[light]]\ntype = "headlight"\n'
POINTS = "points = [{ value = 0.0, opacity = 0.1, color = [1, 1, 1] }]\n"
# (lines of the scene, what the error says)
WRONG = {
    "a light without direction": (
        '[[light]]\ntype = "directional"\n', "light.0.direction: missing, expected"),
    "a light of no direction": (
        '[[light]]\ntype = "directional"\ndirection = [0, 0, 0]\n', "light.0.direction: got"),
    "a light of unknown type": ('[[light]]\ntype = "lamp"\n', "light.0.type: got 'lamp', expected"),
    "no environment": (
        '[environment]\nfile = "sky.exr"\n', "environment.file: got 'sky.exr'"),
    "an environment that is no EXR": ('[environment]\nfile = "not.exr"\n', "not.exr"),
    "an environment of another format": ('[environment]\nfile = "cube.npy"\n', "environment.file"),
    "an environment of a wrong shape": ('[environment]\nfile = "wide.exr"\n', "wide.exr"),
    "a cube of a wrong shape": (
        '[environment]\nfile = "wide.exr"\nlayout = "cube"\n', "wide.exr"),
    "an iso-value that is no number": ("[[isosurface]]\nvalue = nan\n", "isosurface.0.value: got"),
    "a refraction of 0": (
        "[[isosurface]]\nvalue = 30\nrefraction = 0\n", "isosurface.0.refraction"),
    "no label field": (
        '[[field]]\nfile = "labels.npy"\nrole = "label"\n'
        "labels = [{ label = 1, color = [1, 0, 0] }]\n", "labels.npy"),
    "an unknown role": (
        '[[field]]\nfile = "cube.npy"\nrole = "veil"\n', "field.0.role: got 'veil'"),
    "four fields": (4 * '[[field]]\nfile = "cube.npy"\nrole = "mask"\n', "field: "),
    "a shadow of no points": (
        LIGHT + "[shadow]\nresolution = 0\n", "shadow.resolution: got 0, expected"),
    "scattering without a volume": (
        LIGHT + '[shadow]\nmethod = "rays"\nscattering = 0.5\n', "shadow"),
    "layers that descend": (
        "".join(f"[[transfer_layer]]\nmagnitude = {m}\n{POINTS}" for m in (5.0, 2.0)),
        "transfer_layer.1.magnitude: got 2"),
    "magnitudes that descend": (
        "[gradient_opacity]\npoints = [{ magnitude = 3, opacity = 0 }, "
        "{ magnitude = 1, opacity = 1 }]\n", "gradient_opacity.points"),
    "99 octaves": (
        '[[noise]]\ntarget = "value"\namplitude = 1\noctaves = 99\n',
        "noise.0.octaves: got 99, expected"),
    "a box upside down": (
        '[[clip]]\ntype = "box"\nlower = [2, 0, 0]\nupper = [1, 3, 3]\n', "clip.0.upper.0: got 1"),
    "a sphere without radius": (
        '[[clip]]\ntype = "sphere"\ncenter = [1, 1, 1]\n', "clip.0.radius: missing, expected"),
    "an unknown compositing": (
        '[integration]\ncompositing = "sum"\n', "integration.compositing: got 'sum', expected"),
    "a prefilter of the linear filter": (
        "[integration]\nprefilter = true\n", "integration.prefilter: got true, expected"),
    "cells that are lit": (
        LIGHT + '[integration]\nquadrature = "cells"\n', "integration.quadrature: got 'cells'"),
    "a reference that is lit": (
        LIGHT + '[integration]\nmethod = "reference"\n', "integration.method: got 'reference'"),
    "a cue that ends before it starts": ("[depth_cue]\nstart = 5\nend = 2\n", "depth_cue"),
    "a cue of unknown keys": ("[depth_cue]\nstrenght = 1\n", "depth_cue.strenght"),
    "no frames": ("[animation]\nframes = 0\n", "animation.frames: got 0, expected"),
}  # fmt: skip


@pytest.fixture
def scene(folder):
    """``scene(lines)``: a scene file with these beside what it needs."""
    import OpenEXR

    (folder / "not.exr").write_bytes(b"no picture")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    picture = OpenEXR.File(header, {"RGB": np.ones((4, 5, 3), np.float32)})
    picture.write(str(folder / "wide.exr"))

    def written(lines: str) -> str:
        (folder / "wrong.toml").write_text(GOOD + lines, encoding="utf-8")
        return "wrong.toml"

    return written


def _files(folder) -> dict:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_setting_is_one_line(refused, folder, scene, name):
    lines, said = WRONG[name]
    path = scene(lines)
    before = _files(folder)
    told = [
        refused(2, "explain", path),
        refused(2, "explain", path, "--json"),
        refused(2, "render", path, "-o", "out.exr", "-o", "out.png", "--stats", "out.json"),
    ]
    assert len(set(told)) == 1
    assert said in told[0] and "expected" in told[0] and len(told[0]) < 300
    assert _files(folder) == before
