"""What the view sees of blocks, and blocks selected for it."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from clvol import Camera, TransferFunction, Volume
from clvol.errors import SceneError
from clvol.integrators.multiresolution import view_weight
from clvol.integrators.multiresolution.selection import select_blocks, source_errors
from clvol.integrators.multiresolution.view_weight import VISIBILITY_FLOOR, ViewWeights, view_weights, visibility
from clvol.scene import ImageSettings
from clvol.store.geometry import BlockGrid
from clvol.store.source import DROPPED
from clvol.store.volume_blocks import VolumeBlocks
from clvol.volume import Grid

IMAGE = ImageSettings(width=60, height=40)
SHAPE = (40, 56, 70)
OBLIQUE = np.array([[1.0, 0.3, 0.0], [0.0, 0.9, -0.2], [0.0, 0.1, 1.0]])
OBLIQUE = OBLIQUE / np.linalg.norm(OBLIQUE, axis=0)
GRIDS = [
    Grid(SHAPE),
    Grid(SHAPE, (1.0, 0.7, 2.5), (100.0, -30.0, 7.0)),
    Grid(SHAPE, (1.0, 1.3, 0.8), (5.0, 6.0, 7.0), OBLIQUE),
]


def corners_of(grid: Grid, blocks: BlockGrid) -> np.ndarray:
    """World [n, 8, 3] of the blocks' corners."""
    low = blocks.places(np.arange(blocks.count))[:, ::-1] * float(blocks.edge)
    high = np.minimum(low + blocks.edge, grid.size)
    pick = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in range(8)])
    index = np.where(pick, high[:, None], low[:, None]) - 0.5
    matrix = grid.index_to_world()
    return index @ matrix[:3, :3].T + matrix[:3, 3]


def on_screen(camera: Camera, points: np.ndarray, image: ImageSettings) -> np.ndarray:
    """Pixels [..., 2] from the middle of the picture."""
    ahead, right, up = np.moveaxis((points - camera.position) @ np.stack(camera.basis()).T, -1, 0)
    if camera.projection == "orthographic":
        pixel = camera.height / image.height
    else:
        pixel = 2 * math.tan(math.radians(camera.fov_degrees) / 2) / image.height * ahead
    return np.stack([right / pixel, up / pixel], axis=-1)


def weights_of(camera, grid, edge=16, image=IMAGE) -> ViewWeights:
    return view_weights(camera, grid, BlockGrid(grid.shape, edge), image.width, image.height)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_pixels_are_the_area_of_the_blocks_silhouette(grid, projection):
    camera = Camera(projection=projection, fov_degrees=20).complete(grid, IMAGE)
    blocks = BlockGrid(grid.shape)
    got = weights_of(camera, grid).pixels
    screen = on_screen(camera, corners_of(grid, blocks), IMAGE)
    expected = np.array([ConvexHull(points).volume for points in screen])  # 2-D: the area
    np.testing.assert_allclose(got, expected, rtol=1e-5 if projection == "orthographic" else 0.1)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(GRIDS), st.sampled_from(["perspective", "orthographic"]),
    st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6), st.floats(3, 120), st.floats(3, 60),
)  # fmt: skip
def test_what_a_ray_meets_is_never_left_out(grid, projection, at, fov, height):
    corners = grid.world_corners()
    centre, half = corners.mean(axis=0), np.ptp(corners, axis=0) / 2
    position, target = centre + half * at[:3], centre + half * at[3:]
    if np.linalg.norm(position - target) < 1:
        return
    camera = Camera(projection=projection, position=tuple(position), target=tuple(target),
                    fov_degrees=fov, height=height).complete(grid, IMAGE)  # fmt: skip
    blocks = BlockGrid(grid.shape)
    weights = weights_of(camera, grid)
    origins, directions = camera.world_rays(IMAGE.width, IMAGE.height)
    along = np.linspace(0.1, 250, 120)[:, None, None, None]
    to_index = grid.world_to_index()
    index = (origins + along * directions) @ to_index[:3, :3].T + to_index[:3, 3]
    place = np.floor((index + 0.5) / blocks.edge).astype(int).reshape(-1, 3)[:, ::-1]
    index = index.reshape(-1, 3)
    inside = ((index > -0.5) & (index < np.array(grid.size) - 0.5)).all(axis=1)
    met = np.unique(np.ravel_multi_index(tuple(place[inside].T), blocks.counts))
    assert (weights.pixels[met] > 0).all()
    assert np.isfinite(weights.pixels).all() and np.isfinite(weights.spacing).all()
    assert weights.pixels.max() <= IMAGE.width * IMAGE.height


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_blocks_beside_and_behind_the_view_count_for_nothing(projection):
    grid = Grid((16, 16, 16 * 21))
    camera = Camera(projection=projection, position=(168.0, 8.0, 8.0), target=(300.0, 8.0, 8.0),
                    height=10.0).complete(grid, IMAGE)  # fmt: skip
    pixels = weights_of(camera, grid).pixels
    assert (pixels[:10] == 0).all() and (pixels[10:] > 0).all()
    across = Camera(projection=projection, position=(168.0, 8.0, -100.0), target=(168.0, 8.0, 8.0),
                    height=10.0, fov_degrees=6).complete(grid, IMAGE)  # fmt: skip
    seen = np.flatnonzero(weights_of(across, grid).pixels)
    assert 10 in seen and len(seen) <= 3


