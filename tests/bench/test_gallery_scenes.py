"""The gallery: every scene of it is on the sheet, is explained, and shows something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_scenes import picture

from bench.gallery import SCENES, TILE, TILES, compose, shrunk
from clvol.explanation import explain
from clvol.features import reduced
from clvol.render.picture_warnings import picture_warning

WIDTH, HEIGHT = 32, 24


def _resolved(tile):
    """The tile's scene; a skip with the reason where a volume of it is not there."""
    missing = tile.missing()
    if missing:
        pytest.skip(f"{missing[0].name} is not in {missing[0].parent.resolve()}")
    return tile.load(WIDTH, HEIGHT).resolve()


def test_every_scene_file_has_a_tile_and_every_tile_a_scene_file():
    shown = {tile.path.resolve() for tile in TILES}
    assert {path.resolve() for path in SCENES.glob("*.toml")} <= shown
    assert all(path.exists() for path in shown)


def test_captions_are_complete():
    for tile in TILES:
        assert all((tile.title, tile.caption, tile.effect, tile.asked)), tile.name
        assert tile.caption.endswith("."), tile.name
    assert len({tile.title for tile in TILES}) == len({tile.name for tile in TILES}) == len(TILES)


def test_a_scene_without_its_volume_is_said_to_miss_it(tmp_path, monkeypatch):
    (tmp_path / "one.toml").write_text('version = 1\n[volume]\nfile = "nowhere.nrrd"\n')
    monkeypatch.setattr("bench.gallery.SCENES", tmp_path)
    tile = replace(TILES[0], scene="one")
    assert tile.missing() == [tmp_path / "nowhere.nrrd"]


@pytest.mark.parametrize("tile", TILES, ids=lambda tile: tile.name)
def test_a_tile_calls_for_its_effect_and_says_so(tile):
    told = {effect["name"]: effect for effect in explain(_resolved(tile))["effects"]}
    assert told[tile.effect]["called_for"] and told[tile.effect]["reason"]


@pytest.mark.parametrize("tile", TILES, ids=lambda tile: tile.name)
def test_nothing_is_to_warn_of_in_a_tile(tile):
    assert explain(_resolved(tile))["warnings"] == []


@pytest.mark.parametrize("tile", TILES, ids=lambda tile: tile.name)
def test_a_tile_renders_a_picture_that_is_not_blank(context, tile):
    scene = _resolved(tile)
    data = picture(context, reduced(scene))
    rgba = data.rgba
    assert picture_warning(scene, scene.camera, rgba, data.depth) is None
    assert rgba.shape == (HEIGHT, WIDTH, 4)
    assert np.isfinite(rgba).all()
    assert rgba[..., 3].max() > 0.5
    assert rgba[..., :3].mean(axis=-1).std() > 0.02
    assert (rgba[..., :3].mean(axis=-1) > 0.02).mean() > 0.1


def test_tiles_shrink_to_their_means_with_white_cut_off():
    rgba = np.zeros((4, 6, 4), np.float32)
    rgba[:2, :2] = [9.0, 1.0, 0.5, 1.0]
    small = shrunk(rgba, (3, 2))
    assert small.shape == (2, 3, 4)
    assert small[0, 0] == pytest.approx([1.0, 1.0, 0.5, 1.0])
    assert not small[1:].any() and not small[0, 1:].any()


def test_the_sheet_holds_every_picture(tmp_path):
    from PIL import Image

    colors = [(200, 40, 40), (40, 200, 40), (40, 40, 200), (200, 200, 40), (40, 200, 200)]
    pictures = []
    for tile, color in zip(TILES, colors):
        path = tmp_path / f"{tile.name}.png"
        Image.new("RGB", TILE, color).save(path)
        pictures.append((tile, str(path)))
    compose(pictures, tmp_path / "sheet.png")
    with Image.open(tmp_path / "sheet.png") as image:
        counts = {color: n for n, color in image.convert("RGB").getcolors(1 << 16)}
    assert all(counts.get(color) == TILE[0] * TILE[1] for color in colors)
