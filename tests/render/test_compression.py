"""Scenes with [compression]: pictures of codes are those of the decoded voxels as an ordinary volume, bit for bit."""

from __future__ import annotations

import gc
import json
import math
import re
import weakref

import numpy as np
import pytest
from helpers.coarse_codes import CoarseTrainer
from helpers.small_scenes import SMOOTH, waves

from clvol import Compression, Renderer, Scene, TransferFunction, Volume
from clvol.encoding.trainer import CodeTrainer
from clvol.errors import ClvolWarning, RenderError, SceneError, VolumeError
from clvol.explanation import explain, kernel_hash, scene_programs
from clvol.integrators import decoding
from clvol.integrators.registry import check_scene
from clvol.readers import load_volume
from clvol.scene import load_scene
from clvol.store.build import build_store
from clvol.store.codecs.coded_blocks import RateTarget
from clvol.store.codecs.decode import decode_blocks

VOLUME = waves((21, 34, 27), np.uint8)
LIT = {"light": [{"type": "headlight"}], "isosurface": [{"value": 100.0, "opacity": 0.5}]}
SHADOWED = {
    "light": [{"type": "directional", "direction": [-1.0, -1.0, -1.0]}],
    "shadow": {"method": "volume", "resolution": 8},
    "gradient_opacity": {"points": [{"magnitude": 0.0, "opacity": 0.2}, {"magnitude": 60.0, "opacity": 1.0}]},
    "noise": [{"target": "value", "amplitude": 9.0}],
}
METHODS = {
    "raycast": {},
    "raycast, lit": LIT,
    "raycast, shadowed": SHADOWED,
    "raycast, cubic": {"integration": {"filter": "cubic", "prefilter": True}},
    "raycast, nearest": {"integration": {"filter": "nearest", "classification": "pre"}},
    "raycast, cells": {"integration": {"quadrature": "cells"}},
    "raycast, fewer bits": {"integration": {"voxel_precision": "uint8"}},
    "raycast, maximum": {"integration": {"compositing": "maximum"}},
    "raycast, sparse": {"image": {"width": 30, "height": 26, "ray_spacing": 4}},
    "multiresolution": {"integration": {"method": "multiresolution"}, "multiresolution": {"memory": "70 KiB"}},
    "tiles": {"integration": {"method": "multiresolution"}, "multiresolution": {"memory": "70 KiB", "tiles": 8}},
    "slices of blocks": {
        "integration": {"method": "multiresolution"}, "multiresolution": {"memory": "90 KiB", "stepping": "pyramid"}
    },
    "pyramid": {"integration": {"method": "pyramid"}},
    "reference": {"integration": {"method": "reference"}},
}  # fmt: skip


@pytest.fixture
def trained(monkeypatch) -> list[tuple]:
    """What is trained from now on, by an encoder that makes large errors."""
    trainer = CoarseTrainer()
    monkeypatch.setattr(decoding, "trainer", lambda context: trainer)
    return trainer.trained


def scene_of(volume, compression: dict, **tables) -> Scene:
    """Pre-integrated, if nothing else is said: "auto" does not look at voxels that are codes."""
    volume = volume if isinstance(volume, Volume) else Volume(volume)
    tables["integration"] = {"classification": "preintegrated", **tables.get("integration", {})}
    tables = {"image": {"width": 30, "height": 26}, "transfer_function": SMOOTH, **tables}
    return Scene(volume=volume, compression=compression, **tables)


def decoded_by_numpy(renderer: Renderer) -> np.ndarray:
    """The voxels of the codes that ``renderer`` has made, block by block."""
    codes = renderer._on_device.members[0].cache.codes(renderer.resolved)
    edge, voxels = codes.blocks.edge, np.empty(codes.grid.shape, codes.dtype)
    samples = decode_blocks(codes.coded, edge, codes.codebooks)
    for block, place in zip(samples, codes.blocks.places(np.arange(codes.blocks.count))):
        part = voxels[tuple(slice(edge * p, edge * (p + 1)) for p in place)]
        part[...] = block[tuple(slice(n) for n in part.shape)]
    return voxels


