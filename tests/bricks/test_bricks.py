"""Pictures in bricks are those of the whole volume to within 1e-6: no seams, no missing parts, however many bricks,
whatever the size of the picture."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, axis_camera, make_scene, picture, waves

from clvol import TransferFunction
from clvol.bricks.render import bricks_of, render_in_bricks
from clvol.errors import SceneError
from clvol.integrators.raycast.part_volume import PartVolume

SHARP = TransferFunction([0, 100, 100, 130, 130, 255], [0, 0, 0.6, 0.6, 0, 0], np.tile([[1.0, 0.7, 0.3]], (6, 1)))
# Nothing is empty; as many pieces as the other, so that no further program is compiled.
HAZE = TransferFunction(
    [0.0, 60.0, 140.0, 255.0],
    [0.02, 0.03, 0.02, 0.04],
    [[0.2, 0.5, 1.0], [0.9, 0.2, 0.1], [0.1, 0.9, 0.3], [1.0, 0.5, 0.2]],
)
SIZE = (29, 26, 35)
INSIDE = {"position": [10.3, 13.2, 11.7], "target": [30.0, 15.0, 14.0], "up": [0.0, 0.0, 1.0], "fov_degrees": 80.0}


def check(context, resolved, counts=(2, 5, 12)) -> None:
    whole = picture(context, resolved).rgba
    assert whole[..., 3].max() > 0.1
    for count in counts:
        bricks, _, samples = render_in_bricks(context, resolved, count)
        assert samples > 0
        assert np.abs(bricks - whole).max() < 1e-6, count


@pytest.mark.parametrize(
    ("dtype", "function", "how"),
    [
        (np.uint8, SMOOTH, {}),
        (np.float32, SMOOTH, {"classification": "post", "step": 0.7}),
        (np.int16, SHARP, {"filter": "cubic", "step": 1.3}),
        (np.uint8, HAZE, {"classification": "pre", "step": 2.6}),
    ],
)
def test_bricks_are_the_whole(context, dtype, function, how):
    check(context, make_scene(waves(SIZE, dtype), function, **how))


def test_from_inside_and_along_planes_between_bricks(context):
    volume = waves(SIZE, np.uint8)
    check(context, make_scene(volume, HAZE, camera=INSIDE))
    # Rays of whole lattice coordinates: those of a column run within planes between bricks.
    camera = axis_camera([17.0, 13.0, 14.0], axis=0, height=20.0)
    check(context, make_scene(volume, HAZE, camera=camera, width=21, height=20), (2, 8))


def test_grids_of_any_spacing_and_direction(context):
    turn = np.array([[0.0, -1.0, 0.0], [0.8, 0.0, 0.6], [-0.6, 0.0, 0.8]])
    grid = {"spacing": (1.0, 2.5, 0.4), "origin": (100.0, -7.0, 3.0), "direction": turn}
    check(context, make_scene(waves(SIZE, np.uint8), SMOOTH, grid=grid, step=1.1))


@pytest.mark.parametrize(("width", "height"), [(1, 1), (17, 9), (33, 31)])
def test_pictures_of_odd_sizes(context, width, height):
    """Even sizes only, elsewhere (libyt 36)."""
    check(context, make_scene(waves(SIZE, np.uint8), SMOOTH, width=width, height=height), (3,))


def test_a_constant_haze_has_no_seams(context):
    """Where ghost voxels are drawn twice, or are missing, faces show (VisIt with OSPRay 20982, 5377, 4990, 19661)."""
    resolved = make_scene(np.full(SIZE, 90, np.uint8), HAZE, width=40, height=30)
    whole = picture(context, resolved).rgba
    for count in (2, 4, 9, 16):  # nor do errors grow with the number of bricks (Ascent 1022)
        assert np.abs(render_in_bricks(context, resolved, count)[0] - whole).max() < 1e-6


def test_no_part_is_missing(context):
    """A point of light in each brick is there (yt 2622, 4871; Ascent 992), also at faces and corners of bricks."""
    bricks = bricks_of(make_scene(np.zeros(SIZE, np.uint8), SMOOTH), 8)
    volume = np.zeros(SIZE, np.uint8)
    for box in bricks.boxes:
        for x, y, z in (box.lower, box.upper, [(a + b) // 2 for a, b in zip(box.lower, box.upper)]):
            volume[z, y, x] = 255
    resolved = make_scene(volume, SMOOTH, width=60, height=50)
    check(context, resolved, (8,))
    lit = [bricks_of(resolved, 8).render(context, number).pixels[..., 3].max() > 0.01 for number in range(8)]
    assert all(lit)


def test_the_order_counts_and_is_right(context):
    """Emission is not added without order (quokka 1078)."""
    resolved = make_scene(waves(SIZE, np.uint8), SMOOTH)
    bricks = bricks_of(resolved, 4)
    partial = [bricks.render(context, number).pixels for number in range(4)]
    whole = picture(context, resolved).rgba
    assert np.abs(bricks.composited(partial) - whole).max() < 1e-6
    assert np.abs(sum(partial) - whole).max() > 0.05


def test_a_brick_has_its_voxels_and_few_more(context):
    resolved = make_scene(waves((65, 65, 65), np.uint8), SMOOTH)
    for box in bricks_of(resolved, 8).boxes:
        part = PartVolume(context, resolved, box.lower, box.upper)
        assert part.nbytes < 42**3 and part._part.size[0] <= 41


def test_a_volume_of_which_a_box_is_read_is_never_read_whole(context, tmp_path):
    from clvol import Scene
    from clvol.cli import main
    from clvol.volume.lazy import LazyVolume

    np.save(tmp_path / "v.npy", waves(SIZE, np.uint8))
    store = tmp_path / "v.zarr"
    assert main(["store", str(tmp_path / "v.npy"), "-o", str(store), "--codec", "none"]) == 0
    even = {"step_error": 0.0, "early_termination": 0.0, "classification": "preintegrated"}
    tables = {"volume": {"file": str(store)}, "integration": even, "image": {"width": 24, "height": 20}}
    scene = Scene.from_data(tables, "scene", tmp_path).model_copy(update={"transfer_function": SMOOTH})
    resolved = scene.resolve()
    assert isinstance(resolved.volume, LazyVolume)
    rgba, _, _ = render_in_bricks(context, resolved, 4)
    assert not resolved.volume.is_read
    whole = make_scene(np.load(tmp_path / "v.npy"), SMOOTH, classification="preintegrated")
    assert np.abs(rgba - picture(context, whole).rgba).max() < 1e-6


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"method": "reference"}, "integration.method: got 'reference' for bricks, expected 'raycast'"),
        ({"compositing": "average"}, "integration.compositing: got 'average'"),
        ({"filter": "cubic", "prefilter": True}, "prefilter: got true, which depends on all voxels"),
        ({"quadrature": "cells"}, "integration.quadrature"),
    ],
)
def test_what_bricks_cannot_do_is_refused(how, told):
    with pytest.raises(SceneError, match=told):
        bricks_of(make_scene(waves(SIZE, np.uint8), **how), 2)