def test_an_eye_inside_sees_its_own_block_everywhere():
    grid = Grid((80, 80, 80))
    camera = Camera(position=(40.1, 40.2, 40.3), target=(70.0, 41.0, 42.0)).complete(grid, IMAGE)
    weights = weights_of(camera, grid)
    pixels = weights.pixels.reshape(5, 5, 5)
    assert pixels[2, 2, 2] == IMAGE.width * IMAGE.height
    assert pixels[2, 2, 2] >= pixels[2, 2, 3] > pixels[2, 2, 4] > 0
    spacing = weights.spacing.reshape(5, 5, 5)
    assert spacing[2, 2, 2] > spacing[2, 2, 4] > 0


def test_the_unit_of_length_does_not_matter():
    plain = weights_of(Camera.default(GRIDS[1], IMAGE), GRIDS[1])
    for scale in (1e-20, 1e20):
        grid = Grid(SHAPE, tuple(scale * s for s in GRIDS[1].spacing),
                    tuple(scale * o for o in GRIDS[1].origin))  # fmt: skip
        scaled = weights_of(Camera.default(grid, IMAGE), grid)
        np.testing.assert_allclose(scaled.pixels, plain.pixels, rtol=1e-5)
        np.testing.assert_allclose(scaled.spacing, plain.spacing, rtol=1e-5)


def test_spacing_is_that_of_voxels_on_the_screen():
    grid = Grid((64, 64, 64))
    camera = Camera(projection="orthographic", height=160.0).complete(grid, IMAGE)
    np.testing.assert_allclose(weights_of(camera, grid).spacing, 0.25)


def test_levels_finer_than_pixels_count_by_their_share():
    weights = ViewWeights(np.float32([10, 10, 0]), np.float32([4.0, 0.25, 1.0]))
    errors = np.repeat(np.float32([[0], [1], [2], [3], [4]]), 3, axis=1)
    got = weights.apply(errors.copy())
    np.testing.assert_allclose(got[:, 0], 10 * errors[:, 0])
    np.testing.assert_allclose(got[:, 1], 10 * errors[:, 1] * [1 / 16, 1 / 4, 1, 1, 1])
    assert (got[:, 2] == 0).all() and (np.diff(got, axis=0) >= 0).all()
    np.testing.assert_array_equal(weights.apply(errors[:, 1:2].copy(), first=1), got[:, 1:2])


# -- occlusion --

