"""Pictures made of tiles, against the plain ray caster's."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.paths import DATA
from helpers.small_scenes import SMOOTH, make_scene, rms, waves
from reference.tile_raycaster import TileRaycaster
from reference.tiles import JoinTwin

from clvol import TransferFunction, load_scene
from clvol.integrators.tiles.geometry import ray_counts
from clvol.integrators.tiles.tiled import TiledRenderer
from clvol.scene.multiresolution import Multiresolution

EDGES = TransferFunction(
    [0, 99, 101, 180, 182, 255],
    [0, 0, 0.3, 0.3, 0.9, 0.9],
    [[0.2, 0.5, 0.9]] * 3 + [[1, 0.8, 0.3]] * 3,
)
DEMO = DATA / "demo.toml"
SIZES = [(7, 5, 16), (7, 5, 3), (1, 1, 2), (61, 45, 16), (33, 70, 9)]


@pytest.fixture(scope="module")
def engines():
    """``engines(context)``: one per context, so that nothing is compiled twice; its scene has edges in it."""
    made: dict = {}

    def engine(context) -> TileRaycaster:
        if context not in made:
            scene = make_scene(waves((30, 28, 34)), EDGES, classification="post")
            made[context] = TileRaycaster(context, scene)
        return made[context]

    return engine


def tiled(engine, size: int, **settings) -> TiledRenderer:
    return TiledRenderer(engine, Multiresolution(tiles=size, **settings))


class Blocks:
    """An engine that also says what its tiles' corners meet."""

    def __init__(self, engine: TileRaycaster, seed: int) -> None:
        self._engine, self._random = engine, np.random.default_rng(seed)

    def __getattr__(self, name: str):
        return getattr(self._engine, name)

    def corner_statistics(self, view, grid):
        kappa = self._random.choice([0.125, 0.25, 0.5, 1.0], (grid.rows + 1, grid.columns + 1, 1))
        return np.concatenate([kappa, kappa, kappa, np.ones_like(kappa)], axis=2), 16


@pytest.mark.parametrize(("width", "height", "size"), SIZES)
def test_with_all_rays_the_picture_is_the_plain_one_bit_for_bit(
    context, engines, width, height, size
):
    engine = engines(context)
    camera = engine.resolved.camera
    plain = engine.render(camera, width, height)
    whole = tiled(engine, size, tile_high=0.3).render(camera, width, height, rays=width * height)
    np.testing.assert_array_equal(whole.rgba, plain.rgba)
    np.testing.assert_array_equal(whole.depth, plain.depth)
    assert whole.samples == plain.samples and whole.rays == width * height
    assert whole.share == 1.0 and whole.estimated_rmse == 0.0


@pytest.mark.parametrize(("width", "height", "size"), SIZES)
def test_a_planned_picture_has_the_plans_rays_and_what_the_twin_puts_between(
    context, engines, width, height, size
):
    engine = Blocks(engines(context), size)
    camera = engine.resolved.camera
    plain = engine.render(camera, width, height)
    renderer = tiled(engine, size)
    picture = renderer.start(camera, width, height)
    tiles = np.arange(picture.grid.count)
    picture.refine(tiles)
    frame = picture.frame()
    twin = JoinTwin(picture.grid, picture.resolution)
    known = twin.is_ray()
    assert frame.rays == known.sum() == ray_counts(picture.grid, picture.resolution, tiles).sum()
    assert frame.share == known.mean() and frame.samples <= plain.samples
    np.testing.assert_array_equal(frame.rgba[known], plain.rgba[known])
    np.testing.assert_array_equal(frame.depth[known], plain.depth[known])
    rgba, depth = twin.join(plain.rgba, plain.depth)
    np.testing.assert_allclose(frame.rgba, rgba, atol=2e-6)
    np.testing.assert_array_equal(frame.depth, depth)


def test_planned_tiles_differ_as_their_corners_do(context, engines):
    engine = Blocks(engines(context), 4)
    picture = tiled(engine, 8, tile_low=0.2, tile_high=0.8).start(engine.resolved.camera, 80, 64)
    assert len(np.unique(picture.resolution.tau)) > 2
    assert picture.resolution.tau.min() >= 2 and picture.resolution.tau.max() == 6


def test_without_blocks_all_tiles_get_the_highest_quality(context, engines):
    picture = tiled(engines(context), 10, tile_high=0.5).start(
        engines(context).resolved.camera, 40, 30
    )
    assert (picture.resolution.tau == 5).all()


