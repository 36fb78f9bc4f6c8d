"""Further volumes beside the first: labels, densities, masks, each on its own grid."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.small_scenes import axis_camera, picture, rms, waves
from helpers.twin_scenes import absorbed, constant_function, scene
from reference import render_twin

from clvol import TransferFunction, Volume
from clvol.device.fields import SceneFields, bounds_around, cell_boxes
from clvol.device.memory import scene_bytes
from clvol.errors import VolumeError
from clvol.render.renderer import check_memory

KINDS = ("post", "preintegrated", "pre")
SIZE = 17
LENGTH = SIZE - 1
RED, GREEN, BLUE = np.eye(3)
DTYPES = ("uint8", "int8", "uint16", "int16", "float32", "float64")


def block(**grid) -> Volume:
    """17^3 voxels of one value."""
    return Volume(np.ones((SIZE, SIZE, SIZE), np.float32), **grid)


def label_field(array, labels, **grid) -> dict:
    return {"file": Volume(array, **grid), "role": "label", "labels": labels}


def density_field(array, values=(0.0, 1.0), opacities=(0.0, 0.5), colors=(GREEN, GREEN), **grid):
    points = [
        {"value": float(v), "opacity": float(o), "color": [float(part) for part in c]}
        for v, o, c in zip(values, opacities, colors)
    ]
    return {"file": Volume(array, **grid), "role": "density", "points": points}


def mask_field(array, threshold=0.5, keep="above", **grid) -> dict:
    volume = Volume(array, **grid)
    return {"file": volume, "role": "mask", "threshold": threshold, "keep": keep}


def colored(label: int, color=BLUE, opacity=1.0) -> dict:
    return {"label": label, "color": [float(part) for part in color], "opacity": opacity}


def through(context, axis, *fields, volume=None, function=None, **tables):
    """The picture [5, 5, 4] of the block's middle, rays along ``axis`` (0 is x)."""
    tables |= {"camera": axis_camera((8.3, 8.2, 8.1), axis, height=1.5), "field": fields}
    function = function or constant_function(0.1, (1.0, 0.0, 0.0))
    resolved = scene(volume or block(), function, image={"width": 5, "height": 5}, **tables)
    return picture(context, resolved).rgba


