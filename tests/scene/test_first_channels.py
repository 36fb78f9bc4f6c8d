"""What is chosen for the channels of a file that shows several, and for what [[channel]] leaves out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.effect_scenes import blobs

from clvol import Scene, load_scene
from clvol.errors import ClvolWarning, SeveralChannels
from clvol.readers import load_volume
from clvol.scene.channel import ChannelSettings, default_color

SHAPE = (9, 12, 15)


def stained(seed: int, top: float) -> np.ndarray:
    """uint16 [z, y, x]: blobs over a noisy background of 100."""
    noise = np.random.default_rng(seed).normal(0.0, 3.0, SHAPE)
    return np.round(100.0 + top * blobs(SHAPE, seed) ** 2 + noise).clip(0).astype(np.uint16)


ARRAYS = np.stack([stained(3, 2000.0), stained(8, 700.0)])


@pytest.fixture
def tiff(tmp_path) -> Path:
    import tifffile

    path = tmp_path / "cells.ome.tif"
    channel = {"Name": ["DAPI", "actin"], "Color": [0x0000FFFF, -1]}
    tifffile.imwrite(path, np.moveaxis(ARRAYS, 0, 1), metadata={"axes": "ZCYX", "Channel": channel},
                     photometric="minisblack")  # fmt: skip
    return path


def test_a_file_of_several_channels_shows_all_of_them(tiff):
    scene = load_scene_of(tiff)
    resolved = scene.resolve()
    assert len(resolved.channels) == 2 and resolved.integration.blend == "additive"
    for channel, array in zip(resolved.channels, ARRAYS):
        assert np.array_equal(channel.volume.data, array)
    chosen = resolved.chosen
    assert [each["channel"] for each in chosen["channels"]] == ["DAPI", "actin"]
    assert "2 channels (DAPI #0000ff" in chosen["in_words"]  # as the file says
    assert chosen["channels"][1]["color"] == list(default_color(1, 2))


def load_scene_of(path: Path) -> Scene:
    return Scene(volume=path)


def test_ranges_leave_out_the_background_and_reach_what_is_bright(tiff):
    ranges = [settings.range for settings in load_scene_of(tiff).completed().channel]
    for (low, high), top in zip(ranges, (2000.0, 700.0)):
        assert 100.0 < low < 100.0 + 0.25 * top and 100.0 + 0.5 * top < high <= 110.0 + top


def test_what_was_chosen_is_a_scene_file(tiff, tmp_path):
    completed = load_scene_of(tiff).completed()
    path = tmp_path / "scene.toml"
    path.write_text(completed.to_toml())
    again = load_scene(path)
    assert again.channel == completed.channel and again.completed() is again
    one, other = again.resolve(), completed.resolve()
    assert all(a.function == b.function for a, b in zip(one.channels, other.channels))


def test_a_scene_that_states_a_function_still_has_to_choose(tiff):
    with pytest.raises(SeveralChannels, match='2 channels: 0 "DAPI", 1 "actin"'):
        Scene(volume=tiff, transfer_function={"preset": "hot"}).resolve()
    with pytest.raises(SeveralChannels):
        load_volume(tiff)
    with pytest.raises(SeveralChannels):
        Scene(volume=tiff, isosurface=[{"value": 500.0}]).resolve()


def test_what_a_channel_states_is_kept(tiff):
    stated = {"channel": "actin", "color": "red", "gamma": 0.5}
    first, second = Scene(volume=tiff, channel=[stated, {"channel": 0, "opacity": 0.25}]).completed().channel
    assert (first.color, first.gamma, second.opacity) == ((1.0, 0.0, 0.0), 0.5, 0.25)
    assert first.range and first.opacity and second.range and second.color == (0.0, 1.0, 0.0)


def test_projections_show_full_colours(tiff):
    scene = Scene(volume=tiff, integration={"compositing": "maximum"}).completed()
    assert [settings.opacity for settings in scene.channel] == [1.0, 1.0]


def test_omero_says_colours_and_windows(tmp_path):
    tensorstore = pytest.importorskip("tensorstore")
    folder = tmp_path / "cells.zarr"
    spec = {"driver": "zarr", "kvstore": {"driver": "file", "path": str(folder / "0")}}
    tensorstore.open(spec, create=True, dtype="uint16", shape=ARRAYS.shape).result()[:] = ARRAYS
    axes = [{"name": "c", "type": "channel"}, *({"name": n, "type": "space"} for n in "zyx")]
    transformation = {"type": "scale", "scale": [1.0, 2.0, 0.5, 0.5]}
    multiscales = [{"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": [transformation]}]}]
    channels = [{"label": "N", "color": "00FF80", "window": {"start": 120, "end": 900}}, {"color": "nonsense"}]
    (folder / ".zgroup").write_text('{"zarr_format": 2}')
    (folder / ".zattrs").write_text(json.dumps({"multiscales": multiscales, "omero": {"channels": channels}}))
    first, second = Scene(volume=folder).completed().channel
    assert first.range == (120.0, 900.0) and first.color == pytest.approx((0.0, 1.0, 0.502), abs=1e-3)
    assert second.color == default_color(1, 2) and second.range is not None


def test_more_channels_than_are_shown_are_said(tmp_path):
    import tifffile

    path = tmp_path / "many.tif"
    many = np.repeat(ARRAYS[:1], 8, axis=0)
    tifffile.imwrite(path, np.moveaxis(many, 0, 1), imagej=True, metadata={"axes": "ZCYX"})
    with pytest.warns(ClvolWarning, match="8 channels, of which the first 6 are shown"):
        assert len(Scene(volume=path).completed().channel) == 6


def test_a_constant_channel_has_a_range():
    from clvol import Volume

    flat = Volume(np.full(SHAPE, 7, np.uint8))
    scene = Scene(volume=Volume(ARRAYS[0]), channel=[{}, {"file": flat}]).completed()
    low, high = scene.channel[1].range
    assert low < high and isinstance(scene.channel[1], ChannelSettings)