def test_refining_only_adds_rays_and_takes_errors_away(context, engines):
    engine = engines(context)
    camera = engine.resolved.camera
    width, height = 90, 70
    plain = engine.render(camera, width, height).rgba
    renderer = tiled(engine, 16, tile_high=0.12)
    planned = int(renderer.start(camera, width, height).costs.sum())
    budgets = (planned, 800, 1600, 3200, 4800, 6300)
    frames = [renderer.render(camera, width, height, rays=rays) for rays in budgets]
    assert frames[0].rays == planned
    for frame, rays in zip(frames[1:], budgets[1:]):
        assert rays - 300 < frame.rays <= rays
    errors = [rms(frame.rgba, plain) for frame in frames]
    assert (np.diff(errors) < 0).all() and errors[-1] == 0.0, errors
    for frame, error in list(zip(frames, errors))[1:4]:
        assert 0.4 * error < frame.estimated_rmse < 2.5 * error, (frame.estimated_rmse, error)


def test_a_picture_goes_on_where_it_stopped(context, engines):
    engine = engines(context)
    camera = engine.resolved.camera
    plain = engine.render(camera, 90, 70)
    picture = tiled(engine, 16, tile_high=0.12).start(camera, 90, 70)
    picture.cast()
    errors, known = [], []
    for rays in (1000, 2500, 4000):
        picture.improve(rays=rays)
        known.append(JoinTwin(picture.grid, picture.resolution).is_ray())
        errors.append(rms(picture.read(), plain.rgba))
    assert errors[0] > errors[1] > errors[2] > 0
    assert (known[1] | ~known[0]).all() and (known[2] | ~known[1]).all()
    picture.improve()
    np.testing.assert_array_equal(picture.frame().rgba, plain.rgba)
    assert picture.samples == plain.samples  # none was cast twice


