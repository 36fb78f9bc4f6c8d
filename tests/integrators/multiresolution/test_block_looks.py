"""Blocks whose looks depend on more than one transfer function: light beside what absorbs, opacity factors, layers and
joint functions, ambient occlusion, shadow rays. By the kernels, against the plain twin and against the ray caster."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.block_effects import CLIPS, CUE, LIT, MATERIAL, SHAPE, rendered, scene, smooth, twin
from helpers.block_scenes import noise, picture_of, random_levels

from clvol import Camera, Volume
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.multiresolution.integrator import INTEGRATOR
from clvol.integrators.multiresolution.residency import Residency
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.registry import check_scene
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED

LEVELS = random_levels(BlockGrid(SHAPE), 3)
FULL = np.zeros(BlockGrid(SHAPE).count, np.uint8)
COLORS = [[0.1, 0.2, 0.8], [0.2, 0.9, 0.4], [0.9, 0.6, 0.2], [1.0, 0.9, 0.9]]


def points(opacities, colors=COLORS, values=(0.0, 60.0, 140.0, 255.0)):
    return [{"value": v, "opacity": o, "color": c} for v, o, c in zip(values, opacities, colors)]


FLAMES = {"transfer_function": {"points": points([0.0, 0.01, 0.05, 0.0]), "associated": True, "emission": 0.05,
                                "opacity_unit": 1.0}}  # fmt: skip
FACTORS = {
    "gradient_opacity": {"points": [{"magnitude": 0.0, "opacity": 0.1}, {"magnitude": 30.0, "opacity": 1.0}]},
    "directional_opacity": {"points": [{"derivative": 0.0, "opacity": 0.4}, {"derivative": 20.0, "opacity": 1.0}]},
}
OTHER = points([0.0, 0.2, 0.02, 0.3], COLORS[::-1])
LAYERS = {"transfer_layer": [{"magnitude": 20.0, "points": OTHER}, {"magnitude": 45.0, "points": points([0.1] * 4)}]}
OCCLUSION = {"ambient_occlusion": {"directions": 8, "resolution": 5, "distance": 9.0, "step": 2.0}}
RAYS = {**LIT, "shadow": {"method": "rays", "step": 5.0}}
FUR = {"noise": [{"target": "fur", "root": 120.0, "tip": 60.0, "amplitude": 1.0, "frequency": 0.25}]}
TOGETHER = {**FLAMES, **FACTORS, "clip": CLIPS[:2], **CUE}
LENS = {"isosurface": [{"value": 120.0, "opacity": 0.3, "refraction": 1.3}], **LIT}
ENDS = {**LIT, "material": {**MATERIAL, "light_at": "ends"}}


def joint():
    rising = np.indices((9, 8, 11))[1].astype(np.float32)
    field = Volume(rising, spacing=[5.0, 4.6, 4.9])
    return {"field": [{"file": field, "role": "value"}], "transfer_layer": [{"values": [5.0], "points": OTHER}]}


# ---- against the twin ----


def test_pictures_are_the_twins(context):
    """Light and factors at once, of blocks at random levels."""
    resolved = scene(smooth(), width=12, height=10, **TOGETHER)
    data, expected = rendered(context, resolved, LEVELS), twin(resolved, LEVELS)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.98) < 3e-4 and far.max() < 0.02
    assert expected[..., :3].max() > 0.3 and data.counters["gradients"] > 500
    for without in (FLAMES, FACTORS):
        rest = {key: table for key, table in TOGETHER.items() if key not in without}
        assert np.abs(twin(scene(smooth(), width=12, height=10, **rest), LEVELS) - expected).max() > 0.02


@pytest.mark.slow  # programs of their own, and rays of the twin
@pytest.mark.parametrize(
    "tables", [OCCLUSION, LAYERS, joint(), RAYS, FUR], ids=["occlusion", "layers", "joint", "rays", "fur"]
)
def test_other_pictures_are_the_twins(context, tables):
    resolved = scene(smooth(), width=7, height=6, **tables)
    data, expected = rendered(context, resolved, LEVELS), twin(resolved, LEVELS)
    far = np.abs(data.rgba - expected).max(axis=-1)
    assert np.quantile(far, 0.95) < 5e-4 and far.max() < 0.02 and expected[..., 3].max() > 0.3
    assert (data.counters.get("occlusion_samples", 0) > 1000) == ("ambient_occlusion" in tables)


@pytest.mark.parametrize(
    ("classification", "tables"),
    [("preintegrated", LAYERS), ("post", FLAMES), ("preintegrated", TOGETHER), ("post", joint()), ("post", RAYS),
     ("preintegrated", {**RAYS, **FACTORS}), ("preintegrated", FUR), ("post", {**OCCLUSION, **LIT}),
     ("preintegrated", LENS), ("preintegrated", ENDS)],
    ids=["layers", "flames", "together", "joint", "rays", "rays with factors", "fur", "lit occlusion", "lens", "ends"],
)  # fmt: skip
def test_at_full_resolution_pictures_are_the_ray_casters(context, classification, tables):
    data = rendered(context, scene(smooth(), classification, **tables), FULL)
    plain = picture_of(Raycaster(context, scene(smooth(), classification, "raycast", **tables)))
    np.testing.assert_allclose(data.rgba, plain.rgba, atol=5e-6)
    assert plain.rgba.max() > 0.1
    if "isosurface" not in tables:  # of which others are looked into, since cells lie half a voxel off
        assert data.samples == plain.samples
        counted = {name: data.counters[name] for name in plain.counters if name != "occlusion_samples"}
        assert counted == pytest.approx({name: plain.counters[name] for name in counted}, rel=1e-3)


# ---- hard cases ----


@pytest.mark.slow  # a program of another type, and of a thin volume
@pytest.mark.parametrize("shape", [SHAPE, (1, 30, 25)])
def test_holes_thin_volumes_and_an_eye_inside(context, shape):
    volume = noise(shape, np.float32, holes=0.02)
    inside = Camera(position=(12.0, 15.0, -1.0), target=(20.0, 20.0, 25.0), up=(0.0, 1.0, 0.0), fov_degrees=80.0)
    levels = random_levels(BlockGrid(shape), 2)
    tables = {**TOGETHER, "clip": []}
    resolved = scene(volume, **{**tables, "camera": inside}, width=12, height=10)
    data, expected = rendered(context, resolved, levels), twin(resolved, levels)
    far = np.abs(data.rgba - expected).max(axis=-1)
    # Beside a hole a sample, or a gradient, may or may not use it.
    assert np.isfinite(data.rgba).all() and np.quantile(far, 0.8) < 5e-4 and data.rgba[..., :3].max() > 0.01


def test_what_glows_without_opacity_is_held_and_shown(context):
    """An opacity of 0 everywhere: blocks are chosen, and leapt over, by light alone."""
    data = np.where(np.indices(SHAPE)[2] < 20, 10, smooth().data // 2 + 100).astype(np.uint8)
    lamp = points([0.0] * 4, [[0.0] * 3, [0.0] * 3, [0.9, 0.3, 0.1], [1.0, 0.9, 0.4]])
    function = {"points": lamp, "associated": True, "emission": 0.1, "opacity_unit": 1.0}
    tables = {"transfer_function": function, "multiresolution": {"memory": "8 MiB"}}
    resolved = scene(Volume(data), **tables)
    engine = MultiresolutionEngine(context, resolved)
    found = engine.render(resolved.camera, 24, 20)
    dropped = (engine.residency.blocks.levels == DROPPED).reshape(BlockGrid(SHAPE).counts)
    assert dropped[:, :, 0].all() and not dropped[:, :, 2:].any()
    plain = picture_of(Raycaster(context, scene(Volume(data), method="raycast", **tables)))
    np.testing.assert_allclose(found.rgba, plain.rgba, atol=5e-6)
    assert found.rgba[..., :3].max() > 0.5 and not found.rgba[..., 3].any()
    assert found.samples < picture_of(engine.caster.__class__(context, resolved, engine.residency.blocks, skip=False)
                                      ).samples  # fmt: skip


# ---- which blocks are held ----


def test_a_view_of_other_looks_chooses_anew(context):
    """Scenes of one volume and memory share a residency, and errors of one are not those of another."""
    volume, tables = smooth(), {"multiresolution": {"memory": "90 KiB"}}
    scenes = [scene(volume, **tables, **more) for more in ({}, FACTORS, LAYERS, {})]
    residency = Residency(context, scenes[0])
    chosen = []
    for each in scenes:
        residency.ask(each)
        chosen.append(residency.blocks.levels.tobytes())
    assert len(set(chosen)) == 3 and chosen[3] == chosen[0]


# ---- what changes nothing, and what is refused ----


def test_what_is_not_used_compiles_nothing_and_what_is_used_is_explained():
    plain = scene(smooth())
    ones = {"points": [{"magnitude": 0.0, "opacity": 1.0}]}
    idle = scene(smooth(), gradient_opacity=ones, ambient_occlusion={"intensity": 0.0})
    assert kernel_hash(idle) == kernel_hash(plain)
    hashes = {kernel_hash(scene(smooth(), **tables)) for tables in (FLAMES, FACTORS, LAYERS, OCCLUSION, RAYS, joint())}
    assert len(hashes | {kernel_hash(plain)}) == 7
    told = explain(scene(smooth(), **TOGETHER, **OCCLUSION))
    names = {effect["name"] for effect in told["effects"] if effect["called_for"]}
    assert {"associated colours", "ambient occlusion", "gradient opacity", "directional opacity"} <= names
    assert set(INTEGRATOR.programs(scene(smooth(), **OCCLUSION), 16)) == {"raycast.cl", "occlusion_volume.cl"}
    assert set(INTEGRATOR.programs(scene(smooth(), **RAYS), 16)) == {"raycast.cl"}


@pytest.mark.parametrize(
    ("tables", "where"),
    [
        ({**OCCLUSION, "compression": {"decode": "resident"}}, "got 'resident' in a scene with ambient occlusion"),
        ({**LENS, "compression": {"decode": "resident"}}, "got 'resident' in a scene with refraction"),
        ({**FACTORS, "multiresolution": {"stepping": "pyramid"}, "classification": "preintegrated"},
         "multiresolution.stepping"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(tables, where):
    with pytest.raises(SceneError) as error:
        check_scene(scene(**tables))
    assert where in str(error.value) and "\n" not in str(error.value)
