"""Blocks with effects: clipped, lit, cued. By the kernels, against the plain twin and against the ray caster."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.block_effects import ALL, CLIPS, LIT, SHAPE, SPOTS, SURFACES, rendered, scene, smooth, twin
from helpers.block_scenes import SHOWN, block_scene, noise, picture_of, random_levels, twin_of
from helpers.effect_scenes import LIGHTS
from helpers.small_scenes import waves
from reference.block_medium import BlockMediumField

from clvol import Camera, Volume
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.integrators.multiresolution.clipped_blocks import removed_blocks
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.registry import check_scene
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks

# ---- against the twin ----


@pytest.mark.parametrize(
    ("classification", "tables"), [("post", ALL), ("preintegrated", {"clip": CLIPS}), ("preintegrated", LIT)],
)  # fmt: skip
def test_pictures_are_the_twins(context, classification, tables):
    resolved = scene(classification=classification, **tables)
    levels = random_levels(BlockGrid(SHAPE), 3)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    # A ray that just enters or misses a clip takes a sample more or less.
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.98) < 2e-4 and far.max() < 0.02
    assert expected[..., 3].max() > 0.3


@pytest.mark.parametrize("lights", [LIGHTS[:2], pytest.param(SPOTS, marks=pytest.mark.slow)], ids=["", "spots"])
def test_each_light_counts(context, lights):
    """Two scenes of different light are not the same picture, and neither is the unlit one. (Spots compile a program
    of their own.)"""
    volume, levels = smooth(), random_levels(BlockGrid(SHAPE), 5)
    lit = [scene(volume, **{**ALL, "light": [light]}) for light in lights]
    pictures = [rendered(context, each, levels).rgba for each in lit]
    assert np.abs(pictures[0] - pictures[1]).max() > 0.05
    for each, picture in zip(lit, pictures):
        np.testing.assert_allclose(picture, twin(each, levels), atol=5e-4)


@pytest.mark.slow  # a program for each type
@pytest.mark.parametrize(("dtype", "holes"), [("float32", 0.02), ("uint16", 0.0), ("int8", 0.0)])
def test_other_types_and_holes(context, dtype, holes):
    resolved = scene(noise(SHAPE, dtype, holes=holes), **ALL)
    levels = random_levels(BlockGrid(SHAPE), 6)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.isfinite(data.rgba).all() and expected[..., 3].max() > 0.02
    # Beside a hole a sample, or a gradient, may or may not use it.
    assert np.quantile(far, 0.8 if holes else 0.98) < 3e-4


# ---- surfaces ----


def test_surfaces_are_the_twins(context):
    """Over faces of blocks of any two levels: where they are, their gradients, and what lies between them."""
    resolved = scene(smooth(), **SURFACES)
    levels = random_levels(BlockGrid(SHAPE), 3)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.95) < 3e-4 and far.max() < 0.2
    assert data.counters["surface_hits"] > 100 and expected[..., 3].max() > 0.5
    unlike = twin(scene(smooth(), **ALL), levels)
    assert np.abs(unlike - expected).max() > 0.2


def test_surfaces_at_full_resolution_are_the_ray_casters(context):
    volume = smooth()
    data = rendered(context, scene(volume, **SURFACES), np.zeros(BlockGrid(SHAPE).count, np.uint8))
    plain = picture_of(Raycaster(context, scene(volume, method="raycast", **SURFACES)))
    np.testing.assert_allclose(data.rgba, plain.rgba, atol=1e-4)
    assert data.counters["surface_hits"] == pytest.approx(plain.counters["surface_hits"], abs=3)


def test_surfaces_alone_hold_the_blocks_that_they_go_through(context):
    volume = smooth()
    nothing = replace(SHOWN, opacities=np.zeros(4))
    resolved = scene(volume, transfer_function=nothing, **SURFACES, multiresolution={"memory": "8 MiB"})
    engine = MultiresolutionEngine(context, resolved)
    found = engine.render(resolved.camera, 24, 20)
    plain = picture_of(Raycaster(context, scene(volume, transfer_function=nothing, method="raycast", **SURFACES)))
    np.testing.assert_allclose(found.rgba, plain.rgba, atol=1e-4)
    held = engine.residency.blocks.levels != DROPPED
    parts = list(VolumeBlocks(volume).statistics())
    low, high = (np.concatenate([getattr(part, name) for part in parts]) for name in ("reach_low", "reach_high"))
    through = np.any([(low <= value) & (value <= high) for value in (90.0, 150.0)], axis=0)
    removed = removed_blocks(resolved.clips, volume.grid, BlockGrid(SHAPE))
    assert held[through & ~removed].all() and not held[removed].any() and (through & ~removed).any()


@pytest.mark.slow  # a program more, of tiles that see no surface
def test_tiles_without_surfaces_are_the_same_bits(context):
    data = np.where((np.indices(SHAPE) > 26).all(axis=0), waves(SHAPE, np.uint8), 60).astype(np.uint8)
    tables = {"isosurface": SURFACES["isosurface"], "light": LIT["light"]}
    resolved, levels = scene(Volume(data), **tables), random_levels(BlockGrid(SHAPE), 3) % 3
    parted = rendered(context, resolved, levels, tile=(4, 4))
    assert parted.counters["tiles_without_surfaces"] > 3 and parted.counters["tiles_with_surfaces"] > 3
    whole = rendered(context, resolved, levels, tile=(24, 20))
    assert not whole.counters["tiles_without_surfaces"]
    np.testing.assert_array_equal(parted.rgba, whole.rgba)
    np.testing.assert_array_equal(parted.depth, whole.depth)
    assert parted.counters["surface_hits"] == whole.counters["surface_hits"]


# ---- hard cases ----


@pytest.mark.parametrize("shape", [(1, 30, 25), (17, 16, 15)])
def test_thin_volumes(context, shape):
    volume = noise(shape)
    upper = np.asarray(shape[::-1]) / 2.0
    clips = [{"type": "plane", "point": (upper + 0.3).tolist(), "normal": [1.0, 1.0, 0.2]}]
    resolved = scene(volume, **{**ALL, "clip": clips, "camera": Camera(position=(-30.0, 12.0, -25.0))})
    levels = random_levels(BlockGrid(shape), 2)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    assert np.quantile(np.abs(data.rgba - expected).max(axis=-1), 0.98) < 3e-4
    assert expected[..., 3].max() > 0.005


def test_an_eye_inside_the_volume(context):
    inside = Camera(position=(24.0, 15.0, 21.0), target=(40.0, 20.0, 25.0), up=(0.0, 1.0, 0.0), fov_degrees=90.0)
    resolved = scene(smooth(), **{**ALL, "camera": inside})
    levels = random_levels(BlockGrid(SHAPE), 9)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    assert np.quantile(np.abs(data.rgba - expected).max(axis=-1), 0.98) < 3e-4


def test_a_constant_volume_is_lit_by_its_cuts_alone(context):
    """Nothing has a gradient, whatever the levels; the faces that clips cut have normals of their own."""
    volume = Volume(np.full(SHAPE, 120, np.uint8))
    levels = random_levels(BlockGrid(SHAPE), 4)
    resolved = scene(volume, **{**ALL, "clip": CLIPS[:1]})
    np.testing.assert_allclose(rendered(context, resolved, levels).rgba, twin(resolved, levels), atol=2e-4)


# ---- what changes nothing ----


def test_empty_space_and_tiles_change_no_bit(context):
    data = np.where(np.indices((64, 48, 80))[2] < 30, 0, waves((64, 48, 80), np.uint8) // 2 + 100).astype(np.uint8)
    volume, function = Volume(data), SHOWN
    function = replace(function, opacities=np.array([0.0, 0.0, 0.05, 0.12]))
    resolved = scene(volume, **{**ALL, "transfer_function": function})
    levels = random_levels(BlockGrid(data.shape), 1)
    first = rendered(context, resolved, levels)
    walks = rendered(context, resolved, levels, skip=False)
    np.testing.assert_array_equal(first.rgba, walks.rgba)
    np.testing.assert_array_equal(first.depth, walks.depth)
    assert first.samples < walks.samples
    tiles = rendered(context, resolved, levels, tile=(4, 12))
    np.testing.assert_array_equal(first.rgba, tiles.rgba)
    assert tiles.counters == first.counters
    assert first.rgba[..., 3].max() > 0.3


@pytest.mark.slow  # two more programs
def test_lanes_and_buffers_change_less_than_rounding_does(context):
    resolved, levels = scene(smooth(), **ALL), random_levels(BlockGrid(SHAPE), 1)
    first = rendered(context, resolved, levels)
    buffers = rendered(context, resolved, levels, largest_buffer=20 * 16**3 + 64)
    np.testing.assert_allclose(buffers.rgba, first.rgba, atol=1e-5)
    one = rendered(context, resolved, levels, lanes=1)
    np.testing.assert_allclose(one.rgba, first.rgba, atol=2e-5)
    assert one.samples == first.samples


def test_what_clips_nothing_and_lights_nothing_compiles_nothing():
    volume = smooth()
    plain = scene(volume)
    around = {"type": "sphere", "center": [20.0, 20.0, 20.0], "radius": 500.0}
    idle = scene(volume, clip=[around], **{**LIT, "light": []})
    assert kernel_hash(idle) == kernel_hash(plain) != kernel_hash(scene(volume, clip=CLIPS))
    told = explain(scene(volume, **ALL))
    names = {effect["name"] for effect in told["effects"] if effect["called_for"]}
    assert {"clipping", "lighting", "specular", "depth cueing", "gradients"} <= names
    assert "precomputed gradients" not in names
    wide = explain(scene(Volume(waves(SHAPE, np.uint16)), **{**LIT, "gradient": {}}))
    reasons = {effect["name"]: effect for effect in wide["effects"]}
    assert not reasons["precomputed gradients"]["called_for"]


# ---- what is known ----


@pytest.mark.parametrize("classification", ("post", "preintegrated"))
def test_at_full_resolution_the_picture_is_the_ray_casters(context, classification):
    volume = smooth()
    resolved = scene(volume, classification, **ALL)
    data = rendered(context, resolved, np.zeros(BlockGrid(SHAPE).count, np.uint8))
    plain = picture_of(Raycaster(context, scene(volume, classification, "raycast", **ALL)))
    np.testing.assert_allclose(data.rgba, plain.rgba, atol=1e-4)
    np.testing.assert_allclose(data.depth, plain.depth, rtol=1e-4)
    assert data.samples == plain.samples
    counted = {name: data.counters[name] for name in plain.counters}
    assert counted == pytest.approx(plain.counters, abs=3)
    assert data.counters["block_reads"] >= data.samples + data.counters["gradients"]


def test_gradients_are_continuous_over_the_faces_of_blocks_of_different_levels():
    volume = noise(SHAPE)
    field = BlockMediumField(twin_of(volume, random_levels(BlockGrid(SHAPE), 8)), volume.grid)
    rng = np.random.default_rng(1)
    at = rng.random((4000, 3)) * (np.array(SHAPE[::-1]) - 3.0) + 1.0
    at[np.arange(4000), rng.integers(0, 3, 4000)] = 15.5  # on a face
    steps = [np.abs(field.gradient(at + d) - field.gradient(at - d)).max() for d in (1e-3, 1e-5)]
    assert steps[1] < 0.02 * steps[0] + 1e-9 and np.abs(field.gradient(at)).max() > 20.0


# ---- what is refused ----


@pytest.mark.parametrize(
    ("tables", "where"),
    [
        ({**LIT, "multiresolution": {"stepping": "pyramid"}, "integration": {"classification": "preintegrated"}},
         "multiresolution.stepping"),
        ({**LIT, "gradient": {"storage": "precomputed"}}, "gradient.storage"),
        ({**LIT, "gradient": {"operator": "sobel"}}, "integration.method"),
        ({"refraction": {"points": [{"value": 0.0, "index": 1.0}, {"value": 255.0, "index": 1.3}]}},
         "integration.method"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(tables, where):
    with pytest.raises(SceneError) as error:
        check_scene(scene(**tables))
    assert where in str(error.value) and "\n" not in str(error.value)


def test_a_lit_scene_of_any_stepping_takes_even_steps():
    hashes = {kernel_hash(block_scene(smooth(), settings={"stepping": stepping})) for stepping in ("full", "limited")}
    assert len(hashes) == 2
    lit = {kernel_hash(scene(smooth(), **LIT, multiresolution={"stepping": s})) for s in ("full", "limited", "naive")}
    assert len(lit) == 1