def test_rays_stay_what_they_are_while_tiles_are_refined(context, engines):
    engine = engines(context)
    camera = engine.resolved.camera
    plain = engine.render(camera, 50, 40)
    picture = tiled(engine, 16, tile_high=0.2).start(camera, 50, 40)
    tiles, random = np.arange(picture.grid.count), np.random.default_rng(0)
    picture.refine(tiles)
    before = np.zeros((40, 50), bool)
    while picture.unknown.any():
        known = JoinTwin(picture.grid, picture.resolution).is_ray()
        assert (known | ~before).all() and known.sum() == picture.rays
        np.testing.assert_array_equal(picture.read()[known], plain.rgba[known])
        whole, _ = JoinTwin(picture.grid, picture.resolution).join(plain.rgba, plain.depth)
        np.testing.assert_allclose(picture.read(), whole, atol=2e-6)
        before = known
        open_tiles = tiles[picture.costs > 0]
        shown, chosen = picture.read(), random.choice(open_tiles, -(-len(open_tiles) // 2), False)
        work, measured = picture.refine(np.sort(chosen))
        change = np.mean((plain.rgba - shown) ** 2, axis=2).ravel()[work.pixels]
        means = [change[work.tiles == tile].mean() for tile in np.sort(chosen)]
        np.testing.assert_allclose(measured, means, rtol=1e-4, atol=1e-12)


def test_worst_first_beats_as_many_rays_spread_evenly(context, engines):
    engine = engines(context)
    camera = engine.resolved.camera
    plain = engine.render(camera, 160, 160).rgba
    even = tiled(engine, 8, tile_high=0.5).render(camera, 160, 160)
    worst_first = tiled(engine, 8, tile_high=0.25).render(camera, 160, 160, rays=even.rays)
    assert worst_first.rays <= even.rays
    assert rms(worst_first.rgba, plain) < 0.6 * rms(even.rgba, plain)


class Clock:
    """Seconds that pass as rays are cast."""

    def __init__(self, rays_a_second: float) -> None:
        self.rays_a_second, self.picture, self.reported = rays_a_second, None, 0

    def __call__(self) -> float:
        return self.reported / self.rays_a_second

    def progress(self, done: int, total: int) -> None:
        assert 0 < done <= total
        self.reported = done


def test_refinement_ends_with_the_time(context, engines):
    engine = engines(context)
    camera = engine.resolved.camera
    settings = Multiresolution(tiles=8, tile_high=0.125)
    cast = []
    for seconds in (0.1, 3.0, 6.0, 100.0):
        clock = Clock(1000.0)
        renderer = TiledRenderer(engine, settings, clock)
        frame = renderer.render(camera, 100, 80, clock.progress, seconds=seconds)
        cast.append(frame.rays)
        assert frame.rays <= max(1000 * seconds, 13 * 10) and clock.reported == frame.rays
    assert cast[0] == 13 * 10 and cast[-1] == 8000  # a ray a tile, and all
    assert cast[1] > 2500 and cast[2] > 5500  # and the time is used


def test_a_plan_beyond_the_budget_is_made_coarser(context, engines):
    engine = engines(context)
    camera = engine.resolved.camera
    renderer = tiled(engine, 8, tile_high=0.9)
    planned = renderer.render(camera, 100, 80).rays
    for rays in (300, 2000, 5000):
        assert 0.8 * rays < renderer.render(camera, 100, 80, rays=rays).rays <= rays < planned
    assert renderer.render(camera, 100, 80, rays=1).rays == 13 * 10  # one a tile
    for seconds in (1.0, 4.0):
        clock = Clock(1000.0)
        timed = TiledRenderer(engine, renderer.settings, clock)
        rays = timed.render(camera, 100, 80, clock.progress, seconds=seconds).rays
        assert 800 * seconds < rays <= 1000 * seconds < planned


def test_a_scene_that_shows_nothing_casts_no_ray(context, engines):
    clear = TransferFunction([0, 255], [0, 0], [[1, 1, 1]] * 2)
    engine = TileRaycaster(context, make_scene(waves((9, 9, 9)), clear))
    frame = tiled(engine, 8).render(engine.resolved.camera, 20, 10, rays=200)
    assert not frame.rgba.any() and np.isinf(frame.depth).all() and frame.rays == 0


def test_without_depth_there_is_none_and_colours_are_the_same(context, engines):
    engine = engines(context)
    camera = engine.resolved.camera
    renderer = tiled(engine, 16)
    without = renderer.render(camera, 40, 30, depth=False)
    assert without.depth is None
    np.testing.assert_array_equal(without.rgba, renderer.render(camera, 40, 30).rgba)


@pytest.mark.slow
def test_a_ray_a_work_item_gives_the_same_picture(context):
    """As on GPUs: there all lanes are one."""
    scene = make_scene(waves((20, 19, 21)), EDGES, classification="post")
    engine = TileRaycaster(context, scene, lanes=1)
    plain = engine.render(scene.camera, 30, 20)
    known = TiledRenderer(engine, Multiresolution(tiles=8, tile_high=0.4))
    for rays in (200, 600):
        frame = known.render(scene.camera, 30, 20, rays=rays)
        same = np.all(frame.rgba == plain.rgba, axis=2)
        assert same.sum() >= frame.rays > rays - 60
    np.testing.assert_array_equal(frame.rgba, plain.rgba)


def test_a_real_volume_needs_few_rays_for_most_of_the_picture(context):
    scene = load_scene(DEMO, ["image.width=128", "image.height=128"]).resolve()
    engine = TileRaycaster(context, scene)
    plain = engine.render(scene.camera, 128, 128)
    renderer = tiled(engine, 8, tile_high=0.125)
    frames = [renderer.render(scene.camera, 128, 128, rays=n) for n in (1, 4096, 8192, 16384)]
    errors = [rms(frame.rgba, plain.rgba) for frame in frames]
    assert errors[1] < 0.5 * errors[0] and errors[2] < 0.25 * errors[0] and errors[3] == 0, errors
    assert frames[2].samples < plain.samples


def test_nothing_is_compiled_once_warm(context, engines):
    engine = engines(context)
    renderer = tiled(engine, 16)
    renderer.warm_up()
    before = engine.context.compile_seconds
    renderer.render(engine.resolved.camera, 50, 40, rays=1000)
    assert engine.context.compile_seconds == before


def test_effects_are_those_of_the_plain_picture(context):
    scene = make_scene(waves((20, 19, 21)), SMOOTH, classification="post", compositing="maximum")
    engine = TileRaycaster(context, scene)
    plain = engine.render(scene.camera, 30, 20)
    whole = tiled(engine, 8).render(scene.camera, 30, 20, rays=600)
    np.testing.assert_array_equal(whole.rgba, plain.rgba)
    assert whole.counters == plain.counters and whole.samples == plain.samples


def test_tiles_of_one_pixel_are_refused(context, engines):
    with pytest.raises(ValueError, match="at least 2"):
        TiledRenderer(engines(context), Multiresolution())
