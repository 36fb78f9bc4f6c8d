"""The error of compressed voxels counts: errors are measured against the integral of the original ones."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.coarse_codes import CoarseTrainer
from helpers.small_scenes import SMOOTH, waves

from clvol import Scene, Volume, render_in_time, render_to_error
from clvol.accuracy.ground_truth import GroundTruth
from clvol.accuracy.metrics import compare
from clvol.accuracy.settings import apply, canonical, label, scene_tunables
from clvol.accuracy.tradeoff import measure_tradeoff
from clvol.integrators import decoding
from clvol.integrators.reference.picture import render_reference
from clvol.render.prepared_cache import PreparedCache

ARRAY = waves((20, 22, 27), np.uint8)


def scene_of(compression: dict, **tables) -> Scene:
    tables = {"image": {"width": 24, "height": 20}, "transfer_function": SMOOTH, **tables}
    return Scene(volume=Volume(ARRAY), compression=compression, **tables)


@pytest.fixture
def coarse(monkeypatch):
    """An encoder that makes large errors, whatever its target."""
    monkeypatch.setattr(decoding, "trainer", lambda context: CoarseTrainer())


def test_a_scene_without_compression_has_nothing_to_tune():
    for compression in ({}, {"codec": "none", "max_voxel_error": 0.1}):
        assert not [key for key in scene_tunables(scene_of(compression).resolve()) if "compression" in key]


def test_the_target_that_a_scene_states_is_a_ladder():
    for key, value in (("max_voxel_error", 0.03), ("psnr", 44.0), ("bits_per_voxel", 0.7)):
        tunables = scene_tunables(scene_of({"codec": "rvq", key: value}).resolve())
        assert {k for k in tunables if "compression" in k} == {"compression.codec", f"compression.{key}"}
        values = tunables[f"compression.{key}"].values
        assert value in values and list(values) == sorted(values, reverse=key == "max_voxel_error")
        assert tunables["compression.codec"].values == ("rvq", "none")


def test_a_target_has_no_effect_without_the_codec():
    resolved = scene_of({"codec": "rvq", "psnr": 44.0}).resolve()
    tunables = scene_tunables(resolved)
    settings = {"compression.codec": "none", "compression.psnr": 54.0}
    assert canonical(resolved, tunables, settings) == {"compression.codec": "none", "compression.psnr": 44.0}
    assert apply(resolved, settings).compression.codec == "none"
    assert label({k: tunables[k] for k in settings}, settings, resolved) == "codec none"


def test_an_error_is_held_with_codes(device):
    scene = scene_of({"codec": "rvq", "max_voxel_error": 0.04})
    frame = render_to_error(scene, 1e-3, devices=[device])
    accuracy = frame.stats["accuracy"]
    assert accuracy["bound"] <= 1e-3 and accuracy["settings"]["compression.codec"] == "rvq"
    assert frame.stats["compression"]["max_voxel_error"] <= accuracy["settings"]["compression.max_voxel_error"]
    exact, _, _ = render_reference(scene_of({}).resolve(), device)
    assert compare(frame.rgba, exact.astype(np.float32))["rmse"] <= 1e-3


def test_where_codes_are_too_coarse_the_voxels_are_taken(device, coarse):
    frame = render_to_error(scene_of({"codec": "rvq"}), 1e-3, devices=[device])
    assert frame.stats["accuracy"]["settings"]["compression.codec"] == "none"
    assert frame.stats["accuracy"]["bound"] <= 1e-3 and "compression" not in frame.stats
    assert 'codec = "none"' in frame.scene_source


@pytest.mark.filterwarnings("ignore:compression")
def test_codes_are_kept_where_they_are_good_enough(device, coarse):
    frame = render_to_error(scene_of({"codec": "rvq"}), 0.1, devices=[device])
    assert frame.stats["accuracy"]["settings"]["compression.codec"] == "rvq"
    assert frame.stats["compression"]["max_voxel_error"] > 0.05


def test_an_exact_picture_is_of_the_original_voxels(device, coarse):
    frame = render_to_error(scene_of({"codec": "rvq"}), 1e-8, devices=[device])
    assert frame.stats["accuracy"]["settings"]["compression.codec"] == "none"
    exact, _, _ = render_reference(scene_of({}).resolve(), device)
    np.testing.assert_allclose(frame.rgba, exact, atol=1e-6)


def test_the_limit_of_effects_is_that_of_the_original_voxels(context, coarse):
    light = {"light": [{"type": "headlight"}]}
    pixels = np.stack(np.meshgrid(np.arange(20), np.arange(24), indexing="ij"), -1).reshape(-1, 2)
    limits = []
    for compression in ({"codec": "rvq"}, {}):
        cache = PreparedCache(context)
        truth = GroundTruth(scene_of(compression, **light).resolve(), cache)
        assert not truth.is_exact
        limits.append(truth.pixels(pixels, 1e-6)[0])
        cache.close()
    np.testing.assert_array_equal(*limits)


def test_a_time_is_held_with_codes(device):
    frame = render_in_time(scene_of({"codec": "rvq", "max_voxel_error": 0.04}), 1.0, devices=[device])
    assert "compression.codec" in frame.stats["accuracy"]["settings"]


def test_tradeoff_tries_targets_and_the_voxels_as_they_are(device):
    scene = scene_of({"codec": "rvq", "max_voxel_error": 0.04}, integration={"step": 0.5})
    result, _ = measure_tradeoff(scene, devices=[device], frames=1, settings=60)
    tried = {(p["settings"]["compression.codec"], p["settings"]["compression.max_voxel_error"]): p["rmse"]
             for p in result["points"] if p["settings"]["integration.step"] == 0.5
             and p["settings"]["integration.method"] == "raycast"}  # fmt: skip
    assert {("rvq", 0.04), ("rvq", 0.0025), ("none", 0.04)} <= set(tried)
    assert tried["rvq", 0.04] > tried["rvq", 0.0025] >= tried["none", 0.04]
