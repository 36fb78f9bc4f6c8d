"""Codes that stay on the device: the picture of decoded voxels, bit for bit, in less memory."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.coarse_codes import CoarseTrainer
from helpers.small_scenes import SMOOTH, waves

from clvol import Renderer, Scene, TransferFunction, Volume, load_volume
from clvol.encoding.trainer import CodeTrainer
from clvol.errors import SceneError
from clvol.integrators import decoding
from clvol.opencl.devices import open_device
from clvol.store.build import build_store
from clvol.store.codecs.coded_blocks import RateTarget

VOLUME = Volume(waves((40, 34, 51), np.uint8))
HEADLIGHT = [{"type": "headlight"}]
SCENES = {
    "plain": {},
    "nearest, pre": {"integration": {"filter": "nearest", "classification": "pre"}},
    "cells": {"integration": {"quadrature": "cells"}},
    "b-spline": {"integration": {"filter": "cubic", "prefilter": False}},
    "lit": {"light": HEADLIGHT, "isosurface": [{"value": 100.0, "opacity": 0.5}]},
    "shadow rays": {"light": [{"type": "directional", "direction": [-1.0, -1.0, -1.0]}], "shadow": {"method": "rays"}},
    "light volume": {
        "light": [{"type": "directional", "direction": [-1.0, -1.0, -1.0]}],
        "shadow": {"method": "volume", "resolution": 8},
        "gradient_opacity": {"points": [{"magnitude": 0.0, "opacity": 0.2}, {"magnitude": 60.0, "opacity": 1.0}]},
    },
    "noise": {"noise": [{"target": "coordinate", "amplitude": 3.0}]},
    "maximum": {"integration": {"compositing": "maximum"}},
    "sparse": {"image": {"width": 30, "height": 26, "ray_spacing": 4}},
    "clipped": {"clip": [{"type": "sphere", "center": [20, 17, 20], "radius": 14.0}]},
    "pyramid": {"integration": {"method": "pyramid"}},
    "pyramid, clipped": {
        "integration": {"method": "pyramid", "filter": "cubic", "prefilter": False},
        "clip": [{"point": [25, 17, 20], "normal": [1, 0.5, 0]}],
    },
}  # fmt: skip


@pytest.fixture(autouse=True)
def trained(monkeypatch):
    trainer = CoarseTrainer()
    monkeypatch.setattr(decoding, "trainer", lambda context: trainer)


def scene_of(volume=VOLUME, decode="resident", memory=None, **tables) -> Scene:
    compression = {"codec": "rvq", "decode": decode} | ({} if memory is None else {"memory": memory})
    tables = {"image": {"width": 30, "height": 26}, "transfer_function": SMOOTH, **tables}
    return Scene(volume=volume, compression=compression, **tables)


def frame_of(device, **how):
    with Renderer(scene_of(**how), [device]) as renderer:
        return renderer.render()


@pytest.mark.parametrize("name", SCENES)
def test_the_picture_is_that_of_decoded_voxels(device, name):
    frame, other = (frame_of(device, decode=decode, **SCENES[name]) for decode in ("resident", "upload"))
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    np.testing.assert_array_equal(frame.depth, other.depth)
    assert np.ptp(frame.rgba[..., 3]) > 0.01


@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_other_types_on_every_device(each_device, dtype):
    volume = Volume(waves((40, 34, 51), dtype))
    frame, other = (frame_of(each_device, volume=volume, decode=decode) for decode in ("resident", "upload"))
    np.testing.assert_array_equal(frame.rgba, other.rgba)


def test_less_is_held_and_only_what_is_needed_is_decoded(device):
    array = np.random.default_rng(4).integers(0, 100, (128, 128, 128)).astype(np.uint8)
    array[8:20, 8:20, 8:20] = 250
    shell = TransferFunction([0.0, 200.0, 210.0], [0.0, 0.0, 0.5], [[1.0, 0.5, 0.2]] * 3)
    tables = {"transfer_function": shell, "image": {"width": 64, "height": 64}}
    with Renderer(scene_of(Volume(array), **tables), [device]) as renderer:
        first, second = renderer.render(), renderer.render()
    upload = frame_of(device, volume=Volume(array), decode="upload", **tables)
    np.testing.assert_array_equal(first.rgba, upload.rgba)
    held, whole = first.stats["compression"], upload.stats["compression"]
    assert 0 < held["decoded_voxels"] <= 64 * 16**3 < whole["decoded_voxels"] == 128**3
    assert second.stats["compression"]["decoded_voxels"] == 0
    assert held["device_bytes"] < 0.5 * whole["device_bytes"]


def test_a_small_pool_gives_the_same_picture_or_says_what_it_needs(device):
    array = np.random.default_rng(4).integers(0, 256, (60, 70, 80)).astype(np.uint8)
    tables = {"image": {"width": 200, "height": 160}}
    upload = frame_of(device, volume=Volume(array), decode="upload", **tables)
    small = frame_of(device, volume=Volume(array), memory="1200 KiB", **tables)
    np.testing.assert_array_equal(small.rgba, upload.rgba)
    assert small.stats["compression"]["decoded_voxels"] > array.size  # some of it twice
    with pytest.raises(SceneError, match=r"compression.memory: .* decoded blocks can be held .* at least \d+ bytes"):
        frame_of(device, volume=Volume(array), memory="300 KiB", **tables)
    with pytest.raises(SceneError, match=r"compression.memory: got 1024 bytes, expected at least \d+ bytes"):
        frame_of(device, volume=Volume(array), memory=1024, **tables)


def test_slices_through_a_small_pool_give_the_same_picture(each_device):
    array = waves((60, 70, 80), np.uint8) // 2 + np.random.default_rng(4).integers(0, 120, (60, 70, 80), np.uint8)
    tables = {"image": {"width": 200, "height": 160}, "integration": {"method": "pyramid"}}
    upload = frame_of(each_device, volume=Volume(array), decode="upload", **tables)
    small = frame_of(each_device, volume=Volume(array), memory="1 MiB", **tables)
    np.testing.assert_array_equal(small.rgba, upload.rgba)
    np.testing.assert_array_equal(small.depth, upload.depth)
    assert small.stats["counters"] == upload.stats["counters"] and small.stats["samples"] == upload.stats["samples"]
    assert small.stats["compression"]["decoded_voxels"] > array.size  # some of it twice
    with pytest.raises(SceneError, match=r"compression.memory: .* decoded blocks can be held .* at least \d+ bytes"):
        frame_of(each_device, volume=Volume(array), memory="400 KiB", **tables)


def test_slices_of_one_scene_after_another_share_the_bricks(device):
    """The maps of another transfer function are made of voxels that are decoded anew."""
    with Renderer(scene_of(integration={"method": "pyramid"}), [device]) as renderer:
        renderer.render()
        function = TransferFunction([0, 120, 255], [0, 0.0, 0.4], [[1, 0, 0]] * 3, 2.0)
        renderer.set_transfer_function(function)
        frame = renderer.render()
    other = frame_of(device, decode="upload", integration={"method": "pyramid"}, transfer_function=function)
    np.testing.assert_array_equal(frame.rgba, other.rgba)


@pytest.mark.parametrize(
    ("tables", "what"),
    [
        ({"integration": {"filter": "cubic", "prefilter": True}}, "prefilter"),
        ({"light": HEADLIGHT, "gradient": {"storage": "precomputed"}}, "precomputed gradients"),
        ({"integration": {"voxel_precision": "uint8"}}, "quantised voxels"),
        ({"integration": {"method": "pyramid", "filter": "cubic", "prefilter": True}}, "prefilter"),
    ],
)
def test_what_needs_all_voxels_is_refused(device, tables, what):
    with pytest.raises(SceneError, match=f"compression.decode: got 'resident' in a scene that calls for {what}"):
        frame_of(device, **tables)


# The method "multiresolution"


@pytest.fixture(scope="module")
def store(tmp_path_factory, contexts):
    """A store of codes: mostly empty, so that few blocks show anything."""
    array = np.zeros((70, 64, 61), np.uint8)
    array[4:62, 8:44, 10:50] = waves((58, 36, 40), np.uint8)
    path = tmp_path_factory.mktemp("stores") / "codes.zarr"
    trainer = CodeTrainer(contexts(open_device()))
    build_store(Volume(array), path, codec="rvq", target=RateTarget(psnr=40.0), trainer=trainer)
    return path


def blocks_of(device, store, **compression):
    multiresolution = compression.pop("multiresolution", {"memory": "4 MiB"})
    scene = Scene(
        volume=load_volume(store), compression=compression, transfer_function=SMOOTH, multiresolution=multiresolution,
        image={"width": 60, "height": 52}, integration={"method": "multiresolution"},
    )  # fmt: skip
    with Renderer(scene, [device]) as renderer:
        return renderer.render()


def test_blocks_of_a_store_are_the_same_from_codes(each_device, store):
    samples, codes = blocks_of(each_device, store), blocks_of(each_device, store, decode="resident")
    np.testing.assert_array_equal(codes.rgba, samples.rgba)
    np.testing.assert_array_equal(codes.depth, samples.depth)
    assert np.ptp(codes.rgba[..., 3]) > 0.01
    held, stats = codes.stats["blocks"], codes.stats["compression"]
    assert held["levels"] == samples.stats["blocks"]["levels"]
    assert stats["codec"] == "rvq" and stats["device_bytes"] == held["bytes_on_device"]
    assert stats["decoded_voxels"] >= 16**3 * held["levels"][0]


def test_less_memory_shows_more_as_codes(device, store):
    whole = blocks_of(device, store)
    tight = {"memory": "220 KiB"}
    samples = blocks_of(device, store, multiresolution=tight)
    codes = blocks_of(device, store, multiresolution=tight, decode="resident")
    wrong = [np.abs(frame.rgba - whole.rgba).mean() for frame in (samples, codes)]
    assert wrong[1] < 0.5 * wrong[0]
    assert codes.stats["compression"]["device_bytes"] <= 220 * 1024


@pytest.mark.parametrize("settings", [{"tiles": 8}, {"stepping": "pyramid"}])
def test_blocks_of_codes_refuse_what_needs_all_of_them(device, store, settings):
    settings = {"memory": "4 MiB", **settings}
    with pytest.raises(SceneError, match="compression.decode: got 'resident' with the method 'multiresolution' and"):
        blocks_of(device, store, multiresolution=settings, decode="resident")


def test_multiresolution_needs_a_store_of_codes(device):
    with pytest.raises(SceneError, match="compression.decode: got 'resident' with the method 'multiresolution'"):
        frame_of(device, integration={"method": "multiresolution"})
