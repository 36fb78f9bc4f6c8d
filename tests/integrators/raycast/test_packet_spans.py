"""Packets of rays that leap over empty space together (cl/packet_spans.h), beside rays that leap one by one: the same
bits and the same samples, and fewer leaps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_scenes import axis_camera, make_scene, waves

from clvol import TransferFunction
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.march import RayMarch
from clvol.scene.coherence import Coherence

SHAPE = (61, 83, 97)
BLOBS = TransferFunction([0, 120, 200, 255], [0, 0, 0.4, 0.9], [[1, 0.5, 0.2]] * 4)
ALL = TransferFunction([0, 255], [0.01, 0.3], [[0.2, 0.5, 1.0]] * 2)
AROUND = {"position": [190, 120, 160], "target": [48, 41, 30], "fov_degrees": 35.0}


class CountingMarch(RayMarch):
    """Counts look-ups in the map of empty space."""

    counters = ("leaps",)

    def switches(self):
        return {"COUNT_LEAPS": 1}


def blobs(shape=SHAPE, places=((20, 30, 25), (44, 60, 70), (11, 70, 50))) -> np.ndarray:
    z, y, x = np.ogrid[: shape[0], : shape[1], : shape[2]]
    field = np.zeros(shape)
    for a, b, c in places:
        field += 250 * np.exp(-((z - a) ** 2 + (y - b) ** 2 + (x - c) ** 2) / 30.0)
    return np.minimum(field, 255).astype(np.uint8)


def one_voxel() -> np.ndarray:
    array = np.zeros(SHAPE, np.uint8)
    array[30, 41, 48] = 255
    return array


def both(context, scene, tile=(16, 16), **how):
    """Frames without and with spans."""
    frames = []
    for mode in ("off", "cells"):
        resolved = replace(scene, coherence=Coherence(mode=mode))
        caster = Raycaster(context, resolved, tile=tile, march=CountingMarch(), **how)
        frames.append(caster.render(resolved.camera, resolved.image.width, resolved.image.height))
    return frames


def assert_same(off, on):
    np.testing.assert_array_equal(on.rgba.view(np.uint32), off.rgba.view(np.uint32))
    np.testing.assert_array_equal(on.depth.view(np.uint32), off.depth.view(np.uint32))
    assert on.samples == off.samples


CASES = {
    "sparse": {},
    "odd sizes": {"width": 61, "height": 43},
    "few pixels": {"width": 9, "height": 7},
    "one pixel": {"width": 1, "height": 1},
    "orthographic": {"camera": axis_camera([48, 41, 30], axis=2, height=90.0)},
    "along a slanted axis": {"camera": {**AROUND, "projection": "orthographic", "height": 100.0}},
    "from within": {"camera": {"position": [48, 41, 45], "target": [20, 30, 20], "fov_degrees": 60.0}},
    "wide, from within": {"camera": {"position": [40, 50, 35], "target": [70, 60, 44], "fov_degrees": 150.0}},
    "within a blob": {"camera": {"position": [25, 30, 20], "target": [70, 60, 44], "fov_degrees": 40.0}},
    "far away": {"camera": {"position": [3e5, 1e5, 2e5], "target": [48, 41, 30], "fov_degrees": 0.02}},
    "looking past it": {"camera": {"position": [190, 120, 160], "target": [150, 41, 30], "fov_degrees": 70.0}},
    "looking away": {"camera": {"position": [190, 120, 160], "target": [290, 220, 260], "fov_degrees": 50.0}},
    "anisotropic": {"grid": {"spacing": (0.5, 1.0, 3.0)},
                    "camera": {"position": [100, 160, 190], "target": [24, 41, 90], "fov_degrees": 40.0}},
    "long steps": {"step": 3.7},
    "short steps": {"step": 0.23, "width": 30, "height": 26},
}  # fmt: skip


@pytest.mark.parametrize("classification", ["post", "preintegrated"])
def test_bits_and_samples_are_those_of_single_rays(context, classification):
    for name, how in CASES.items():
        settings = {"camera": AROUND, "width": 64, "height": 56, "classification": classification, **how}
        off, on = both(context, make_scene(blobs(), BLOBS, **settings))
        try:
            assert_same(off, on)
        except AssertionError as error:
            raise AssertionError(f"{name}: {error}") from None
        if name in ("sparse", "odd sizes", "along a slanted axis", "anisotropic"):
            assert on.rgba.any() and 0 < on.counters["leaps"] < 0.8 * off.counters["leaps"], name


def test_what_is_visible_may_be_all_or_one_voxel(context):
    for array, function, angle in ((waves(SHAPE, np.uint8), ALL, 35.0), (one_voxel(), BLOBS, 8.0)):
        camera = {**AROUND, "target": [48, 41, 30], "fov_degrees": angle}
        scene = make_scene(array, function, camera=camera, width=96, height=80, classification="post")
        off, on = both(context, scene)
        assert_same(off, on)
        assert on.rgba.any()
    assert on.samples < 96 * 80 and on.counters["leaps"] < 0.5 * off.counters["leaps"]


def test_where_nothing_is_visible_nothing_is_done(context):
    array = np.minimum(blobs(), 119)
    off, on = both(context, make_scene(array, BLOBS, camera=AROUND, classification="post"))
    assert_same(off, on)
    assert on.samples == 0 and not on.rgba.any() and np.isinf(on.depth).all()


def test_random_views(context):
    rng = np.random.default_rng(17)
    array, seen = blobs(), 0
    for number in range(40):
        target = rng.uniform(0, SHAPE[::-1])
        position = target + rng.normal(size=3) * rng.choice([5.0, 60.0, 400.0])
        camera = {"position": position.tolist(), "target": target.tolist(), "up": rng.normal(size=3).tolist()}
        camera |= {"fov_degrees": rng.uniform(5, 120)} if number % 3 else {
            "projection": "orthographic", "height": float(rng.uniform(10, 150))}  # fmt: skip
        width, height = rng.integers(1, 70, 2).tolist()
        scene = make_scene(array, BLOBS, camera=camera, width=width, height=height, classification="post")
        off, on = both(context, scene)
        assert_same(off, on)
        seen += bool(on.rgba.any())
    assert seen > 15


@pytest.mark.parametrize("tile", [(20, 12), (8, 40), (4, 4)])
def test_tiles_of_other_sizes(context, tile):
    scene = make_scene(blobs(), BLOBS, camera=AROUND, width=61, height=57, classification="post")
    off, on = both(context, scene, tile=tile)
    assert_same(off, on)


@pytest.mark.parametrize("how", [{"filter": "cubic"}, {"filter": "nearest"}, {"classification": "pre"},
                                 {"quadrature": "cells"}])  # fmt: skip
def test_other_settings(context, how):
    scene = make_scene(blobs(), BLOBS, camera=AROUND, width=45, height=39, **{"classification": "post", **how})
    off, on = both(context, scene)
    assert_same(off, on)
    assert on.rgba.any()


def test_steps_that_follow_the_data(context):
    function = TransferFunction([0, 200, 210, 255], [0, 0, 0.002, 0.006], [[1, 0.5, 0.2]] * 4)
    for classification in ("post", "preintegrated"):
        scene = make_scene(waves((48, 52, 64)), function, width=45, height=39, classification=classification,
                           step_error=1e-3)  # fmt: skip
        assert "STEP_CELLS" in Raycaster(context, scene).switches
        off, on = both(context, scene)
        assert_same(off, on)
        assert on.rgba.any() and on.counters["leaps"] < off.counters["leaps"]


def test_small_cells_give_the_picture_of_large_ones_with_fewer_samples(context, monkeypatch):
    import clvol.integrators.raycast.fine_cells as module

    scene = make_scene(blobs(), BLOBS, camera=AROUND, width=61, height=57, classification="post")
    _, fine = both(context, scene)
    monkeypatch.setattr(module, "MOST_FINE_CELLS", 0)
    _, coarse = both(context, scene)
    np.testing.assert_array_equal(fine.rgba, coarse.rgba)
    np.testing.assert_array_equal(fine.depth, coarse.depth)
    assert fine.samples < 0.75 * coarse.samples
    everything = Raycaster(context, scene, skip=False).render(scene.camera, 61, 57)
    np.testing.assert_array_equal(fine.rgba, everything.rgba)


def test_maps_of_octants_give_the_same_bits_with_fewer_leaps(context, monkeypatch):
    import clvol.integrators.raycast.march as module

    if not context.is_cpu:
        pytest.skip("maps of octants are for CPU devices")
    rng = np.random.default_rng(23)
    for number in range(12):
        target = rng.uniform(0, SHAPE[::-1])
        position = target + rng.normal(size=3) * rng.choice([5.0, 60.0, 400.0])
        camera = {"position": position.tolist(), "target": target.tolist(), "fov_degrees": rng.uniform(5, 120)}
        if number % 4 == 0:  # rays along axes and in planes of them
            camera = {"projection": "orthographic", "position": [48, 41, -90], "target": [48, 41 + 9 * number, 30],
                      "height": 110.0}  # fmt: skip
        how = {"camera": camera, "width": 61, "height": 53}
        scene = make_scene(blobs(), BLOBS, classification=("post", "preintegrated")[number % 2], **how)
        ahead = both(context, scene)
        with monkeypatch.context() as m:
            m.setattr(module, "MOST_OCTANT_CELLS", 0)
            around = both(context, scene)
        for one, other in zip(ahead, around):
            assert_same(other, one)
            assert one.counters["leaps"] <= other.counters["leaps"]
        if number == 0:
            assert all(one.counters["leaps"] < 0.8 * other.counters["leaps"] for one, other in zip(ahead, around))


@pytest.mark.parametrize("filter", ["linear", "nearest"])
def test_small_cells_for_surfaces_give_the_same_picture_and_fewer_of_them_are_looked_into(
    context, monkeypatch, filter
):
    import clvol.integrators.raycast.fine_cells as module
    from clvol.scene.isosurface import Isosurface

    nothing = TransferFunction([0, 255], [0, 0], [[0, 0, 0]] * 2)
    scene = make_scene(blobs(), nothing, camera=AROUND, width=61, height=57, classification="post", filter=filter)
    scene = replace(scene, isosurfaces=(Isosurface(value=90.0, opacity=0.5), Isosurface(value=200.0)))
    fine = Raycaster(context, scene).render(scene.camera, 61, 57)
    assert fine.rgba.any()
    monkeypatch.setattr(module, "MOST_FINE_CELLS", 0)
    for mode in ("off", "cells"):
        coarse = Raycaster(context, replace(scene, coherence=Coherence(mode=mode))).render(scene.camera, 61, 57)
        np.testing.assert_array_equal(fine.rgba, coarse.rgba)
        np.testing.assert_array_equal(fine.depth, coarse.depth)
        assert fine.samples < 0.75 * coarse.samples