LONG = Grid((32, 32, 320))
AHEAD = {"perspective": Camera(position=(-400.0, 15.5, 15.5), target=(0.0, 15.5, 15.5)),
         "orthographic": Camera(projection="orthographic", position=(-400.0, 15.5, 15.5),
                                target=(0.0, 15.5, 15.5), height=40.0)}  # fmt: skip


def seen(camera, grid, clear, edge=16) -> np.ndarray:
    blocks = BlockGrid(grid.shape, edge)
    camera = camera.complete(grid, IMAGE)
    return visibility(camera, grid, blocks, clear.astype(np.float32)).reshape(blocks.counts)


@pytest.mark.parametrize("camera", AHEAD.values(), ids=AHEAD)
def test_all_of_a_clear_volume_is_visible(camera):
    assert (seen(camera, LONG, np.ones((2, 2, 20))) == 1).all()


@pytest.mark.parametrize("camera", AHEAD.values(), ids=AHEAD)
@pytest.mark.parametrize("most", [10**6, 12])
def test_a_wall_hides_what_is_behind_it(camera, most, monkeypatch):
    monkeypatch.setattr(view_weight, "_TRACED", most)
    clear = np.ones((2, 2, 20))
    clear[:, :, 8:10] = 0.0
    got = seen(camera, LONG, clear)
    assert (got[:, :, :9] == 1).all()  # the wall itself is seen
    np.testing.assert_allclose(got[:, :, 11:], VISIBILITY_FLOOR)


@pytest.mark.parametrize("camera", AHEAD.values(), ids=AHEAD)
def test_light_falls_with_the_way_through_a_medium(camera):
    got = seen(camera, LONG, np.full((2, 2, 20), np.exp(-0.2)))
    expected = np.exp(-0.2 * np.arange(20))
    # A ray ends inside the block, and up to one block's part of it is not counted.
    assert (got <= expected * np.exp(0.21) + 1e-6).all() and (got >= expected * np.exp(-0.21)).all()
    assert (np.diff(got, axis=2) < 0).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(GRIDS))
def test_more_matter_hides_more(seed, grid):
    rng = np.random.default_rng(seed)
    blocks = BlockGrid(grid.shape, 8)
    corners = grid.world_corners()
    position = corners.mean(axis=0) + np.ptp(corners, axis=0) * rng.uniform(-1, 1, 3)
    camera = Camera(position=tuple(position), target=tuple(corners[0])).complete(grid, IMAGE)
    thin = rng.random(blocks.count) ** 0.2
    thick = thin * rng.random(blocks.count)
    one, other = (visibility(camera, grid, blocks, t) for t in (thin, thick))
    assert (other <= one).all() and (other >= np.float32(VISIBILITY_FLOOR)).all()
    assert (one <= 1).all() and one.max() > other.mean()


def test_an_eye_behind_the_wall_sees_what_is_there():
    clear = np.ones((2, 2, 20))
    clear[:, :, 8:10] = 0.0
    for projection in ("perspective", "orthographic"):
        camera = Camera(projection=projection, position=(190.0, 15.0, 15.5), height=40.0,
                        target=(300.0, 15.5, 15.5))  # fmt: skip
        got = seen(camera, LONG, clear)
        assert (got[:, :, 12:] == 1).all()


# -- the whole --

FUNCTION = TransferFunction([60.0, 255.0], [0.0, 0.9], [[0.1, 0.2, 0.8], [1.0, 0.9, 0.3]], 8.0)


@pytest.fixture(scope="module")
def source() -> VolumeBlocks:
    rng = np.random.default_rng(7)
    array = rng.integers(0, 256, (32, 32, 320), np.uint8)
    array[:, :, 100:140] = 9  # shows nothing
    return VolumeBlocks(Volume(array))


def select(source, camera, memory, **how):
    return select_blocks(source, FUNCTION, np.zeros(3), camera, IMAGE, memory, **how)


