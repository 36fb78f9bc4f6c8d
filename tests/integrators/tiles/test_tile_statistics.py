"""What corner rays meet: the kernel against its twin."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import make_scene
from reference.tiles import DROPPED_CODE, corner_statistics_twin

from clvol.device.view import ray_frame
from clvol.integrators.tiles.geometry import TileGrid
from clvol.integrators.tiles.plan import COUNT, MAXIMUM
from clvol.integrators.tiles.statistics import corner_statistics
from clvol.opencl.structs import view_dtype
from clvol.store.geometry import BlockGrid

SHAPE = (21, 37, 30)
UPPER = np.array(SHAPE[::-1]) - 1.0


def view_of(frame) -> np.ndarray:
    view = np.zeros(1, view_dtype(8))
    names = ("plane_origin", "plane_du", "plane_dv", "ray_forward", "ray_du", "ray_dv")
    sources = (frame.origin, frame.du, frame.dv, frame.forward, frame.ray_du, frame.ray_dv)
    for name, source in zip(names, sources):
        view[0][name][:3] = source
    view["tangent"], view["centre"] = frame.lens, frame.centre
    view["step"], view["plane_distance"] = 0.7, frame.distance
    view["stop_opacity"], view["edge_length"] = 1.0, frame.unit
    view["upper"][0, :3] = UPPER
    return view


def both(context, camera: dict, blocks: BlockGrid, codes: np.ndarray, tiles: TileGrid):
    """Statistics of the kernel and of the twin."""
    scene = make_scene(np.zeros(SHAPE, np.uint8), camera=camera)
    frame = ray_frame(scene.camera, scene.volume.grid, tiles.width, tiles.height)
    view = view_of(frame)
    view["image"], view["tile"] = (tiles.width, tiles.height), 4
    rng = np.random.default_rng(9)
    index = rng.integers(0, 2**31, (blocks.count, 2)).astype(np.int32)  # what else is in there
    index[:, 1] = index[:, 1] & ~15 | codes
    on_device = context.upload(index)
    kernel = corner_statistics(context, on_device, blocks, view, 8, tiles)
    return kernel, corner_statistics_twin(index, blocks, frame, tiles, UPPER)


CAMERAS = [
    {"position": [70.3, 55.1, -40.7], "target": [14.2, 18.1, 10.3], "fov_degrees": 35.0},
    {"position": [13.1, 18.7, 9.9], "target": [30.0, 3.0, 20.0], "fov_degrees": 80.0},  # within
    {"projection": "orthographic", "position": [-50.0, 20.3, 11.2], "target": [14.0, 18.1, 10.4],
     "height": 60.0},
]  # fmt: skip


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("edge", [4, 16])
def test_kernel_and_twin_agree(context, camera, edge):
    blocks = BlockGrid(SHAPE, edge)
    rng = np.random.default_rng(edge)
    codes = rng.integers(1, edge.bit_length() + 1, blocks.count)
    codes[rng.random(blocks.count) < 0.2] = DROPPED_CODE
    tiles = TileGrid(61, 47, 8)
    kernel, twin = both(context, camera, blocks, codes, tiles)
    assert kernel.shape == twin.shape == (7, 9, 4)
    np.testing.assert_array_equal(kernel[..., COUNT], twin[..., COUNT])
    np.testing.assert_allclose(kernel, twin, atol=1e-6)
    assert kernel[..., COUNT].max() > 3 * 4 / edge  # it does go through several


def test_along_an_axis_every_block_of_the_row_counts_once(context):
    blocks = BlockGrid(SHAPE, 4)
    camera = {"projection": "orthographic", "position": [-30.0, 18.3, 10.2],
              "target": [14.5, 18.3, 10.2], "height": 8.0, "up": [0.0, 1.0, 0.0]}  # fmt: skip
    codes = np.full(blocks.count, 3)
    kernel, _ = both(context, camera, blocks, codes, TileGrid(8, 8, 3))
    assert (kernel[..., COUNT] == blocks.counts[2]).all()
    np.testing.assert_array_equal(kernel[..., :3], 1.0)  # 4 samples an axis are all


def test_dropped_blocks_count_as_nothing_and_one_sample_as_least(context):
    blocks = BlockGrid(SHAPE, 16)
    for code, scale in ((DROPPED_CODE, 0.0), (1, 1 / 16), (5, 1.0)):
        codes = np.full(blocks.count, code)
        kernel, _ = both(context, CAMERAS[0], blocks, codes, TileGrid(61, 47, 8))
        met = kernel[..., COUNT] > 0
        assert met.any() and not met.all()
        np.testing.assert_array_equal(kernel[met][:, :3], np.float32(scale))
        assert not kernel[~met].any()


def test_rays_go_through_the_corners_of_tiles_and_the_pictures_own_edge(context):
    """What two tilings have in common is the same."""
    blocks = BlockGrid(SHAPE, 4)
    codes = np.random.default_rng(2).integers(1, 4, blocks.count)
    coarse, _ = both(context, CAMERAS[0], blocks, codes, TileGrid(61, 47, 8))
    fine, _ = both(context, CAMERAS[0], blocks, codes, TileGrid(61, 47, 4))
    np.testing.assert_array_equal(coarse[:6, :8], fine[:12:2, :16:2])
    np.testing.assert_array_equal(coarse[-1, -1], fine[-1, -1])
    assert coarse[..., MAXIMUM].max() == 1.0
