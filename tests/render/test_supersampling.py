"""Several rays per pixel: rays are pixels of larger pictures, and a pixel that is refined is the one of the picture in
which all are, bit for bit, by every method, on one device and on several."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import axis_camera

from clvol import Renderer, Scene, TransferFunction, Volume
from clvol.bricks.render import check_bricks
from clvol.device.view import PixelLattice, PixelList
from clvol.errors import SceneError
from clvol.opencl.context import DeviceContext
from clvol.opencl.devices import device_name
from clvol.render import device_group
from clvol.render import renderer as renderer_module
from clvol.render.prepared_cache import PreparedCache
from clvol.render.supersampling import picture as supersampling

METHODS = ("raycast", "multiresolution", "pyramid", "slicing", "reference")
SIZE = (45, 38)
SHARP = TransferFunction([100.0, 140.0], [0.0, 0.9], [[1.0, 0.4, 0.1], [1.0, 1.0, 0.8]])
KINDS = {
    "orthographic": {"camera": {"projection": "orthographic"}},
    "lit": {"light": [{"type": "headlight"}]},
    "surface": {"isosurface": [{"value": 130.0, "color": [1, 0.5, 0.2]}], "light": [{"type": "headlight"}]},
    "noise": {"noise": [{"target": "value", "amplitude": 40.0}]},
    "projection": {"integration": {"compositing": "maximum"}},
    "shadows": {"light": [{"type": "directional", "direction": [-1, -1, -1]}], "shadow": {"method": "rays"}},
    "codes": {"compression": {"codec": "rvq", "decode": "resident"}},
}


def ball(noisy: bool = True, n: int = 24, dtype=np.uint8) -> np.ndarray:
    z, y, x = np.meshgrid(*3 * [np.arange(n) - (n - 1) / 2], indexing="ij")
    values = 120 + 30 * np.clip(0.36 * n - np.sqrt(x * x + y * y + z * z), -2, 2)
    values += np.random.default_rng(5).normal(0, 4, values.shape) if noisy else 0
    return np.clip(values, 0, 255).astype(dtype)


def scene(image: dict, method: str = "raycast", voxels=None, size=SIZE, function=SHARP, **tables) -> Scene:
    integration = {"method": method, "classification": "preintegrated", **tables.pop("integration", {})}
    width, height = size
    return Scene(
        volume=Volume(ball() if voxels is None else voxels), transfer_function=function,
        image={"width": width, "height": height, **image}, integration=integration, **tables,
    )  # fmt: skip


def render(device, made: Scene, **how):
    with Renderer(made, devices=[device], **how) as renderer:
        return renderer.render()


def of_image(device, images: list[dict], **of_scene):
    """Frames of one scene with these [image] tables, by one Renderer."""
    frames = []
    with Renderer(scene(images[0], **of_scene), devices=[device]) as renderer:
        for image in images:
            renderer.set_scene(scene(image, **of_scene))
            frames.append(renderer.render())
    return frames


@pytest.mark.parametrize("method", METHODS)
def test_a_refined_pixel_is_that_of_the_picture_in_which_all_are(device, method):
    full, zero, some, one, plain = of_image(
        device,
        [{"samples": 4, "refine": "all"}, {"samples": 4, "edge_threshold": 0.0}, {"samples": 4, "edge_threshold": 0.05},
         {"samples": 1}, {}],
        method=method,
    )  # fmt: skip
    pixels = SIZE[0] * SIZE[1]
    assert np.array_equal(zero.rgba, full.rgba) and np.array_equal(zero.depth, full.depth)
    assert zero.stats["rays"] == full.stats["rays"] == 4 * pixels
    assert np.array_equal(one.rgba, plain.rgba) and one.stats["rays"] == pixels
    assert "supersampling" not in one.stats
    refined = (some.rgba != one.rgba).any(axis=-1)
    assert np.array_equal(some.rgba[refined], full.rgba[refined])
    told = some.stats["supersampling"]
    assert refined.sum() <= told["refined_pixels"] == sum(told["rounds"]) < pixels / 2 and refined.any()
    if method != "pyramid":  # whose tiles are rendered as a whole
        assert some.stats["rays"] == pixels + 4 * told["refined_pixels"]


@pytest.mark.parametrize("kind", KINDS)
def test_rays_of_a_list_are_those_of_the_larger_picture(device, kind):
    tables = dict(KINDS[kind])
    made = scene({"samples": 16, "width": 20, "height": 15}, **tables).resolve()
    context = DeviceContext(device)
    try:
        prepared = PreparedCache(context).prepare(made)
        whole = prepared.render(made.camera, 80, 60)
        rng = np.random.default_rng(1)
        rows, columns = (rng.permutation(n)[:300 % n or n].astype(np.int32) for n in (60, 80))
        rows, columns = (np.tile(each, 7)[:301].astype(np.int32) for each in (rows, columns))
        listed = prepared.render(made.camera, 80, 60, lattice=PixelList(rows, columns, 4))
        assert np.array_equal(listed.rgba.reshape(-1, 4)[:301], whole.rgba[rows, columns])
        assert np.array_equal(listed.depth.ravel()[:301], whole.depth[rows, columns])
        some = prepared.render(made.camera, 80, 60, lattice=PixelLattice(4, 1, 3, alone=True))
        assert np.array_equal(some.rgba, whole.rgba[3::4, 1::4])
    finally:
        context.release()


def test_a_pixel_is_the_mean_of_its_rays_and_as_deep_as_the_nearest(device):
    image = {"samples": 4, "refine": "all", "sample_pattern": "regular"}
    (four,) = of_image(device, [image])
    large = render(device, scene({}, size=(2 * SIZE[0], 2 * SIZE[1])))
    rays = large.rgba.reshape(SIZE[1], 2, SIZE[0], 2, 4)
    assert np.allclose(four.rgba, rays.mean(axis=(1, 3), dtype=np.float64), atol=1e-6)
    assert np.array_equal(four.depth, large.depth.reshape(SIZE[1], 2, SIZE[0], 2).min(axis=(1, 3)))


def test_graded_pixels_are_means_of_the_middle_and_of_two_rays_or_four(device):
    images = [{}, {"samples": 2, "refine": "all"}, {"samples": 4, "refine": "all"},
              {"samples": 4, "refine": "graded", "edge_threshold": 0.04}]  # fmt: skip
    one, two, four, graded = of_image(device, images)
    three, five = ((n * mean.rgba.astype(np.float64) + one.rgba) / (n + 1) for n, mean in ((2, two), (4, four)))
    kinds = [np.isclose(graded.rgba, kind, rtol=0, atol=1e-6).all(axis=-1) for kind in (one.rgba, three, five)]
    assert np.logical_or.reduce(kinds).all()
    few, many = kinds[1] & ~kinds[0] & ~kinds[2], kinds[2] & ~kinds[0] & ~kinds[1]
    assert few.sum() > 20 and many.sum() > 20
    assert np.array_equal(graded.depth[few], np.minimum(one.depth, two.depth)[few])
    assert np.array_equal(graded.depth[many], np.minimum(one.depth, four.depth)[many])
    told, pixels = graded.stats["supersampling"], SIZE[0] * SIZE[1]
    spent = graded.stats["rays"] - pixels
    assert 2 * told["refined_pixels"] <= spent <= 4 * told["refined_pixels"] and few.sum() + many.sum() <= spent / 2
    truth = render(device, scene({"samples": 16, "refine": "all"})).rgba
    assert np.square(graded.rgba - truth).mean() < 0.5 * np.square(one.rgba - truth).mean()
    (zero,) = of_image(device, [{"samples": 4, "refine": "graded", "edge_threshold": 0.0}])
    assert np.array_equal(zero.rgba, four.rgba)


def test_filters_that_reach_into_neighbours_do_not_go_with_graded_pixels():
    with pytest.raises(SceneError, match="'edges' or 'all' with a pixel_filter other than 'box'"):
        scene({"samples": 4, "refine": "graded", "pixel_filter": "tent"})


def test_a_picture_without_edges_gets_no_further_ray(device):
    haze = TransferFunction([0.0, 255.0], [0.1, 0.1], [[0.2, 0.5, 0.9], [0.2, 0.5, 0.9]])
    view = axis_camera((11.5, 11.5, 11.5), axis=2, height=12.0)
    images = [{}, {"samples": 4}, {"samples": 16, "refine": "all"}, {"samples": 4, "pixel_filter": "mitchell"},
              {"samples": 4, "refine": "graded"}]  # fmt: skip
    frames = of_image(device, images, function=haze, camera=view, size=(30, 30))
    for frame in frames[1:]:
        assert np.array_equal(frame.rgba, frames[0].rgba)
    assert [frame.stats["rays"] for frame in frames] == [900, 900, 16 * 900, 900, 900]
    assert frames[1].stats["supersampling"]["refined_pixels"] == 0


@pytest.mark.slow  # programs of their own
@pytest.mark.parametrize("degrees", [0.0, 4.0, 33.0, 45.0, 90.0])
def test_the_edge_of_a_half_plane_gets_its_coverage(device, degrees):
    angle, n = np.radians(degrees), 24
    _, y, x = np.meshgrid(*3 * [np.arange(n) - 11.5], indexing="ij")
    voxels = (128.0 + 8.0 * (x * np.cos(angle) + y * np.sin(angle) - 0.3)).astype(np.float32)
    step = TransferFunction([128.0, 128.0], [0.0, 1.0], [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    view = axis_camera((11.5, 11.5, 11.5), axis=2, height=16.0)
    images = [{"samples": n} for n in (1, 4, 16)]
    frames = of_image(device, images, voxels=voxels, function=step, camera=view, size=(16, 16))
    true = render(device, scene({}, voxels=voxels, function=step, camera=view, size=(512, 512)))
    true = true.rgba[..., 3].reshape(16, 32, 16, 32).mean(axis=(1, 3))
    errors = [float(np.sqrt(np.mean((frame.rgba[..., 3] - true) ** 2))) for frame in frames]
    assert errors[0] > 1.4 * errors[1] and errors[1] > 1.4 * errors[2]
    assert frames[1].stats["supersampling"]["share_of_pixels"] < 0.3


@pytest.mark.filterwarnings("ignore:.*the picture is blank")
def test_threads_that_no_ray_through_a_middle_meets_are_found(device):
    voxels = np.zeros((48, 48, 48), np.uint8)
    voxels[:, 20, 20] = 200  # one voxel thick: a quarter of a pixel
    voxels[30, 33, :] = 200
    function = TransferFunction([100.0, 200.0], [0.0, 0.9], [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    view = axis_camera((23.5, 23.5, 23.5), axis=0, height=96.0)
    images = [{}, {"samples": 16}, {"samples": 16, "refine": "all"}]
    one, some, full = of_image(device, images, voxels=voxels, function=function, camera=view, size=(12, 12))
    assert not one.rgba.any() and full.rgba.any()  # it lies between rays
    assert np.array_equal(some.rgba, full.rgba)
    assert some.stats["rays"] < full.stats["rays"] / 2


@pytest.mark.parametrize("name", ["tent", "gaussian", "mitchell"])
def test_filters_weigh_refined_pixels_as_in_the_picture_in_which_all_are(device, name):
    images = [{"samples": 4, "edge_threshold": t, "pixel_filter": name} for t in (0.0, 0.03)]
    images += [{"samples": 4, "refine": "all"}]
    full, some, box = of_image(device, images)
    assert np.abs(full.rgba - some.rgba).max() < 0.03
    assert np.abs(full.rgba - box.rgba).max() > 0.01
    assert some.rgba.min() >= 0.0 and some.rgba[..., 3].max() <= 1.0


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (17, 2)])
def test_pictures_of_a_few_pixels(device, size):
    images = [{"samples": 8}, {"samples": 8, "refine": "all"}]
    some, full = of_image(device, images, size=size)
    assert some.rgba.shape == (size[1], size[0], 4)
    if size == (1, 1):
        assert np.array_equal(some.rgba, full.rgba)


@pytest.mark.slow  # programs of their own
def test_voxels_that_are_not_numbers_are_clear_in_every_ray(device):
    voxels = ball().astype(np.float32)
    voxels[10:14, 8:12, 9:15] = np.nan
    some, full = of_image(device, [{"samples": 4, "edge_threshold": 0.03}, {"samples": 4, "refine": "all"}],
                          voxels=voxels)  # fmt: skip
    assert np.isfinite(some.rgba).all() and np.abs(some.rgba - full.rgba).max() < 0.06


@pytest.mark.parametrize("method", METHODS)
def test_devices_share_rays_and_the_picture_is_the_same(device, method, monkeypatch):
    refine = "graded" if method == "raycast" else "edges"
    made = scene({"samples": 4, "edge_threshold": 0.03, "refine": refine}, method)
    alone = render(device, made)
    monkeypatch.setattr(device_group, "_LEAST_TILES", 1)
    monkeypatch.setattr(renderer_module, "open_contexts", lambda _: [DeviceContext(device) for _ in range(3)])
    with Renderer(made) as renderer:
        for _ in range(2):
            frame = renderer.render()
            assert np.array_equal(frame.rgba, alone.rgba) and np.array_equal(frame.depth, alone.depth)
            assert frame.stats["rays"] == alone.stats["rays"]


@pytest.mark.slow  # programs of their own
def test_a_device_in_a_process_of_its_own_casts_the_same_rays(device):
    made = scene({"samples": 4, "edge_threshold": 0.03})
    expected = render(device, made)
    with Renderer(made, devices=[device_name(device)], isolate=True) as renderer:
        frame = renderer.render()
    assert np.array_equal(frame.rgba, expected.rgba) and frame.stats["rays"] == expected.stats["rays"]


@pytest.mark.slow  # programs of their own
def test_a_picture_for_a_given_time_refines_what_there_is_time_for(device, monkeypatch):
    made = scene({"samples": 4, "edge_threshold": 0.02}, "multiresolution")
    with Renderer(made, devices=[device]) as renderer:
        whole = renderer.render()
        ample = renderer.render(seconds=60.0)
        monkeypatch.setattr(supersampling, "_SHARE_OF_TIME", 1.0)  # so that no time is left
        short = renderer.render(seconds=1e-6)
    assert short.stats.get("supersampling", {}).get("refined_pixels", 0) == 0
    refined = ample.stats["supersampling"]["refined_pixels"]
    assert 0 < refined <= whole.stats["supersampling"]["refined_pixels"]
    assert (ample.rgba != whole.rgba).any(axis=-1).mean() < 0.1


@pytest.mark.slow  # programs of their own
def test_fewer_rays_first_and_more_where_they_are_needed(device):
    image = {"ray_spacing": 4, "ray_tolerance": 0.02}
    plain, some = of_image(device, [image, {**image, "samples": 4, "edge_threshold": 0.05}])
    added = some.stats["rays"] - plain.stats["rays"]
    assert added == 4 * some.stats["supersampling"]["refined_pixels"] > 0


def test_what_a_scene_compiles_changes_only_with_lists():
    from clvol.explanation import explain

    hashes = [
        explain(scene(image).resolve())["kernel_hash"]
        for image in ({}, {"samples": 1, "refine": "all"}, {"samples": 4, "refine": "all"}, {"samples": 4})
    ]
    assert len(set(hashes[:3])) == 1 and hashes[3] != hashes[0]


def test_bricks_of_a_volume_have_one_ray_per_pixel():
    with pytest.raises(SceneError, match="image.samples: got 4 for bricks, expected 1"):
        check_bricks(scene({"samples": 4}).resolve(), 2)


def test_progress_ends_with_all(device):
    told: list[tuple[int, int]] = []
    with Renderer(scene({"samples": 4}), devices=[device]) as renderer:
        renderer.render(progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (1000, 1000) and [done for done, _ in told] == sorted(done for done, _ in told)