def test_without_a_view_all_blocks_count_alike(source):
    got = select(source, None, 10**9)
    levels = got.levels.reshape(2, 2, 20)
    assert (levels[:, :, 7:8] == DROPPED).all() and (levels[:, :, 10:] == 0).all()
    assert got.bytes == 4096 * np.count_nonzero(got.levels == 0) and got.error == 0


def test_where_all_fits_all_have_full_resolution_whatever_the_view(source):
    camera = Camera(position=(150.0, 15.0, 15.5), target=(300.0, 15.5, 15.5))
    got = select(source, camera.complete(source.grid, IMAGE), 10**9, occlusion=True)
    np.testing.assert_array_equal(got.levels, select(source, None, 10**9).levels)
    assert got.error == got.bound == 0


def test_a_view_spends_memory_on_what_it_sees(source):
    camera = Camera(position=(150.0, 15.0, 15.5), target=(300.0, 15.5, 15.5))
    memory = 40 * 4096
    got = select(source, camera.complete(source.grid, IMAGE), memory).levels.reshape(2, 2, 20)
    assert set(got[:, :, :7].ravel()) == {4} and (got[:, :, 10:12] < 4).all()
    memory = 20 * 4096
    seen = select(source, camera.complete(source.grid, IMAGE), memory)
    blind = select(source, None, memory)
    assert seen.bytes <= memory and blind.bytes <= memory
    ahead = np.s_[:, :, 10:14]
    levels = [found.levels.reshape(2, 2, 20)[ahead].mean() for found in (seen, blind)]
    assert levels[0] < levels[1]


def test_occlusion_spends_memory_before_the_wall(source):
    camera = Camera(position=(-60.0, 15.5, 15.5), target=(0.0, 15.5, 15.5))
    camera = camera.complete(source.grid, IMAGE)
    plain, occluded = (select(source, camera, 12 * 4096, occlusion=on) for on in (False, True))
    first = [found.levels.reshape(2, 2, 20)[:, :, :3].mean() for found in (plain, occluded)]
    assert first[1] <= first[0]
    assert (plain.levels != occluded.levels).any()


def test_what_is_known_of_a_source_serves_every_view(source):
    camera = Camera.default(source.grid, IMAGE)
    known = source_errors(source, FUNCTION, np.zeros(3))
    before = known.errors.copy()
    for memory in (10**4, 10**5):
        a = select(source, camera, memory, occlusion=True)
        b = select(source, camera, memory, occlusion=True, known=known)
        np.testing.assert_array_equal(a.levels, b.levels)
    np.testing.assert_array_equal(known.errors, before)


def test_what_is_taken_already_is_left(source):
    assert select(source, None, 50_000, overhead_bytes=30_000).bytes <= 20_000
    assert select(source, None, 30_000, overhead_bytes=30_000).bytes == 0


def test_less_memory_than_the_least_is_one_line(source):
    with pytest.raises(SceneError) as caught:
        select(source, None, 29_999, overhead_bytes=30_000)
    text = str(caught.value)
    assert "\n" not in text and "multiresolution.memory" in text and "at least" in text


@pytest.mark.slow
def test_statistics_are_not_kept(source):
    """Per block and level four bytes stay, whatever the statistics hold."""

    class Long(VolumeBlocks):
        blocks = BlockGrid((16, 16 * 200, 16 * 200))

        def __init__(self, part):
            self.part, self.grid, self.dtype = part, Grid(self.blocks.shape), np.dtype(np.uint8)

        def statistics(self):
            for first in range(0, self.blocks.count, len(self.part.mean[0])):
                yield replace(self.part, first=first)

    part = next(source.statistics())
    long = Long(part)
    tracemalloc.start()
    found = source_errors(long, FUNCTION, np.zeros(3))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.errors.nbytes == 40_000 * 5 * 4
    # The tables of colours take 4 MiB while they are made; all statistics would be 13 MB.
    assert peak < found.errors.nbytes + 40_000 * 5 + 5 * 2**20
