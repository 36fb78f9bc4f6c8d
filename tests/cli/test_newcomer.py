"""The first hour with clvol: a volume, its scene, one key changed, the same from Python, and a preset out and in."""

from __future__ import annotations

import numpy as np
import pytest
import SimpleITK
import xarray
from helpers.first_volumes import solid

import clvol
from clvol.opencl.devices import report_of

SMALL = ("--set", "image.width=24", "--set", "image.height=20")


@pytest.mark.slow  # half a minute of a processor: two programs and six pictures; other tests touch every step
def test_the_path_of_a_newcomer(run, folder, device):
    where = ("--device", report_of(device).name)
    voxels = np.ascontiguousarray(solid().data)
    image = SimpleITK.GetImageFromArray(voxels)
    image.SetSpacing((1.0, 1.0, 2.0))
    SimpleITK.WriteImage(image, "ball.nrrd")

    # A picture, its scene, and the scene with a key changed.
    assert run("render", "ball.nrrd", "-o", "a.npy", *SMALL, *where).status == 0
    assert run("init", "ball.nrrd", "-o", "s.toml", *SMALL).status == 0
    assert run("render", "s.toml", "-o", "b.npy", *where).status == 0
    assert np.array_equal(np.load("a.npy"), np.load("b.npy"))
    text = (folder / "s.toml").read_text(encoding="utf-8")
    assert "\nbackground = " in text
    (folder / "s.toml").write_text(text.replace("\nbackground = ", "\n# background = "), encoding="utf-8")
    assert run("render", "s.toml", "-o", "c.npy", *where).status == 0

    # The same from Python: SimpleITK's image is the file, xarray's array has the same spacing.
    size = {"width": 24, "height": 20}
    from_image = clvol.render(image, image=size, devices=[device]).rgba
    assert np.array_equal(from_image, np.load("a.npy"))
    coords = {name: step * np.arange(n) for name, step, n in zip("zyx", (2.0, 1.0, 1.0), voxels.shape)}
    array = xarray.DataArray(voxels, dims=("z", "y", "x"), coords=coords)
    camera, function = {"projection": "orthographic"}, clvol.TransferFunction.from_colormap("viridis", (0, 255))
    keys = {"image": size, "camera": camera, "devices": [device]}
    by_array = clvol.render(array.transpose("x", "y", "z"), transfer_function=function, **keys).rgba
    assert np.array_equal(by_array, clvol.render(image, transfer_function=function, **keys).rgba)
    assert by_array[..., 3].max() > 0.1

    # A preset of ParaView out and in gives the same picture.
    function.save("preset.json", "ball")
    scene = '[volume]\nfile = "ball.nrrd"\n[transfer_function]\nfile = "preset.json"\n[camera]\n'
    (folder / "p.toml").write_text(scene + 'projection = "orthographic"\n', encoding="utf-8")
    again = clvol.render("p.toml", image=size, devices=[device]).rgba
    assert np.abs(again - by_array).max() < 1e-5
