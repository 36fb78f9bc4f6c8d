"""Tunables are listed once; settings are values for them."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import make_scene, waves

from clvol import Volume
from clvol.accuracy.settings import (
    apply,
    canonical,
    changed,
    is_possible,
    key_of,
    label,
    neighbours,
    scene_settings,
    scene_tunables,
)
from clvol.accuracy.tunables import NOT_TUNABLE, TABLES, TUNABLES
from clvol.integrators.multiresolution.sample_allocator import buffer_samples
from clvol.scene.sizes import parse_size
from clvol.store.volume_blocks import VolumeBlocks

EXPECTED = {
    "integration.method", "integration.step", "integration.classification",
    "integration.quadrature", "integration.filter", "integration.early_termination",
    "integration.voxel_precision", "integration.step_error",
    "image.ray_spacing", "image.ray_tolerance",
    "pyramid.levels", "pyramid.oracle", "pyramid.epsilon",
    "multiresolution.memory", "multiresolution.stepping", "multiresolution.interblock",
    "multiresolution.step_error", "multiresolution.tiles", "multiresolution.tile_high",
}  # fmt: skip


def test_what_trades_accuracy_for_time_is_found():
    tunables = scene_tunables(make_scene(step=0.3))
    assert set(tunables) == EXPECTED
    for key, tunable in tunables.items():
        assert tunable.scene_value in tunable.values and len(set(tunable.values)) == len(tunable.values), key
        assert tunable.about and tunable.tunable.title
    assert [key for key, tunable in tunables.items() if tunable.tunable.is_main] == ["integration.step"]


def test_every_tunable_s_values_are_allowed_by_its_own_key():
    resolved = make_scene(waves((5, 6, 7)))
    for key, tunable in scene_tunables(resolved).items():
        for value in tunable.values:
            changed_scene = apply(resolved, {key: value})
            table, name = key.split(".")
            assert getattr(getattr(changed_scene, table), name) == value


def test_every_key_of_a_table_that_has_tunables_is_one_or_is_listed_as_none_with_a_reason():
    keys = {f"{table}.{name}" for table, model in TABLES.items() for name in model.model_fields}
    assert not TUNABLES.keys() & NOT_TUNABLE.keys()
    assert TUNABLES.keys() | NOT_TUNABLE.keys() == keys
    assert all(NOT_TUNABLE.values())
    assert {key.partition(".")[0] for key in TUNABLES} == TABLES.keys()


@pytest.mark.parametrize("step", [0.3, 1.0, 20.0, 1e-3])
def test_the_scene_s_own_value_has_its_place_in_the_ladder(step):
    values = scene_tunables(make_scene(step=step))["integration.step"].values
    assert step in values and list(values) == sorted(values, reverse=True)


def test_voxels_already_small_or_not_finite_have_no_precision_to_give():
    assert "integration.voxel_precision" not in scene_tunables(make_scene(waves((4, 5, 6), np.uint8)))
    holes = waves((4, 5, 6))
    holes[0, 0, 0] = np.inf
    assert "integration.voxel_precision" not in scene_tunables(make_scene(holes))
    tunable = scene_tunables(make_scene(waves((4, 5, 6), np.uint16)))["integration.voxel_precision"]
    assert tunable.values == ("uint8", "stored")


def test_settings_that_make_the_same_picture_are_the_same():
    resolved = make_scene(classification="post")
    tunables = scene_tunables(resolved)
    own = scene_settings(resolved, tunables)
    other = canonical(
        resolved, tunables, {**own, "image.ray_tolerance": 0.3}
    )
    assert key_of(other) == key_of(own) and changed(other, own) == []
    sparse = canonical(resolved, tunables, {**own, "image.ray_spacing": 4, "image.ray_tolerance": 0.3})
    assert changed(sparse, own) == ["image.ray_spacing", "image.ray_tolerance"]


def test_neighbours_are_one_notch_away():
    resolved = make_scene(step=1.0)
    tunables = scene_tunables(resolved)
    own = scene_settings(resolved, tunables)
    found = list(neighbours(tunables, own))
    assert all(len(changed(settings, own)) == 1 for settings in found)
    steps = {s["integration.step"] for s in found if s["integration.step"] != 1.0}
    assert steps == {2**0.5, 2**-0.5}
    kinds = {s["integration.classification"] for s in found}
    assert kinds == {"pre", "post", "preintegrated"}


def test_what_nothing_renders_is_not_possible():
    resolved = make_scene()
    assert is_possible(resolved, {"integration.step": 0.5})
    assert is_possible(resolved, {"integration.method": "pyramid"})
    assert not is_possible(
        resolved, {"integration.method": "pyramid", "integration.classification": "post"}
    )
    assert not is_possible(
        resolved, {"integration.quadrature": "cells", "integration.filter": "nearest"}
    )


def test_a_label_names_what_differs():
    resolved = make_scene(step=1.0, classification="preintegrated")
    tunables = scene_tunables(resolved)
    own = scene_settings(resolved, tunables)
    assert label(tunables, own, resolved) == "preintegrated, step 1"
    other = {**own, "integration.early_termination": 0.1, "integration.filter": "nearest"}
    assert label(tunables, other, resolved) == "preintegrated, nearest, step 1, early termination 0.1"


def test_budgets_ascend_by_their_bytes_and_the_scene_s_own_is_among_them():
    resolved = make_scene(waves((40, 50, 60), np.uint8))
    for memory in ("96 MiB", "100 KiB", "1 GB"):
        own = apply(resolved, {"multiresolution.memory": memory})
        tunable = scene_tunables(own)["multiresolution.memory"]
        sizes = [parse_size(value) for value in tunable.values]
        assert memory in tunable.values and sizes == sorted(set(sizes)) and len(sizes) >= 5
        assert tunable.next_to(tunable.values[2], 1) == tunable.values[3]
        assert tunable.next_to("1 B", 1) == tunable.values[0]  # between is where it belongs


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float64])
def test_every_budget_that_is_tried_is_enough_and_the_largest_holds_all(dtype):
    volume = Volume(waves((40, 50, 60), dtype))
    resolved = make_scene(volume)
    source = VolumeBlocks(volume)
    whole = source.blocks.count * source.blocks.edge**3
    values = scene_tunables(resolved)["multiresolution.memory"].tunable.values_for(resolved)
    held = [sum(buffer_samples(source.blocks, dtype, parse_size(v), 2**31)) for v in values]
    assert held[0] >= whole / 40 and held[-1] >= 0.99 * whole
    assert held == sorted(held)


def test_the_methods_have_their_own_tunables():
    resolved = make_scene(classification="preintegrated")
    tunables = scene_tunables(resolved)
    own = scene_settings(resolved, tunables)
    blocks = {**own, "integration.method": "multiresolution"}
    by_blocks = {"multiresolution.memory": "1 MiB", "multiresolution.stepping": "naive",
                 "multiresolution.interblock": False, "multiresolution.tiles": 8}  # fmt: skip
    by_rays = {"image.ray_spacing": 4, "integration.voxel_precision": "uint8"}
    assert changed(canonical(resolved, tunables, {**own, **by_blocks}), own) == []
    assert changed(canonical(resolved, tunables, {**blocks, **by_rays}), blocks) == []
    assert set(changed(canonical(resolved, tunables, {**blocks, **by_blocks}), blocks)) == {*by_blocks}
    without = {**blocks, "multiresolution.tile_high": 0.5}
    assert changed(canonical(resolved, tunables, without), blocks) == []
    said = label(tunables, {**blocks, **by_blocks}, resolved)
    assert said == "multiresolution, preintegrated, naive, no interblock, step 1, memory 1 MiB, tiles 8"


@pytest.mark.parametrize(("memory_cap", "possible"), [(10**9, True), (10**4, False)])
def test_what_takes_too_much_memory_is_not_possible(memory_cap, possible):
    resolved = make_scene()
    for method in ("raycast", "multiresolution"):
        settings = {"integration.method": method}
        assert is_possible(resolved, settings, memory_cap) == possible