def check_is_picture_of_decoded(scene: Scene, device, codec: str = "rvq") -> np.ndarray:
    """Renders ``scene`` and its decoded voxels, and returns these."""
    with Renderer(scene, [device]) as renderer:
        frame, voxels = renderer.render(), decoded_by_numpy(renderer)
    plain = scene.model_copy(update={"volume": Volume(voxels), "compression": Compression()})
    with Renderer(plain, [device]) as renderer:
        other = renderer.render()
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    np.testing.assert_array_equal(frame.depth, other.depth)
    for name in ("samples", "rays", "counters", "blocks", "tiles", "effects"):
        assert frame.stats.get(name) == other.stats.get(name), name
    assert "compression" not in other.stats
    stats = frame.stats["compression"]
    assert stats["decoded_voxels"] == voxels.size
    assert stats["codec"] == codec and stats["device_bytes"] >= voxels.nbytes
    return voxels


@pytest.mark.every_case
@pytest.mark.filterwarnings("ignore:compression")
@pytest.mark.parametrize("method", METHODS)
def test_every_integrator_shows_the_decoded_volume(method, device, trained):
    volume = waves((21, 34, 27), np.uint16) if "bits" in method else VOLUME
    voxels = check_is_picture_of_decoded(scene_of(volume, {"codec": "rvq"}, **METHODS[method]), device)
    assert (voxels != volume).mean() > 0.2 and len(trained) == 1


@pytest.mark.filterwarnings("ignore:compression")
def test_every_device_shows_the_decoded_volume(each_device, trained):
    check_is_picture_of_decoded(scene_of(VOLUME, {"codec": "rvq"}), each_device)


@pytest.mark.filterwarnings("ignore:compression")
@pytest.mark.parametrize("slope", [0.5, -2.0])
def test_values_that_are_not_the_stored_numbers(slope, device):
    """Exact codes show what the volume shows, whichever way its values run."""
    volume = Volume(waves((21, 34, 27), np.int16, -300, 900), slope=slope, offset=100.0)
    low, high = volume.value_range
    function = TransferFunction([low, high], [0.0, 0.5], [[0.2, 0.3, 0.9], [1, 1, 0.2]], 5.0)
    tables = {"transfer_function": function, "isosurface": [{"value": (low + high) / 2, "opacity": 0.5}]}
    frames = []
    for compression in ({}, {"codec": "labels"}):
        with Renderer(scene_of(volume, compression, **tables), [device]) as renderer:
            frames.append(renderer.render())
    np.testing.assert_array_equal(frames[0].rgba, frames[1].rgba)


