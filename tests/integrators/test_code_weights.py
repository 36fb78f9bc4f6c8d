"""Weights of blocks by the transfer function: what cannot be seen may cost nothing, and nothing else gets worse."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import waves

from clvol import Renderer, Scene, TransferFunction, Volume
from clvol.errors import SceneError
from clvol.integrators.code_weights import NOTICED, block_ranges, block_weights, displacements
from clvol.integrators.multiresolution.luv import delta_e_luv, linear_to_luv
from clvol.integrators.registry import check_scene
from clvol.store.geometry import BlockGrid
from clvol.store.resolutions import block_samples

# Nothing below 150; from there on steep.
BRIGHT = TransferFunction([150.0, 200.0, 255.0], [0.0, 0.3, 0.6], [[1.0, 0.3, 0.1]] * 2 + [[0.2, 0.5, 1.0]])
BLACK = np.zeros(3)


def two_parts(seed: int = 3) -> np.ndarray:
    """uint8 [32, 32, 64]: noise from 20 to 90, and beyond x = 32 waves from 120 to 255."""
    rng = np.random.default_rng(seed)
    array = rng.integers(20, 91, (32, 32, 64)).astype(np.uint8)
    array[:, :, 32:] = waves((32, 32, 32), np.uint8, 120, 255)
    return array


def scene_of(array, function=BRIGHT, **tables) -> Scene:
    compression = {"codec": "rvq", "max_voxel_error": 0.02, "weighting": "transfer-function"}
    tables = {"compression": compression, "image": {"width": 32, "height": 24}, **tables}
    return Scene(volume=Volume(array), transfer_function=function, **tables)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 17, 40), (33, 32, 15), (16, 48, 31)])
@pytest.mark.parametrize("dtype", [np.int16, np.float32])
def test_the_range_of_a_block_and_a_voxel_around(shape, dtype):
    rng = np.random.default_rng(1)
    array = rng.integers(-999, 999, shape).astype(dtype)
    if dtype == np.float32:
        array[rng.random(shape) < 0.2] = np.nan
        array.flat[-1] = np.inf
    low, high = block_ranges(Volume(array))
    for k, place in enumerate(BlockGrid(shape).places(np.arange(len(low)))):
        part = array[tuple(slice(max(16 * p - 1, 0), 16 * p + 17) for p in place)].astype(float)
        part = part[np.isfinite(part)]
        assert (low[k], high[k]) == ((part.min(), part.max()) if part.size else (np.inf, -np.inf))


def test_values_move_as_far_as_their_colour_does_not_change():
    at, room = displacements(BRIGHT, 16.0, BLACK, 0.0, 255.0)
    alpha = -np.expm1(-BRIGHT.extinction(at) * 16.0)[:, None]
    luv = linear_to_luv(BRIGHT.color(at) * alpha)
    for k in range(0, at.size, 37):
        near = np.abs(at - at[k]) <= room[k]
        assert delta_e_luv(luv[near], luv[k]).max() <= NOTICED
    lowest, visible = room[0], at[np.argmax(delta_e_luv(luv, luv[0]) > NOTICED)]
    assert 0.9 * visible < lowest < visible and 150 < visible < 160
    nothing = TransferFunction([0.0], [0.0], [[1.0, 1.0, 1.0]])
    assert np.isinf(displacements(nothing, 16.0, BLACK, 0.0, 255.0)[1]).all()


def test_a_step_is_kept_apart():
    step = TransferFunction([0.0, 100.0, 100.0, 255.0], [0.0, 0.0, 0.5, 0.5], [[1.0, 1.0, 1.0]] * 4)
    at, room = displacements(step, 16.0, BLACK, 0.0, 255.0)
    assert (room[:-1] <= np.abs(at - 100.0)[:-1] + 1e-6).all() and room[0] > 99


def test_weights_are_those_of_what_shows():
    weights = block_weights(scene_of(two_parts()).resolve())
    by_place = weights.reshape(BlockGrid((32, 32, 64)).counts)
    assert (by_place[:, :, 0] < 0.05).all()  # the others see the waves, one voxel away
    assert (by_place[:, :, 2:].max(axis=(1, 2)) == 1.0).all() and weights.max() == 1.0
    assert block_weights(scene_of(two_parts(), compression={"codec": "rvq"}).resolve()) is None
    assert block_weights(scene_of(np.full((9, 9, 9), 7, np.uint8)).resolve()) is None


def test_what_is_transparent_costs_little_and_the_rest_is_as_exact(device):
    frames, codes = [], []
    for weighting in ("even", "transfer-function"):
        table = {"codec": "rvq", "max_voxel_error": 0.02, "weighting": weighting}
        with Renderer(scene_of(two_parts(), compression=table), [device]) as renderer:
            frames.append(renderer.render())
            codes.append(renderer._on_device.members[0].cache.codes(renderer.resolved))
            shown = renderer._on_device.prepared.resolved.volume.data
    weights = block_weights(scene_of(two_parts()).resolve())
    even, weighed = (c.coded.size for c in codes)
    assert weighed[weights < 0.05].sum() < 0.1 * even[weights < 0.05].sum()
    np.testing.assert_array_equal(weighed[weights == 1], even[weights == 1])
    off = np.abs(shown.astype(int) - two_parts())
    blocks = block_samples(off, BlockGrid(off.shape), 0, np.arange(len(weights))).reshape(len(weights), -1)
    bound = 0.02 * np.ptp(two_parts())
    assert (blocks.max(axis=1) <= bound / np.sqrt(weights) + 1e-6).all() and off.max() > 5 * bound
    np.testing.assert_allclose(frames[0].rgba, frames[1].rgba, atol=2e-3)
    stats = frames[1].stats["compression"]
    assert stats["weighting"] == "transfer-function" and "weighting" not in frames[0].stats["compression"]
    assert stats["max_voxel_error"] > 0.1 and "warnings" not in frames[1].stats


def test_another_transfer_function_is_encoded_anew(device):
    darker = TransferFunction([0.0, 255.0], [0.0, 0.4], [[1.0, 1.0, 1.0]] * 2)
    with Renderer(scene_of(two_parts()), [device]) as renderer:
        renderer.render()
        first = renderer._on_device.members[0].cache.codes(renderer.resolved)
        renderer.set_transfer_function(darker)
        frame = renderer.render()
        assert renderer._on_device.members[0].cache.codes(renderer.resolved) is not first
    with Renderer(scene_of(two_parts(), darker), [device]) as renderer:
        np.testing.assert_array_equal(frame.rgba, renderer.render().rgba)


@pytest.mark.parametrize(
    ("tables", "effect"),
    [
        ({"light": [{"type": "headlight"}]}, "lighting"),
        ({"isosurface": [{"value": 200.0}]}, "isosurfaces"),
        ({"integration": {"compositing": "maximum"}}, "projection"),
        ({"integration": {"filter": "cubic"}}, "cubic filter"),
    ],
)
def test_scenes_that_show_more_than_colours_are_refused(tables, effect):
    with pytest.raises(SceneError, match=f"compression.weighting: got 'transfer-function' in a scene.*{effect}"):
        check_scene(scene_of(two_parts(), **tables).resolve())


@pytest.mark.parametrize("table", [{"codec": "vq"}, {"codec": "rvq", "psnr": 40.0}])
def test_weights_need_a_bound(table):
    with pytest.raises(SceneError, match="compression.weighting: .*expected 'even', or the codec 'rvq' and max_voxel"):
        scene_of(two_parts(), compression={**table, "weighting": "transfer-function"})
