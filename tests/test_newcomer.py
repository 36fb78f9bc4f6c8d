"""A newcomer's path: each volume at first sight, a scene made of it and changed, the same from Python, and a transfer
function to and from another tool."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import DATA

import clvol
from clvol.cli import main
from clvol.image import load_image

SHARED = Path(__file__).resolve().parents[2] / "shared" / "volumes"
BRAIN = DATA / "brainsmall.nrrd"
SMALL = ["--set", "image.width=96", "--set", "image.height=80", "--quiet"]
VOLUMES = sorted(p for p in SHARED.iterdir() if p.name != "README.md") if SHARED.is_dir() else []


def shown(path: Path) -> np.ndarray:
    """bool [height, width]: pixels with something in front of the background."""
    picture = load_image(path)
    return np.abs(picture["rgba"][..., :3] - picture["background"]).max(axis=-1) > 0.02


def seen_at_first_sight(volume: Path, folder: Path) -> None:
    assert main(["render", str(volume), "-o", str(folder / "first.png"), *SMALL]) == 0
    something = shown(folder / "first.png")
    assert 0.02 < something.mean() < 0.98
    edge = np.concatenate([something[0], something[-1], something[:, 0], something[:, -1]])
    assert edge.mean() < 0.25  # the object is in view as a whole
    rgba = load_image(folder / "first.png")["rgba"][something]
    assert rgba[:, :3].std() > 0.02  # and is no flat silhouette


def test_the_volume_that_comes_with_it(tmp_path):
    seen_at_first_sight(BRAIN, tmp_path)


@pytest.mark.slow  # volumes of up to 27 million voxels
@pytest.mark.skipif(not VOLUMES, reason=f"{SHARED} is not there")
@pytest.mark.parametrize("volume", VOLUMES, ids=lambda path: path.name)
def test_each_volume_shows_its_object(tmp_path, volume):
    seen_at_first_sight(volume, tmp_path)


def test_a_scene_is_made_changed_and_rendered_again(tmp_path, capfd):
    scene = tmp_path / "brain.toml"
    assert main(["init", str(BRAIN), "-o", str(scene)]) == 0
    assert main(["render", str(BRAIN), "-o", str(tmp_path / "a.npy"), *SMALL]) == 0
    assert main(["render", str(scene), "-o", str(tmp_path / "b.npy"), *SMALL]) == 0
    first, again = np.load(tmp_path / "a.npy"), np.load(tmp_path / "b.npy")
    np.testing.assert_allclose(again, first, atol=1e-3)  # the scene says what was chosen
    text = scene.read_text(encoding="utf-8")
    assert "fov_degrees = 30.0" in text
    scene.write_text(text.replace("fov_degrees = 30.0", "fov_degrees = 15.0"), encoding="utf-8")
    assert main(["render", str(scene), "-o", str(tmp_path / "c.npy"), *SMALL]) == 0
    assert np.abs(np.load(tmp_path / "c.npy") - again).max() > 0.1
    capfd.readouterr()
    assert main(["explain", str(scene)]) == 0 and "yes  emission-absorption" in capfd.readouterr().out


@pytest.fixture(scope="module")
def brain():
    return clvol.load_volume(BRAIN)


# As the volume is seen from the left; what is chosen unasked depends on what an object says of its axes.
TABLES = {
    "image": {"width": 96, "height": 80},
    "camera": {"position": [-200.0, 63.0, 41.0], "target": [63.0, 63.0, 41.0], "up": [0.0, -1.0, 0.0]},
    "transfer_function": {"preset": "mr-brain"},
}


def test_the_same_from_python_with_xarray_and_simpleitk(brain):
    import SimpleITK
    import xarray

    voxels, spacing = np.asarray(brain.data), brain.grid.spacing
    expected = clvol.render(clvol.Volume(voxels, spacing=spacing), **TABLES).rgba
    assert (expected[..., 3] > 0.1).mean() > 0.05
    z, y, x = (np.arange(n) * step for n, step in zip(voxels.shape, spacing[::-1]))
    labelled = xarray.DataArray(voxels, dims=("z", "y", "x"), coords={"z": z, "y": y, "x": x})
    turned = labelled.transpose("x", "z", "y")  # dims say which axis is which
    image = SimpleITK.GetImageFromArray(voxels)
    image.SetSpacing([float(s) for s in spacing])
    for given in (labelled, turned, image):
        frame = clvol.render(given, **TABLES)
        np.testing.assert_array_equal(frame.rgba, expected)
    assert frame.image().size == (96, 80) and frame._repr_png_().startswith(b"\x89PNG")


def test_a_transfer_function_goes_to_paraview_and_back(tmp_path, capfd):
    """The picture by the imported preset is the picture by the function itself."""
    function = clvol.TransferFunction([20, 90, 160], [0.0, 0.1, 0.8], [[0.1, 0.1, 0.4], [0.9, 0.5, 0.2], [1, 1, 0.9]])
    preset = tmp_path / "preset.json"
    function.save(preset)
    data = json.loads(preset.read_text(encoding="utf-8"))
    assert isinstance(data, list) and {"RGBPoints", "Points"} <= set(data[0])  # as ParaView writes presets
    again = clvol.TransferFunction.from_file(preset)
    for s in np.linspace(0, 255, 52):
        assert again.opacity(s) == pytest.approx(function.opacity(s), abs=1e-6)
        np.testing.assert_allclose(again.color(s), function.color(s), atol=1e-3)
    scene = tmp_path / "scene.toml"
    scene.write_text(
        f'version = 1\n[volume]\nfile = "{BRAIN}"\n[transfer_function]\nfile = "preset.json"\n', encoding="utf-8"
    )
    assert main(["render", str(scene), "-o", str(tmp_path / "a.png"), *SMALL]) == 0
    assert shown(tmp_path / "a.png").mean() > 0.02
    assert main(["transfer", str(preset), "-o", str(tmp_path / "slicer.vp")]) == 0
    assert (tmp_path / "slicer.vp").stat().st_size > 0