def halves(shape=(4, 4, 4), dtype=np.uint8, below=0, above=1) -> np.ndarray:
    """``above`` in the second half along x (the last axis), else ``below``."""
    array = np.full(shape, below, dtype)
    array[..., shape[-1] // 2 :] = above
    return array


# Labels


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_label_gives_color_and_factor_from_the_middle_between_voxels_on(context, dtype):
    # Four label voxels at x = -1, 5, 11, 17: the second label begins at 8.
    labels = [colored(3, BLUE, 0.5), colored(7, GREEN)]
    grid = {"spacing": (6.0, 7.0, 7.0), "origin": (-1.0, -2.0, -2.0)}
    rgba = through(context, 0, label_field(halves(dtype=dtype, below=5, above=3), labels, **grid))
    first, second = absorbed(0.1, 8.0), absorbed(0.1, 4.0)
    np.testing.assert_allclose(rgba[..., 0], first, atol=2e-6)
    np.testing.assert_allclose(rgba[..., 1], 0.0)
    np.testing.assert_allclose(rgba[..., 2], (1 - first) * second, atol=2e-6)


def test_a_label_of_opacity_0_shows_nothing(context):
    grid = {"spacing": (20.0,) * 3, "origin": (-2.0,) * 3}
    field = label_field(np.full((2, 2, 2), 9, np.uint8), [colored(9, BLUE, 0.0)], **grid)
    rgba = through(context, 0, field)
    assert not rgba.any()


def test_a_label_is_of_a_place_in_the_world(context):
    """Rays along y through a volume that lies elsewhere, labels in slices across them."""
    grid = {"spacing": (0.5, 0.25, 0.125), "origin": (1000.0, -20.0, 7.0)}
    labels = np.zeros((1, 8, 1), np.int16)
    labels[0, 4:] = -3
    far = {"spacing": (50.0, 0.5, 50.0), "origin": (1000.0, -20.0, 7.0)}
    camera = axis_camera((1004.0, -18.0, 8.0), 1, height=0.2)
    resolved = scene(
        block(**grid), constant_function(0.3, (1.0, 0.0, 0.0)), camera=camera,
        image={"width": 3, "height": 3}, field=[label_field(labels, [colored(-3)], **far)],
    )  # fmt: skip
    rgba = picture(context, resolved).rgba
    first, all_of_it = absorbed(0.3, 1.75), absorbed(0.3, 3.5)  # voxels 0 .. 7: y up to -16.5
    np.testing.assert_allclose(rgba[..., 0], first + absorbed_after(0.3, 3.5, 4.0), atol=3e-5)
    np.testing.assert_allclose(rgba[..., 2], all_of_it - first, atol=3e-5)


def absorbed_after(opacity, start, end):
    return absorbed(opacity, end) - absorbed(opacity, start)


@pytest.mark.parametrize("size", [(1, 1, 1), (1, 2, 1), (2, 1, 1), (1, 1, 3)])
def test_tiny_label_grids_cover_what_lies_between_their_voxels(context, size):
    """An axis of one voxel is a slab as thick as the voxel; rays run along x."""
    spacing, origin = (4.0, 40.0, 40.0), (6.0, -10.0, -10.0)
    if size[1] == 1:
        origin = (6.0, 8.0, -10.0)
    if size[0] == 1:
        origin = (*origin[:2], 8.0)
    rgba = through(context, 0, label_field(np.ones(size, np.uint8), [colored(1)],
                                           spacing=spacing, origin=origin))  # fmt: skip
    n = size[2]
    start, end = (4.0, 8.0) if n == 1 else (6.0, 6.0 + 4.0 * (n - 1))
    labelled = absorbed_after(0.1, start, end)
    np.testing.assert_allclose(rgba[..., 2], labelled, atol=2e-6)
    np.testing.assert_allclose(rgba[..., 0], absorbed(0.1, LENGTH) - labelled, atol=2e-6)


@pytest.mark.parametrize("count", [1, 4096, 60000])
def test_thousands_of_labels_have_each_its_own_color(context, count):
    rng, n = np.random.default_rng(count), 64
    numbers = np.sort(rng.choice(np.arange(-30000, 32000), count, replace=False))
    chosen = rng.integers(0, count, (n, n))
    colors = rng.uniform(0.0, 1.0, (count, 3)).round(4)
    labels = [colored(int(number), color) for number, color in zip(numbers, colors)]
    field = label_field(numbers[chosen][None].astype(np.int16), labels, spacing=(1.0, 1.0, 10.0))
    resolved = scene(
        np.ones((2, n, n), np.float32), constant_function(0.9, (1.0, 1.0, 1.0)), field=[field],
        camera=axis_camera((31.5, 31.5, 0.5), 2, height=float(n)), image={"width": n, "height": n},
    )  # fmt: skip
    places = np.rint(resolved.camera.world_rays(n, n)[0]).astype(int)
    expected = 0.9 * resolved.fields[0].colors[chosen[places[..., 1], places[..., 0]]]
    np.testing.assert_allclose(picture(context, resolved).rgba[..., :3], expected, atol=1e-6)


# Densities


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_density_adds_its_extinction_and_emission(context, dtype):
    high = 1 if dtype.startswith("float") else 100
    array = np.full((2, 2, 2), high, dtype)
    field = density_field(array, (0, high), (0.0, 0.5), origin=(4.0, -9.0, -9.0),
                          spacing=(6.0, 30.0, 30.0))  # fmt: skip
    rgba = through(context, 0, field)
    red, green = -np.log1p(-0.1), -np.log1p(-0.5)
    both = -np.expm1(-6.0 * (red + green))
    before, after = absorbed(0.1, 4.0), absorbed(0.1, 6.0)
    left = np.exp(-4.0 * red)
    opacity = 1 - np.exp(-LENGTH * red - 6.0 * green)
    through_both = left * (1 - both)
    np.testing.assert_allclose(rgba[..., 3], opacity, atol=3e-6)
    share = red / (red + green)
    seen = [before + left * both * share + through_both * after, left * both * (1 - share)]
    np.testing.assert_allclose(rgba[..., :2], np.broadcast_to(seen, (5, 5, 2)), atol=3e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_density_shows_where_the_volume_is_transparent(context, kind):
    array = np.zeros((50, 50, 50), np.float32)
    hidden = TransferFunction([0.0, 1.0], [0.0, 0.0], [[1.0, 1.0, 1.0]] * 2)
    density = np.zeros((6, 6, 6), np.uint8)
    density[2, 3, 2] = 255
    grid = {"spacing": (7.1,) * 3, "origin": (3.0, 4.0, 5.0)}
    field = density_field(density, (100.0, 255.0), (0.0, 0.8), **grid)
    resolved = scene(array, hidden, field=[field], image={"width": 24, "height": 18},
                     integration={"classification": kind})  # fmt: skip
    leaping, marching = (picture(context, resolved, skip=skip) for skip in (True, False))
    assert leaping.rgba[..., 3].max() > 0.1
    assert np.array_equal(leaping.rgba, marching.rgba)
    assert leaping.samples < 0.5 * marching.samples
    np.testing.assert_allclose(leaping.rgba, render_twin(resolved), atol=1e-5)


def test_where_a_density_is_no_number_there_is_none(context):
    array = np.full((2, 2, 3), 1.0, np.float32)
    array[..., 2] = np.nan  # from x = 8 on
    grid = {"spacing": (8.0, 30.0, 30.0), "origin": (0.0, -9.0, -9.0)}
    rgba = through(context, 0, density_field(array, **grid))
    red, green = -np.log1p(-0.1), -np.log1p(-0.5)
    np.testing.assert_allclose(rgba[..., 3], 1 - np.exp(-LENGTH * red - 8.0 * green), atol=2e-6)
    array[:] = np.nan
    array[0, 0, 0] = 0.5
    grid = {"spacing": (8.0, 9.0, 30.0), "origin": (0.0, 8.0, -9.0)}
    rgba = through(context, 0, density_field(array, **grid))
    np.testing.assert_allclose(rgba[..., 3], absorbed(0.1, LENGTH), atol=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("count", [9, 40])
def test_a_density_has_a_table_of_its_own_width(context, count):
    """Registers hold a volume's function of 17 to 256 pieces, whatever the density's has."""
    values = np.linspace(0.0, 2.0, count)
    many = TransferFunction(values, np.full(count, 0.1), np.full((count, 3), [1.0, 0.0, 0.0]))
    field = density_field(np.ones((2, 2, 2), np.uint8), spacing=(16.0,) * 3)
    rgba = through(context, 0, field, function=many)
    both = -np.log1p(-0.1) - np.log1p(-0.5)
    np.testing.assert_allclose(rgba[..., 3], -np.expm1(-LENGTH * both), atol=3e-6)


@pytest.mark.slow
def test_gradients_of_the_volume_do_not_weight_a_density(context):
    field = density_field(np.ones((2, 2, 2), np.uint8), spacing=(16.0,) * 3)
    ramp = np.broadcast_to(np.arange(SIZE, dtype=np.float32), (SIZE, SIZE, SIZE))
    factor = {"points": [{"magnitude": 0.5, "opacity": 1.0}, {"magnitude": 0.5, "opacity": 0.0}]}
    volume = Volume(np.ascontiguousarray(ramp))
    rgba = through(context, 0, field, volume=volume, gradient_opacity=factor)
    np.testing.assert_allclose(rgba[..., 3], absorbed(0.5, LENGTH), atol=2e-6)
    assert not rgba[..., 0].any()


# Masks


def slope_mask(threshold, keep="above", dtype=np.float32) -> dict:
    """A mask that rises from 0 at x = -2 to 120 at x = 18."""
    ramp = np.broadcast_to(np.array([0, 60, 120], dtype), (2, 2, 3))
    grid = {"spacing": (10.0, 30.0, 30.0), "origin": (-2.0, -9.0, -9.0)}
    return mask_field(np.ascontiguousarray(ramp), threshold, keep, **grid)


@pytest.mark.parametrize(
    "dtype, step", [("uint8", 0.3), ("uint8", 2.5), *((dtype, 1.0) for dtype in DTYPES)]
)
def test_a_mask_cuts_segments_where_it_crosses_its_threshold(context, dtype, step):
    tables = {"integration": {"step": step}}
    for threshold in (20.0, 43.5, 99.0):
        at = threshold / 6.0 - 2.0
        rgba = through(context, 0, slope_mask(threshold, dtype=dtype), **tables)
        np.testing.assert_allclose(rgba[..., 3], absorbed(0.1, LENGTH - at), atol=3e-6)
        rgba = through(context, 0, slope_mask(threshold, "below", dtype), **tables)
        np.testing.assert_allclose(rgba[..., 3], absorbed(0.1, at), atol=3e-6)


def test_masks_together_keep_what_all_of_them_keep(context):
    rgba = through(context, 0, slope_mask(30.0), slope_mask(90.0, "below"))
    np.testing.assert_allclose(rgba[..., 3], absorbed(0.1, 10.0), atol=3e-6)


@pytest.mark.parametrize("hole", [False, True])
def test_outside_a_masks_grid_and_where_it_is_no_number_nothing_is_kept(context, hole):
    array = np.ones((2, 2, 4), np.float32)
    if hole:
        array[..., 3] = np.nan
    grid = {"spacing": (4.0, 30.0, 30.0), "origin": (4.0, -9.0, -9.0)}
    field = mask_field(array if hole else array[..., :3], **grid)
    rgba = through(context, 0, field)  # the grid, or what is a number in it, ends at 12
    np.testing.assert_allclose(rgba[..., 3], absorbed(0.1, 8.0), atol=3e-6)


@pytest.mark.parametrize("keep, shown", [("above", 1.0), ("below", 0.0)])
def test_a_mask_removes_surfaces(context, keep, shown):
    ramp = np.broadcast_to(np.arange(SIZE, dtype=np.float32), (SIZE, SIZE, SIZE))
    hidden = TransferFunction([0.0], [0.0], [[1.0, 1.0, 1.0]])
    surface = {"value": 11.4, "color": [0.0, 1.0, 0.0], "opacity": 1.0}
    # The threshold is crossed at x = 11.
    rgba = through(context, 0, slope_mask(78.0, keep), volume=Volume(np.ascontiguousarray(ramp)),
                   function=hidden, isosurface=[surface])  # fmt: skip
    np.testing.assert_allclose(rgba[..., 3], shown, atol=1e-6)


@pytest.mark.slow
def test_a_mask_over_surfaces_and_volume_leaves_no_haze_where_it_removes(context):
    ramp = np.broadcast_to(np.arange(SIZE, dtype=np.float32), (SIZE, SIZE, SIZE))
    surface = {"value": 3.4, "color": [0.0, 1.0, 0.0], "opacity": 0.7}
    rgba = through(context, 0, slope_mask(78.0), volume=Volume(np.ascontiguousarray(ramp)),
                   isosurface=[surface])  # fmt: skip
    np.testing.assert_allclose(rgba[..., 3], absorbed(0.1, 5.0), atol=3e-6)
    assert not rgba[..., 1].any()


# All of them


def some_fields() -> list[dict]:
    rng = np.random.default_rng(5)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned[:, 2] *= np.sign(np.linalg.det(turned))
    middle = np.array([8.0, 7.0, 7.0])
    turned_grid = {"spacing": (3.1, 3.3, 2.7), "direction": turned}
    size = np.array([5, 6, 5])
    turned_grid["origin"] = tuple(middle - turned @ (0.5 * (size - 1) * turned_grid["spacing"]))
    labels = [colored(1, RED), colored(3, GREEN, 0.3), colored(4, BLUE, 0.0)]
    density = rng.uniform(0.0, 1.0, size[::-1])
    mask = rng.integers(0, 255, (6, 6, 7)).astype(np.uint8)
    shifted = {"spacing": (2.9, 3.1, 2.7), "origin": (0.37, -0.41, -0.33)}
    return [
        label_field(rng.integers(0, 5, (7, 6, 5)).astype(np.int16), labels, **shifted),
        density_field(density, (0.2, 0.5, 0.8), (0.0, 0.3, 0.1), (RED, GREEN, BLUE), **turned_grid),
        mask_field(mask, 110.0, "below", **shifted),
    ]


def wavy(kind, fields, **tables):
    function = TransferFunction([0.0, 60.0, 255.0], [0.0, 0.05, 0.3], np.eye(3))
    tables = {"image": {"width": 20, "height": 16}, "gradient": {"storage": "on-the-fly"}, **tables}
    return scene(waves((15, 14, 18)), function, field=fields,
                 integration={"classification": kind, "step": 0.7}, **tables)  # fmt: skip


@pytest.mark.parametrize("which", [(0,), (1,), (2,), (0, 1, 2)])
def test_fields_agree_with_the_definition(context, which):
    fields = some_fields()
    resolved = wavy("post", [fields[k] for k in which])
    leaping, marching = (picture(context, resolved, skip=skip) for skip in (True, False))
    np.testing.assert_allclose(leaping.rgba, render_twin(resolved), atol=2e-5)
    assert np.array_equal(leaping.rgba, marching.rgba)
    assert leaping.counters["field_samples"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_fields_lights_and_factors_go_together(context, kind):
    factor = {"points": [{"magnitude": 0.0, "opacity": 0.3}, {"magnitude": 20.0, "opacity": 1.0}]}
    light = [{"type": "directional", "direction": (-1.0, -0.5, -0.2)}]
    resolved = wavy(kind, some_fields(), gradient_opacity=factor, light=light)
    atol = 2e-5 if kind != "preintegrated" else 3e-4  # of a table over both ends of a segment
    one, many = (picture(context, resolved, lanes=lanes) for lanes in (1, 16))
    np.testing.assert_allclose(many.rgba, render_twin(resolved), atol=atol)
    np.testing.assert_allclose(one.rgba, many.rgba, atol=1e-6)
    assert one.counters == many.counters


@pytest.mark.slow
@pytest.mark.parametrize("method", ["rays", "volume"])
def test_shadows_are_of_fields_too(context, method):
    """The volume's and a density's, masked; both march midpoints."""
    light = [{"type": "directional", "direction": (-1.0, -0.5, -0.2)}]
    shadow = {"method": method, "step": 1.0, "bound": 0.0, "resolution": 12}
    factor = {"points": [{"magnitude": 0.0, "opacity": 0.3}, {"magnitude": 20.0, "opacity": 1.0}]}
    layers = [{"magnitude": 10.0, "points": [{"value": 50.0, "opacity": 0.4, "color": [1, 0, 0]}]}]
    resolved = wavy("post", some_fields(), light=light, shadow=shadow, gradient_opacity=factor,
                    transfer_layer=layers)  # fmt: skip
    seen = picture(context, resolved)
    np.testing.assert_allclose(seen.rgba, render_twin(resolved), atol=2e-4)
    bare = picture(context, replace(resolved, shadow=None))
    assert rms(seen.rgba, bare.rgba) > 5e-3


@pytest.mark.slow
def test_a_mask_takes_a_surfaces_shadow_with_it(context):
    """A sheet above a thin fog: where the mask removes the sheet, the fog is in light."""
    ramp = np.broadcast_to(np.arange(SIZE, dtype=np.float32), (SIZE, SIZE, SIZE))
    tables = {
        "light": [{"type": "directional", "direction": (1.0, 0.0, 0.0)}],
        "shadow": {"method": "rays", "bound": 0.0}, "gradient": {"storage": "on-the-fly"},
        "isosurface": [{"value": 5.4, "color": [0.0, 1.0, 0.0], "opacity": 0.6}],
        "material": {"ambient": 0.0, "diffuse": 1.0, "specular": 0.0},
        "camera": axis_camera((8.3, 8.2, 8.1), 2, height=14.0), "image": {"width": 7, "height": 7},
    }  # fmt: skip
    kept = np.repeat(np.array([0, 1], np.uint8), 4).reshape(2, 2, 2)  # from z = 8 on
    mask = mask_field(kept, spacing=(60.0, 60.0, 16.0), origin=(-30.0, -30.0, 0.0))
    volume = Volume(np.ascontiguousarray(ramp))
    function = constant_function(0.02, (1.0, 1.0, 1.0))
    resolved = scene(volume, function, field=[mask], **tables)
    np.testing.assert_allclose(picture(context, resolved).rgba, render_twin(resolved), atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["maximum", "minimum", "average", "attenuated-maximum"])
def test_projections_see_what_masks_keep(context, mode):
    function = TransferFunction([0.0, 60.0, 255.0], [0.1, 0.3, 0.9], np.eye(3))
    resolved = scene(
        waves((15, 14, 18)), function, field=[some_fields()[2]], image={"width": 20, "height": 16},
        integration={"compositing": mode, "step": 0.7},
    )  # fmt: skip
    leaping, marching = (picture(context, resolved, skip=skip) for skip in (True, False))
    np.testing.assert_allclose(leaping.rgba, render_twin(resolved), atol=2e-5)
    assert np.array_equal(leaping.rgba, marching.rgba)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_leaping_over_what_fields_do_not_show_changes_no_bit(context, seed):
    rng = np.random.default_rng(seed)
    array = np.zeros((33, 41, 50), np.float32)
    turned = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    density = (rng.uniform(0.0, 1.0, rng.integers(1, 12, 3)) > 0.9).astype(np.float32)
    spacing = rng.uniform(0.3, 9.0, 3)
    origin = rng.uniform(5.0, 25.0, 3)
    mask = (rng.uniform(0.0, 1.0, (9, 9, 9)) > 0.8).astype(np.uint8)
    fields = [
        density_field(density, direction=turned, spacing=spacing, origin=origin),
        mask_field(mask, 0.3, "above" if seed % 2 else "below", spacing=(6.0, 5.0, 4.0)),
    ]
    hidden = TransferFunction([0.0], [0.0], [[1.0, 1.0, 1.0]])
    resolved = scene(array, hidden, field=fields, image={"width": 32, "height": 24})
    leaping, marching = (picture(context, resolved, skip=skip) for skip in (True, False))
    assert np.array_equal(leaping.rgba, marching.rgba)


@pytest.mark.parametrize("seed", range(5))
def test_bounds_around_a_place_hold_all_voxels_near_it(seed):
    rng = np.random.default_rng(seed)
    voxels = rng.normal(size=rng.integers(2, 9, 3)).astype(np.float32)
    voxels[rng.uniform(size=voxels.shape) > 0.9] = np.nan
    matrix, shift = rng.normal(size=(3, 3)), rng.uniform(-3.0, 6.0, 3)
    cells = (2, 3, 2)
    low, high = bounds_around(voxels, *cell_boxes(cells, matrix, shift))
    upper = np.array(voxels.shape[::-1]) - 1
    for z, y, x in np.ndindex(*cells[::-1]):
        places = (8.0 * np.array([x, y, z]) + rng.uniform(0.0, 8.0, (300, 3))) @ matrix.T + shift
        places = places[np.all((places >= 0) & (places <= upper), axis=1)]
        for place in places:
            base = np.floor(place).astype(int)
            near = voxels[tuple(slice(b, b + 2) for b in base[::-1])]
            if np.isfinite(near).any():
                assert low[z, y, x] <= np.nanmin(near) and np.nanmax(near) <= high[z, y, x]


def test_fields_beyond_a_buffer_are_refused_in_one_line():
    resolved = scene(np.ones((3, 3, 3)), field=[mask_field(np.ones((5, 5, 5), np.uint8), 0.5)])
    small = SimpleNamespace(device=SimpleNamespace(max_mem_alloc_size=499), name="toy")
    with pytest.raises(VolumeError, match="500 bytes") as caught:
        SceneFields(small, resolved, (1, 1, 1), len, {})
    assert "\n" not in str(caught.value)


def test_fields_count_for_the_memory_cap():
    array, mask = np.ones((3, 3, 3), np.uint8), np.ones((50, 50, 50), np.uint8)
    bare, masked = scene(array), scene(array, field=[mask_field(mask, 0.5)])
    image = bare.image
    cap = scene_bytes(bare.volume, image.width, image.height)
    check_memory(bare, cap)
    check_memory(masked, cap + 4 * mask.size)
    with pytest.raises(VolumeError, match="memory cap"):
        check_memory(masked, cap + 4 * mask.size - 1)