def _with_holes(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[3:5, 7, 9], array[-1, -1, -1] = np.nan, np.inf
    return array


RANDOM = np.random.default_rng(5)
HARD = {
    "one voxel": np.full((1, 1, 1), 7, np.uint8),
    "a slab": waves((1, 20, 17), np.uint8),
    "a line": waves((1, 1, 40), np.int16),
    "odd sizes": waves((33, 17, 31), np.uint16, high=60000.0),
    "constant": np.full((18, 9, 20), 100.0, np.float32),
    "no number": np.full((18, 9, 20), np.nan, np.float32),
    "holes": _with_holes(waves((20, 21, 22))),
    "signed bytes": waves((17, 18, 19), np.int8, -100, 100),
    "signed": waves((17, 18, 19), np.int16, -30000, 30000),
    "double": waves((17, 18, 19), np.float64),
    "huge": waves((17, 18, 19), np.float32, -1e30, 1e30),
    "noise": RANDOM.integers(0, 256, (20, 19, 18)).astype(np.uint8),
}


@pytest.mark.every_case
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", HARD)
def test_hard_volumes(name, device, trained):
    array = HARD[name]
    finite = array[np.isfinite(array)].astype(np.float64)
    low, high = (finite.min(), finite.max()) if finite.size else (0.0, 1.0)
    function = TransferFunction([low, high if high > low else low + 1], [0.1, 0.6], [[0.2, 0.3, 0.9], [1, 1, 0.2]], 5.0)
    scene = scene_of(array, {"codec": "rvq"}, transfer_function=function)
    voxels = check_is_picture_of_decoded(scene, device)
    assert voxels.dtype == (np.float32 if array.dtype == np.float64 else array.dtype)
    broken = ~np.isfinite(array)
    np.testing.assert_array_equal(voxels[broken], array[broken])


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("codec", ["rvq", "hvq", "vq-mean", "vq"])
def test_every_codec(codec, each_device):
    """Encoded and decoded on each device; the two agree on the codes, as on the voxels."""
    for array in (VOLUME, _with_holes(waves((20, 21, 22)))):
        check_is_picture_of_decoded(scene_of(array, {"codec": codec}), each_device, codec)


def test_a_bound_holds(device):
    with Renderer(scene_of(VOLUME, {"codec": "rvq", "max_voxel_error": 0.015}), [device]) as renderer:
        assert 0 < renderer.render().stats["compression"]["max_voxel_error"] <= 0.015


def test_a_broken_bound_is_an_error(device, trained):
    with pytest.raises(RenderError, match="compression.max_voxel_error: a voxel is off by 0.1[0-9]* of the range"):
        Renderer(scene_of(VOLUME, {"codec": "rvq", "max_voxel_error": 0.01}), [device])


@pytest.mark.parametrize(
    ("target", "warning"),
    [({"psnr": 60.0}, "compression.psnr: PSNR .* dB, less than 60.* a PSNR of .* dB as the target"),
     ({"bits_per_voxel": 0.01}, "compression.bits_per_voxel: .* bits per voxel, more than 0.01.* as the target")],
)  # fmt: skip
def test_a_missed_target_is_a_warning(target, warning, device, trained):
    scene = scene_of(VOLUME, {"codec": "rvq", **target})
    with pytest.warns(ClvolWarning) as told, Renderer(scene, [device]) as renderer:
        stats = renderer.render().stats
    assert [w for w in told if re.search(warning, str(w.message))]
    assert any(re.search(warning, text) for text in stats["warnings"])


def test_a_rate_that_cannot_be_had_is_an_error(device):
    with pytest.raises(SceneError, match="compression.bits_per_voxel: got 0.001, .* at least [0-9.]+ for this volume"):
        Renderer(scene_of(VOLUME, {"codec": "rvq", "bits_per_voxel": 0.001}), [device])


DENSITY = waves((18, 22, 25), np.int16, -200, 900)
POINTS = [{"value": -200, "opacity": 0.0, "color": [1, 0, 0]}, {"value": 900, "opacity": 0.3, "color": [1, 1, 0]}]
FIELDS = {
    "density": {"role": "density", "points": POINTS},
    "mask": {"role": "mask", "threshold": 300.0},
    "label": {"role": "label", "labels": [{"label": 300, "color": [1.0, 0.0, 0.0]}]},
}


@pytest.mark.filterwarnings("ignore:.*compression")
@pytest.mark.parametrize("decode", ["upload", "resident"])
@pytest.mark.parametrize("role", FIELDS)
def test_densities_are_encoded_and_labels_and_masks_stay_exact(role, decode, device, trained):
    field = {"file": Volume(DENSITY), **FIELDS[role]}
    scene = scene_of(VOLUME, {"codec": "rvq", "decode": decode}, field=[field])
    with Renderer(scene, [device]) as renderer:
        frame, voxels = renderer.render(), decoded_by_numpy(renderer)
        prepared = decoding.coded_fields(renderer.resolved)
        shared = renderer._on_device.members[0].cache._shared
        decoded = {k: decoding.decoded_voxels(decoding.codes_of(own, shared), shared) for k, own in prepared.items()}
    other = DENSITY
    if role == "density":
        other = decoded[0].data
        assert (other != DENSITY).any() and len(trained) == 2
        (told,) = frame.stats["compression"]["fields"]
        assert told["field"] == 0 and told["codec"] == "rvq" and told["decoded_voxels"] == DENSITY.size
        error = np.abs(other.astype(float) - DENSITY).max() / np.ptp(DENSITY.astype(float))
        assert told["max_voxel_error"] == pytest.approx(error)
    else:
        assert decoded == {} and len(trained) == 1 and "fields" not in frame.stats["compression"]
    plain = scene_of(voxels, {}, field=[{**field, "file": Volume(other)}])
    with Renderer(plain, [device]) as renderer:
        np.testing.assert_array_equal(frame.rgba, renderer.render().rgba)


def test_a_density_that_labels_or_a_store_hold_is_left_alone(device, context, tmp_path):
    build_store(Volume(DENSITY), tmp_path / "a.zarr", codec="rvq", trainer=CodeTrainer(context))
    for volume in (Volume(DENSITY, labels=True), load_volume(tmp_path / "a.zarr")):
        field = {"file": volume, **FIELDS["density"]}
        scene = scene_of(VOLUME, {"codec": "rvq", "max_voxel_error": 0.05}, field=[field])
        with Renderer(scene, [device]) as renderer:
            assert "fields" not in renderer.render().stats["compression"]


def test_the_bound_holds_for_a_field(device):
    field = {"file": Volume(DENSITY), **FIELDS["density"]}
    with Renderer(scene_of(VOLUME, {"codec": "rvq", "max_voxel_error": 0.02}, field=[field]), [device]) as renderer:
        (told,) = renderer.render().stats["compression"]["fields"]
    assert 0 < told["max_voxel_error"] <= 0.02


STORED = {
    "raycast": LIT,
    "pyramid": {"integration": {"method": "pyramid"}},
    "reference": {"integration": {"method": "reference"}},
    "multiresolution": {"integration": {"method": "multiresolution"}},  # all blocks at full resolution
    "tiles": {"integration": {"method": "multiresolution"}, "multiresolution": {"tiles": 8}},
    "slices of blocks": {"integration": {"method": "multiresolution"}, "multiresolution": {"stepping": "pyramid"}},
    "bounded": {"integration": {"method": "multiresolution"}, "multiresolution": {"stepping": "bounded"}},
}


@pytest.mark.every_case
@pytest.mark.filterwarnings("ignore:compression")
@pytest.mark.parametrize("method", STORED)
def test_a_store_of_codes(method, device, context, tmp_path):
    """Its codes are decoded by the device; the picture is that of the voxels that numpy decodes from the store."""
    target = RateTarget(max_voxel_error=0.03)
    store = build_store(
        Volume(VOLUME), tmp_path / "a.zarr", codec="rvq", target=target, trainer=CodeTrainer(context),
        edge=8 if method in ("raycast", "pyramid", "reference") else 16,
    )  # fmt: skip
    tables = {"image": {"width": 30, "height": 26}, "transfer_function": SMOOTH, **STORED[method]}
    tables["integration"] = {"classification": "preintegrated", **tables.get("integration", {})}
    frames = []
    for volume in (load_volume(tmp_path / "a.zarr"), Volume(store.volume_level(0))):
        with Renderer(Scene(volume=volume, **tables), [device]) as renderer:
            frames.append(renderer.render())
    np.testing.assert_array_equal(frames[0].rgba, frames[1].rgba)
    np.testing.assert_array_equal(frames[0].depth, frames[1].depth)
    stats = frames[0].stats["compression"]
    assert stats["codec"] == "rvq" and stats["max_voxel_error"] == store.codes.measured.max_voxel_error
    assert stats["decoded_voxels"] >= VOLUME.size and stats["device_bytes"] >= VOLUME.nbytes
    assert "compression" not in frames[1].stats
    with pytest.raises(SceneError, match="got 'vq' for a store of codes"):
        check_scene(Scene(volume=load_volume(tmp_path / "a.zarr"), compression={"codec": "vq"}, **tables).resolve())


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", HARD)
def test_labels_are_exact(name, device):
    array = HARD[name]
    tables = {"integration": {"filter": "nearest"}}
    if array.dtype == np.float64:
        with pytest.raises(SceneError, match="got 'labels' for float64 voxels"):
            check_scene(scene_of(array, {"codec": "labels"}).resolve())
        return
    with Renderer(scene_of(Volume(array, labels=True), {"codec": "labels"}, **tables), [device]) as renderer:
        frame, voxels = renderer.render(), decoded_by_numpy(renderer)
    with Renderer(scene_of(array, {}, **tables), [device]) as renderer:
        other = renderer.render()
    assert voxels.tobytes() == array.tobytes()
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    stats = frame.stats["compression"]
    assert stats["codec"] == "labels" and stats["psnr"] is None and stats["max_voxel_error"] == 0


def test_a_store_of_labels(device, tmp_path):
    array = (VOLUME // 64).astype(np.uint8)
    build_store(Volume(array, labels=True), tmp_path / "a.zarr", codec="labels")
    tables = {"image": {"width": 30, "height": 26}, "transfer_function": SMOOTH, "integration": {"filter": "nearest"}}
    frames = []
    for volume in (load_volume(tmp_path / "a.zarr"), Volume(array)):
        with Renderer(Scene(volume=volume, **tables), [device]) as renderer:
            frames.append(renderer.render())
    np.testing.assert_array_equal(frames[0].rgba, frames[1].rgba)
    assert frames[0].stats["compression"]["codec"] == "labels"


def test_labels_are_refused(tmp_path):
    """Those that the volume says it holds, and those that a field of the scene takes for labels."""
    labels = Volume(VOLUME, labels=True)
    with pytest.raises(SceneError, match="got 'rvq' for a volume of labels, which have to be exact"):
        check_scene(scene_of(labels, {"codec": "rvq"}).resolve())
    check_scene(scene_of(labels, {"codec": "none"}).resolve())
    field = {"role": "label", "labels": [{"label": 3, "color": [1.0, 0.0, 0.0]}]}
    volume = Volume(VOLUME)
    with pytest.raises(SceneError, match="voxels that field.0 takes for labels"):
        scene_of(volume, {"codec": "rvq"}, field=[{"file": volume, **field}]).resolve()
    np.save(tmp_path / "a.npy", VOLUME)
    (tmp_path / "a.toml").write_text("""version = 1
volume.file = "a.npy"
compression.codec = "vq"
[[field]]
file = "a.npy"
role = "label"
labels = [{ label = 3, color = [1.0, 0.0, 0.0] }]
""")
    with pytest.raises(SceneError, match="a.toml: compression.codec: got 'vq' for voxels that field.0"):
        load_scene(tmp_path / "a.toml").resolve()
    load_scene(tmp_path / "a.toml", ['compression.codec="none"']).resolve()


def test_the_error_is_measured_over_all_voxels(device, trained):
    with pytest.warns(Warning, match="differ from the original ones by up to 1[0-9] % of the range"):
        with Renderer(scene_of(VOLUME, {"codec": "rvq"}), [device]) as renderer:
            stats, voxels = renderer.render().stats, decoded_by_numpy(renderer)
    difference = (voxels.astype(float) - VOLUME) / np.ptp(VOLUME)
    compression = stats["compression"]
    assert compression["max_voxel_error"] == pytest.approx(np.abs(difference).max())
    assert compression["psnr"] == pytest.approx(-10 * math.log10(np.mean(difference**2)))
    assert compression["bits_per_voxel"] > 0
    assert json.loads(json.dumps(stats["compression"])) == compression


def test_exact_codes_have_no_psnr_and_no_warning(device, trained, recwarn):
    with Renderer(scene_of(np.full((18, 9, 20), 100, np.uint8), {"codec": "rvq"}), [device]) as renderer:
        stats = renderer.render().stats
    assert stats["compression"]["psnr"] is None and stats["compression"]["max_voxel_error"] == 0
    assert not [w for w in recwarn if "compression" in str(w.message)]


@pytest.mark.filterwarnings("ignore:compression")
def test_a_volume_is_encoded_once(device, trained):
    """Other transfer functions, methods and views share the codes; another target or seed has its own."""
    scene = scene_of(VOLUME, {"codec": "rvq", "max_voxel_error": 0.2})
    with Renderer(scene, [device]) as renderer:
        renderer.render()
        renderer.set_transfer_function(TransferFunction([0, 255], [0, 0.4], [[1, 0, 0]] * 2, 2.0))
        renderer.render(time=1.0)
        cache = renderer._on_device.members[0].cache
        assert len(trained) == 1
        for key, value in (("method", "pyramid"), ("method", "multiresolution"), ("step", 0.5)):
            cache.prepare(scene.model_copy(update={"integration": {key: value}}).resolve())
        assert len(trained) == 1
        for table in ({"codec": "rvq", "psnr": 40.0}, {"codec": "rvq", "max_voxel_error": 0.2, "seed": 1}):
            cache.prepare(scene.model_copy(update={"compression": table}).resolve())
        assert [str(seed) for _, _, seed in trained] == ["0", "0", "1"]


@pytest.mark.filterwarnings("ignore:compression")
def test_codes_live_with_their_volume(device, trained):
    """Another Renderer takes those that are there; once the volume is gone, so are they."""
    scene = scene_of(VOLUME, {"codec": "rvq"})
    for _ in range(2):
        with Renderer(scene, [device]) as renderer:
            renderer.render()
    assert len(trained) == 1
    codes = weakref.ref(next(iter(decoding._known[scene.volume].values())))
    del scene, renderer
    gc.collect()
    assert codes() is None


@pytest.mark.filterwarnings("ignore:compression")
def test_every_device_makes_the_same_codes(device, other_device):
    """So that pictures do not depend on which one has encoded."""
    made = []
    for chosen in (device, other_device):
        with Renderer(scene_of(VOLUME, {"codec": "rvq", "max_voxel_error": 0.01}), [chosen]) as renderer:
            made.append(renderer._on_device.members[0].cache.codes(renderer.resolved))
            np.testing.assert_array_equal(renderer._on_device.prepared.resolved.volume.data, decoded_by_numpy(renderer))
    np.testing.assert_array_equal(made[0].coded.data, made[1].coded.data)
    np.testing.assert_array_equal(made[0].codebooks.entries, made[1].codebooks.entries)


@pytest.mark.filterwarnings("ignore:compression")
def test_several_devices_share_codes(device, other_device, trained):
    scene = scene_of(VOLUME, {"codec": "rvq"})
    with Renderer(scene, [device, other_device]) as renderer:
        stats = renderer.render().stats
    assert len(trained) == 1 and stats["compression"]["decoded_voxels"] == VOLUME.size


def test_a_scene_without_compression_is_as_before(device):
    """Neither another kernel nor a stage more."""
    tables = {"image": {"width": 30, "height": 26}, "transfer_function": SMOOTH}
    plain = Scene(volume=Volume(VOLUME), **tables).resolve()
    off = Scene(volume=Volume(VOLUME), compression={"codec": "none", "max_voxel_error": 0.1}, **tables).resolve()
    assert kernel_hash(off) == kernel_hash(plain) and explain(off)["compression"] is None
    with Renderer(plain, [device]) as one, Renderer(off, [device]) as other:
        assert one._on_device.prepared.resolved.volume is plain.volume
        assert other._on_device.prepared.resolved.volume is off.volume
        frames = one.render(), other.render()
    np.testing.assert_array_equal(frames[0].rgba, frames[1].rgba)
    assert "compression" not in frames[1].stats


def test_the_kernel_is_that_of_the_decoded_volume():
    for array in (VOLUME, waves((17, 18, 19), np.float64)):
        coded = scene_of(array, {"codec": "rvq"}).resolve()
        array = array.astype(np.float32) if array.dtype == np.float64 else array
        assert kernel_hash(coded) == kernel_hash(scene_of(array, {}).resolve())


def test_the_kernel_is_that_of_codes_that_stay_on_the_device(device):
    scene = scene_of(VOLUME, {"codec": "rvq", "decode": "resident"})
    with Renderer(scene, [device]) as renderer:
        renderer.render()
        prepared = renderer._on_device.prepared
        told = scene_programs(scene.resolve(), prepared.lanes)["raycast.cl"]
        assert told == {**prepared.switches, "WITH_DEPTH": 1}
    assert kernel_hash(scene.resolve()) != kernel_hash(scene_of(VOLUME, {"codec": "rvq"}).resolve())
    assert explain(scene.resolve())["compression"]["decode"] == "resident"


def test_explain_says_what_compression_does():
    said = explain(scene_of(VOLUME, {"codec": "rvq", "max_voxel_error": 0.02}).resolve())["compression"]
    assert said["codec"] == "rvq" and said["decode"] == "upload" and said["target"] == {"max_voxel_error": 0.02}
    assert "within 0.02 of the range" in said["does"] and "encoding takes time once" in said["costs"]


def test_what_codes_cannot_hold_is_refused(device, trained):
    with pytest.raises(VolumeError, match="float32.*compression.codec = 'none'"):
        Renderer(scene_of(waves((9, 9, 9), np.float64, 0, 1e200), {"codec": "rvq"}), [device])


def test_codes_do_not_stay_where_an_integrator_needs_all_voxels():
    scene = scene_of(VOLUME, {"codec": "rvq", "decode": "resident"}, integration={"method": "reference"})
    with pytest.raises(SceneError, match="compression.decode: got 'resident' with the method 'reference'"):
        check_scene(scene.resolve())
