"""Shadows through blocks, by a light volume: against the plain twin and the ray caster."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.block_effects import CLIPS, LIT, SHAPE, rendered, scene, smooth, twin
from helpers.block_scenes import picture_of, random_levels

from clvol import Camera, Volume
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.scene_errors import effects_on_blocks
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.registry import check_scene
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED

SHADOW = {"resolution": 8, "step": 2.5}
SHADED = {**LIT, "clip": CLIPS[:1], "shadow": SHADOW}


def test_pictures_are_the_twins(context):
    resolved = scene(smooth(), **SHADED)
    levels = random_levels(BlockGrid(SHAPE), 3)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.98) < 3e-4 and far.max() < 0.02
    without = rendered(context, scene(smooth(), **{**SHADED, "shadow": None}), levels)
    assert np.abs(data.rgba - without.rgba).max() > 0.05


@pytest.mark.slow  # four programs, of another classification and of the ray caster
def test_at_full_resolution_the_picture_is_the_ray_casters(context):
    levels = np.zeros(BlockGrid(SHAPE).count, np.uint8)
    tables = {**SHADED, "classification": "preintegrated"}
    data = rendered(context, scene(smooth(), **tables), levels)
    plain = picture_of(Raycaster(context, scene(smooth(), method="raycast", **tables)))
    np.testing.assert_allclose(data.rgba, plain.rgba, atol=1e-4)


@pytest.mark.slow  # programs with a cone of directions
def test_scattered_light_arrives(context):
    resolved = scene(smooth(), **{**SHADED, "shadow": {**SHADOW, "scattering": 0.6, "scatter_color": [0.9, 0.5, 0.2]}})
    levels = random_levels(BlockGrid(SHAPE), 5)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    assert np.quantile(np.abs(data.rgba - expected).max(axis=-1), 0.98) < 3e-4


@pytest.mark.slow  # the twin takes long
def test_light_is_found_anew_when_blocks_change(context):
    volume = smooth()
    resolved = scene(volume, **SHADED, multiresolution={"memory": "8 MiB"})
    engine = MultiresolutionEngine(context, resolved)
    picture_of(engine.caster)
    levels = random_levels(BlockGrid(SHAPE), 9)
    engine.residency.blocks.load(levels, engine.residency._block_means())
    engine.caster.set_resident()
    np.testing.assert_allclose(picture_of(engine.caster).rgba, twin(resolved, levels), atol=0.02)


def test_what_is_not_in_the_picture_casts_its_shadow_at_some_resolution(context):
    """Of a wide volume a corner is seen. What lies beside it has errors that count, with shadows alone."""
    volume = Volume(np.random.default_rng(3).integers(0, 255, (96, 96, 96)).astype(np.uint8))
    camera = Camera(position=(-100.0, 10.0, 10.0), target=(0.0, 10.0, 10.0), fov_degrees=14.0)
    chosen = []
    for shadow in (None, SHADOW):
        resolved = scene(
            volume, camera=camera, light=[{"type": "directional", "direction": [0.1, -1.0, 0.2]}], shadow=shadow,
            multiresolution={"memory": "700 KiB"},
        )  # fmt: skip
        engine = MultiresolutionEngine(context, resolved)
        chosen.append(engine.residency.blocks.levels.reshape(6, 6, 6))
    beside = [levels[3:, 3:, 3:][levels[3:, 3:, 3:] != DROPPED] for levels in chosen]
    coarsest = BlockGrid(volume.data.shape).levels - 1
    assert (beside[0] == coarsest).all() and (beside[1] < coarsest).any()


def test_shadows_are_refused_where_they_cannot_be_and_explained_where_they_are():
    with pytest.raises(SceneError, match="compression.decode: got 'resident' in a scene with shadows"):
        check_scene(scene(smooth(), **SHADED, compression={"decode": "resident"}))
    check_scene(scene(smooth(), **SHADED))
    told = explain(scene(smooth(), **SHADED))
    assert "shadows" in {effect["name"] for effect in told["effects"] if effect["called_for"]}
    dark = {**SHADED, "light": [{**light, "casts_shadow": False} for light in LIT["light"]]}
    assert kernel_hash(scene(smooth(), **dark)) == kernel_hash(scene(smooth(), **{**SHADED, "shadow": None}))
    assert not effects_on_blocks(scene(smooth(), **dark)).casts_shadows
