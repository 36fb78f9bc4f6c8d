"""Colour maps of matplotlib, colorcet and cmap by name."""

from __future__ import annotations

import importlib.util

import matplotlib
import numpy as np
import pytest

from clvol.errors import SceneError
from clvol.scene import load_scene
from clvol.transfer import TransferFunction, linear_to_srgb
from clvol.transfer.exchange.colormaps import EXTRA

AT = np.linspace(0.0, 1.0, 256)


def test_a_map_of_matplotlib_is_laid_over_a_range():
    function = TransferFunction.from_colormap("magma", (-100, 155), opacity=[0, 0.1, 0.5])
    wanted = matplotlib.colormaps["magma"](AT)[:, :3]
    assert np.abs(linear_to_srgb(function.color(-100 + 255 * AT)) - wanted).max() < 1 / 255
    assert function.opacity([-100, 27.5, 155]).tolist() == pytest.approx([0, 0.1, 0.5])
    assert len(function.values) < 100


@pytest.mark.parametrize("name", ["colorcet:fire", "cet_fire", "cmap:crameri:batlow", "crameri:batlow", "viridis_r"])
def test_maps_of_other_packages_are_found_by_name(name):
    import cmap
    import colorcet

    function = TransferFunction.from_colormap(name, (0, 1))
    if "fire" in name:
        first, last = colorcet.fire[0], colorcet.fire[-1]
    elif "batlow" in name:
        first, last = (cmap.Colormap("crameri:batlow")(end).hex for end in (0.0, 1.0))
    else:
        first, last = (matplotlib.colors.to_hex(matplotlib.colormaps[name](end)) for end in (0.0, 1.0))
    ends = TransferFunction([0, 1], [0, 1], [first, last])
    assert np.abs(function.color([0, 1]) - ends.colors).max() < 0.01


def test_objects_of_the_packages_are_taken():
    import cmap

    by_name = TransferFunction.from_colormap("plasma", (0, 1))
    assert TransferFunction.from_colormap(matplotlib.colormaps["plasma"], (0, 1)) == by_name
    other = TransferFunction.from_colormap(cmap.Colormap("plasma"), (0, 1))
    assert np.abs(linear_to_srgb(other.color(AT)) - linear_to_srgb(by_name.color(AT))).max() < 2 / 255


def test_a_map_of_few_colours_is_steps():
    function = TransferFunction.from_colormap("tab10", (0, 10))
    colors = np.array(matplotlib.colormaps["tab10"].colors)
    assert np.abs(linear_to_srgb(function.color(np.arange(10) + 0.3)) - colors).max() < 1e-12
    assert len(function.values) == 20


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("virdis", "did you mean 'viridis'"),
        ("colorcet:nothing", "got 'colorcet:nothing', no colour map"),
        (3, "got int, expected the name of a colour map"),
        (lambda at: at, "no colours from 0 to 1"),
        (lambda at: np.full((len(at), 3), 2.0), "no colours from 0 to 1"),
        (lambda at: 1 / 0, "no colours from 0 to 1"),
    ],
)
def test_what_is_no_map_is_refused(given, message):
    with pytest.raises(SceneError, match=message):
        TransferFunction.from_colormap(given, (0, 1))


@pytest.mark.parametrize("value_range", [(1, 1), (2, 1), (0, np.inf), (0,), "ab"])
def test_impossible_ranges_are_refused(value_range):
    with pytest.raises(SceneError, match="range"):
        TransferFunction.from_colormap("viridis", value_range)


@pytest.mark.parametrize(
    "opacity", [[], [2], [[0, 0], [2, 1]], [[0.5, 0], [0.2, 1]], ["a"], [[0, 0, 0]], [0.1, [0, 1]]]
)
def test_impossible_curves_are_refused(opacity):
    with pytest.raises(SceneError, match="opacity curve"):
        TransferFunction.from_colormap("viridis", (0, 1), opacity)


def test_a_missing_package_names_its_extra(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name in ("cmap", "colorcet") else find(name))
    with pytest.raises(SceneError, match=rf"colorcet is not installed, expected pip install clvol\[{EXTRA}\]"):
        TransferFunction.from_colormap("colorcet:fire", (0, 1))
    with pytest.raises(SceneError, match=rf"no colour map, expected .*clvol\[{EXTRA}\]"):
        TransferFunction.from_colormap("crameri:batlow", (0, 1))


def scene(tmp_path, table: str):
    path = tmp_path / "scene.toml"
    path.write_text(f'[volume]\nfield = "radial"\nsize = [5, 5, 5]\n[transfer_function]\n{table}\n', encoding="utf-8")
    return load_scene(path)


def test_a_scene_names_a_map_a_range_and_a_curve(tmp_path):
    function = scene(tmp_path, 'colormap = "viridis"\nrange = [10, 20]\nopacity = [0, [1, 0.5]]').transfer_function
    with pytest.raises(SceneError, match="opacity curve"):
        function.function((0.0, 255.0), 1.0)
    loaded = scene(tmp_path, 'colormap = "viridis"\nopacity = [0.0, 0.25]')
    resolved = loaded.resolve()
    low, high = resolved.volume.value_range
    assert resolved.transfer_function.values[[0, -1]].tolist() == [low, high]
    assert resolved.transfer_function.opacity(high) == 0.25
    assert resolved.transfer_function.opacity_unit == 4 / 32
    assert 'colormap = "viridis"' in loaded.to_toml()


def test_a_scene_names_a_file_beside_it(tmp_path):
    TransferFunction([3, 9], [0, 1], ["red", "blue"], 7.0).save(tmp_path / "p.json")
    loaded = scene(tmp_path, 'file = "p.json"')
    function = loaded.resolve().transfer_function
    assert (function.values[0], function.values[-1], function.opacity_unit) == (3, 9, 7)
    assert tmp_path / "p.json" in loaded.input_paths
    own = scene(tmp_path, 'file = "p.json"\nopacity_unit = 2.0\nrange = [0, 1]').resolve().transfer_function
    assert (own.values[-1], own.opacity_unit) == (1, 2)
    with pytest.raises(SceneError, match=r"transfer_function.file: got 'q.json', no such file, expected .json"):
        scene(tmp_path, 'file = "q.json"').resolve()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('colormap = "viridis"\npreset = "hot"', "either preset or colormap, not both"),
        ('preset = "hot"\nrange = [0, 1]', "range beside colormap or file"),
        ('colormap = "viridis"\nentry = "a"', "entry beside file"),
        ('colormap = "viridis"\nrange = [1, 0]', "ascending"),
        ('colormap = "viridis"\nopacity = [2.0]', "opacity.0: got 2.0"),
        ('colormap = "viridis"\nopacity = []', "opacity"),
        ('colormap = ""', "colormap"),
        ('file = "a\\u0000b"', "file"),
    ],
)
def test_contradictions_are_refused(tmp_path, table, message):
    with pytest.raises(SceneError, match=message):
        scene(tmp_path, table)
