"""Catmull-Rom, and the prefilter of the cubic B-spline: fields that meet their voxels."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.field_points import TYPES, evaluate, lattice_points, rough, spline_at
from helpers.small_scenes import SMOOTH, axis_camera, make_scene, picture, rms, waves
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clvol import TransferFunction, Volume
from clvol.device import prefilter
from clvol.device.empty_space import visible_mask
from clvol.device.prefilter import coefficients, prefiltered
from clvol.device.transfer_lookup import scene_nodes
from clvol.device.volume import DeviceVolume
from clvol.errors import SceneError
from clvol.explanation import kernel_hash
from clvol.features import FILTERS, overshoot
from clvol.transfer.lookup_nodes import visible_cells

CLASSIFICATIONS = ("pre", "post", "preintegrated")
THIN = [(1, 8, 8), (8, 1, 8), (8, 8, 1), (1, 1, 1), (2, 2, 2), (3, 2, 5)]
ROUNDING = 1e-6
GREY = [[0.3, 0.5, 0.7]]
# Nothing is seen but what lies beyond voxels of 0 ... 255.
BEYOND = TransferFunction([-30, -10, 0, 255, 265, 300], [0.9, 0.5, 0, 0, 0.5, 0.9], GREY * 6)


def rom_scene(array, function=SMOOTH, **keys):
    return make_scene(array, function, filter="catmull-rom", **keys)


def values(context, array, at, filter="catmull-rom", lanes=16):
    return evaluate(context, array, "analytic", at, filter=filter, lanes=lanes)


def voxel_points(shape):
    """Every voxel's (x, y, z), float32 [n, 3], repeated to a multiple of 16."""
    at = np.argwhere(np.ones(shape))[:, ::-1].astype(np.float32)
    return np.resize(at, (-(-len(at) // 16) * 16, 3))


def at_voxels(array, at):
    return array[tuple(at[:, ::-1].astype(int).T)].astype(np.float64)


# --- Catmull-Rom -----------------------------------------------------------------------------------


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize("dtype", TYPES)
def test_catmull_rom_meets_every_voxel(context, dtype, lanes):
    array = rough((6, 7, 9), dtype, *((-100, 100) if np.dtype(dtype).kind == "i" else (0, 255)))
    at = voxel_points(array.shape)
    _, found, resident = values(context, array, at, lanes=lanes)
    gain = resident.values.gain
    np.testing.assert_allclose(found, resident.values(at_voxels(array, at)), atol=4e-7 * 255 * gain)
    _, smooth, _ = values(context, array, at, "cubic")
    assert np.abs(smooth - found).max() > 0.05 * np.ptp(found)


@pytest.mark.parametrize("shape", THIN)
def test_catmull_rom_of_thin_volumes(context, shape):
    array = rough(shape, np.uint16)
    at = lattice_points(shape, 64)
    _, found, _ = values(context, array, at)
    held = np.minimum(at, np.array(shape[::-1]) - 1).astype(np.float64)
    np.testing.assert_allclose(found, spline_at(array, held, "catmull-rom"), atol=ROUNDING * 255)


def test_catmull_rom_reproduces_quadratics_away_from_the_faces(context):
    def field(x, y, z):
        return 3 + x * x - 2 * y * z + 0.5 * z * z * (1 + x) - y * y * x + y

    z, y, x = np.indices((8, 8, 8)).astype(np.float64)
    at = 1 + lattice_points((6, 6, 6))
    array = field(x, y, z).astype(np.float32)
    slopes, found, _ = values(context, array, at)
    x, y, z = at.T.astype(np.float64)
    largest = 300.0
    np.testing.assert_allclose(found, field(x, y, z), atol=ROUNDING * largest)
    exact = np.stack(
        [2 * x + 0.5 * z * z - y * y, 1 - 2 * z - 2 * y * x, z * (1 + x) - 2 * y], axis=-1
    )
    np.testing.assert_allclose(slopes, exact, atol=3 * ROUNDING * largest)
    _, smooth, _ = values(context, array, at, "cubic")
    assert np.abs(smooth - found).max() > 0.1


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    bits=st.integers(0, 2**64 - 1), low=st.integers(0, 254), seed=st.integers(0, 2**31),
    dtype=st.sampled_from([np.uint8, np.float32]),
)  # fmt: skip
def test_catmull_rom_never_leaves_its_bound(context, bits, low, seed, dtype):
    high = 255
    array = np.where([bits >> k & 1 for k in range(64)], high, low).reshape(4, 4, 4).astype(dtype)
    _, found, _ = values(context, array, lattice_points((4, 4, 4), 64, seed))
    more = overshoot("catmull-rom") * (high - low) + ROUNDING * high
    assert low - more <= found.min() and found.max() <= high + more


def test_the_bound_of_catmull_rom_is_met(context):
    """In the middle of a cell, where the voxels are high just where weights are positive."""
    sign = np.array([-1, 1, 1, -1])
    positive = sign[:, None, None] * sign[:, None] * sign > 0
    middle = np.full((16, 3), 1.5, np.float32)
    for array, end, way in ((positive, 1.0, 1), (~positive, 0.0, -1)):
        _, found, _ = values(context, array.astype(np.float32), middle)
        np.testing.assert_allclose(found, end + way * overshoot("catmull-rom"), rtol=1e-6)
    assert {name for name in FILTERS if not overshoot(name)} == {"nearest", "linear", "cubic"}


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_under_catmull_rom_a_voxel_of_weight_0_does_not_count(context, bad, dtype, lanes):
    array = rough((7, 7, 7), dtype)
    holes = [(3, 3, 3), (0, 6, 0), (6, 2, 6)]
    for hole in holes:
        array[hole] = bad
    at = lattice_points(array.shape, 2048)
    _, found, resident = values(context, array, at, lanes=lanes)
    marked = np.zeros(array.shape)
    for hole in holes:
        marked[hole] = 1
    # The weight of a hole at a point is the filter's value of a single 1.
    spoilt = np.zeros(len(at), bool)
    for hole in holes:
        one = np.zeros(array.shape)
        one[hole] = 1
        spoilt |= np.abs(spline_at(one, at.astype(np.float64), "catmull-rom")) > 1e-12
    assert spoilt.any() and not np.isfinite(found[spoilt]).any()
    wanted = spline_at(np.where(marked, 0, array), at.astype(np.float64), "catmull-rom")
    np.testing.assert_allclose(
        found[~spoilt], resident.values(wanted[~spoilt]), atol=ROUNDING * 255 * resident.values.gain
    )


# --- pictures under Catmull-Rom --------------------------------------------------------------------


@pytest.mark.parametrize("classification", ["post", "preintegrated"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_values_beyond_the_data_get_the_transfer_functions_own(context, classification, dtype):
    """A field that is constant along z: each ray's opacity is in closed form."""
    columns = 255 * rough((9, 9), dtype, 0, 1)
    array = np.repeat(columns[None], 5, axis=0)
    camera = axis_camera([4, 4, 2], axis=2, height=8.0)
    for function in (SMOOTH, BEYOND):
        scene = rom_scene(array, function, camera=camera, width=40, height=40, step=0.5,
                          classification=classification, table_size=256)  # fmt: skip
        alpha = picture(context, scene).rgba[..., 3]
        origins, _ = scene.camera.world_rays(40, 40)
        at = origins.reshape(-1, 3).copy()
        at[:, 2] = 2.0
        field = spline_at(array, at, "catmull-rom")
        opacity = np.interp(field, function.values, function.opacities)
        wanted = 1 - (1 - opacity) ** (4 / function.opacity_unit)
        assert field.min() < -20 and field.max() > 275 and wanted.max() > 0.3
        assert rms(alpha.ravel(), wanted) < 2e-3, rms(alpha.ravel(), wanted)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32])
def test_leaping_changes_no_bit_under_catmull_rom(context, classification, dtype):
    array = np.zeros((70, 60, 50), dtype)
    array[9, 17, 33] = 255  # a voxel inside a cell is seen in the cell before
    array[23, 39, 15] = 255  # and in the one behind
    array[50:60, 40:55, 5:9] = rough((10, 15, 4), dtype)
    ramp = TransferFunction([20, 30, 255], [0, 0.02, 0.5], GREY * 3)
    # Of floats as near to a control point as the background is to 0 none can be told transparent.
    shift = 5 * np.sign(BEYOND.values - 100) * (dtype == np.float32)
    beyond = TransferFunction(BEYOND.values + shift, BEYOND.opacities, BEYOND.colors)
    for function in (ramp, beyond):
        scene = rom_scene(array, function, width=64, height=64, classification=classification,
                          step=0.6)  # fmt: skip
        leaping, walking = (picture(context, scene, skip=skip) for skip in (True, False))
        if classification == "pre" and function is beyond:  # voxels are classified
            assert not leaping.rgba.any()
            continue
        assert leaping.rgba.max() > 0.05
        assert np.array_equal(leaping.rgba, walking.rgba)
        assert np.array_equal(leaping.depth, walking.depth)
        assert leaping.samples < 0.5 * walking.samples


def test_what_overshoots_is_not_leapt_over(context):
    """Cells whose voxels are all transparent, and whose samples are not."""
    array = np.zeros((33, 33, 33), np.uint8)
    array[16, 16, 16] = 255
    seen = {}
    for name in ("linear", "catmull-rom"):
        scene = make_scene(array, BEYOND, filter=name)
        nodes = scene_nodes(scene)
        visible = visible_cells(BEYOND, nodes.values)
        at = BEYOND.opacity(nodes.values) > 0
        seen[name] = visible_mask(DeviceVolume(context, scene.volume), name, nodes, visible, at)
    assert not seen["linear"].any()
    assert 1 <= seen["catmull-rom"].sum() <= 27


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_a_packet_and_a_single_ray_agree_under_catmull_rom(context, classification):
    scene = rom_scene(waves((21, 19, 23)), classification=classification)
    packet, single = (picture(context, scene, lanes=lanes) for lanes in (16, 1))
    assert packet.rgba[..., 3].max() > 0.1
    np.testing.assert_allclose(packet.rgba, single.rgba, atol=2e-5)


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
def test_a_constant_field_is_exactly_constant_under_catmull_rom(context, classification):
    array = np.full((6, 7, 8), 77, np.uint8)
    function = TransferFunction([70, 77, 90], [0.1, 0.35, 0.2], GREY * 3)
    linear, rom = (
        picture(context, make_scene(array, function, filter=name, classification=classification))
        for name in ("linear", "catmull-rom")
    )
    assert linear.rgba[..., 3].max() > 0.5
    np.testing.assert_allclose(rom.rgba, linear.rgba, atol=2e-6)


def test_each_filter_is_a_kernel_of_its_own():
    array = waves((8, 8, 8), np.uint8)
    named = {name: {"filter": name} for name in FILTERS}
    named["table"]["filter_table"] = [1.0, 0.5, 0.1, 0.0]
    assert len({kernel_hash(make_scene(array, **asked)) for asked in named.values()}) == len(FILTERS)


# --- the prefilter ---------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(9, 8, 7), *THIN])
@pytest.mark.parametrize("dtype", TYPES)
def test_prefiltered_the_b_spline_meets_every_voxel(context, shape, dtype):
    array = rough(shape, dtype, *((-100, 100) if np.dtype(dtype).kind == "i" else (0, 255)))
    found_in = Volume(coefficients(Volume(array)))
    assert found_in.dtype == (np.float64 if dtype == np.float64 else np.float32)
    at = voxel_points(shape)
    _, found, resident = values(context, found_in, at, "cubic")
    # Coefficients reach farther than the voxels do: rounding is that of the larger ones.
    largest = max(abs(v) for v in found_in.value_range)
    gain = resident.values.gain
    np.testing.assert_allclose(found, resident.values(at_voxels(array, at)),
                               atol=2 * ROUNDING * largest * gain)  # fmt: skip
    exact = spline_at(coefficients(Volume(array.astype(np.float64))), at.astype(float), "cubic")
    np.testing.assert_allclose(exact, at_voxels(array, at), atol=1e-11)


@pytest.mark.parametrize("magnitude", [1e-42, 3e38])
def test_extreme_magnitudes_are_prefiltered_in_double_precision(magnitude):
    array = (waves((5, 6, 7), np.float64, -1, 1) * magnitude).astype(np.float32)
    found = coefficients(Volume(array))
    assert found.dtype == np.float64 and np.isfinite(found).all()
    at = voxel_points(array.shape)
    np.testing.assert_allclose(spline_at(found, at.astype(float), "cubic"), at_voxels(array, at),
                               rtol=0, atol=1e-12 * magnitude)  # fmt: skip


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_holes_stay_and_hurt_no_more_than_they_did(dtype):
    array = waves((12, 13, 14), dtype)
    holes = [(5, 6, 7), (0, 12, 13)]
    for hole, bad in zip(holes, (np.nan, -np.inf)):
        array[hole] = bad
    found = coefficients(Volume(array))
    assert np.array_equal(np.isfinite(found), np.isfinite(array))
    assert np.isnan(found[holes[0]]) and found[holes[1]] == -np.inf
    whole = coefficients(Volume(waves((12, 13, 14), dtype)))
    indices = np.indices(array.shape)
    away = [np.abs(indices - np.reshape(hole, (3, 1, 1, 1))).max(0) for hole in holes]
    assert np.abs(found - whole)[np.min(away, 0) > 6].max() < 1e-3 * np.nanmax(np.abs(whole))
    assert not np.isfinite(coefficients(Volume(np.full((3, 3, 3), np.nan, dtype)))).any()


def test_the_filter_takes_no_more_memory_than_its_coefficients_and_a_chunk(monkeypatch):
    import tracemalloc

    monkeypatch.setattr(prefilter, "_CHUNK", 6000)
    volume = Volume(rough((60, 70, 80), np.uint8))
    volume.value_range  # found once, for other reasons
    tracemalloc.start()
    found = coefficients(volume)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.nbytes <= peak < 1.3 * found.nbytes


def test_prefiltering_is_done_where_it_is_asked_for():
    array = waves((9, 8, 7), np.uint8)
    for filter in ("linear", "cubic", "catmull-rom"):
        scene = make_scene(array, filter=filter)
        assert prefiltered(scene) is scene
    scene = make_scene(array, filter="cubic", prefilter=True)
    other = prefiltered(scene)
    assert other.volume.dtype == np.float32 and other.volume.grid == scene.volume.grid
    assert other.transfer_function is scene.transfer_function


@pytest.mark.parametrize("filter", sorted(set(FILTERS) - {"cubic"}))
def test_prefiltering_is_refused_where_voxels_are_met_without(filter):
    more = {"filter_table": [1.0, 0.5, 0.1, 0.0]} if filter == "table" else {}
    with pytest.raises(SceneError, match="integration.prefilter: got true, expected"):
        make_scene(waves((9, 8, 7), np.uint8), filter=filter, prefilter=True, **more)


def test_a_prefiltered_picture_is_nearer_to_the_fields_that_voxels_sample(context):
    """Of a smooth field the B-spline through the voxels is far better than the one beside them."""

    def picture_of(scale, **keys):
        z, y, x = (np.linspace(0, 1, (n - 1) * scale + 1) for n in (17, 18, 19))
        wave = np.cos(9 * x) * np.cos(8 * y)[:, None] * np.cos(7 * z)[:, None, None]
        array = (127 + 120 * wave).astype(np.float32)
        scene = make_scene(Volume(array, [1 / scale] * 3), step=0.5 * scale,
                           classification="post", **keys)  # fmt: skip
        return picture(context, prefiltered(scene)).rgba

    exact = picture_of(4, filter="catmull-rom")
    errors = {
        name: rms(picture_of(1, **keys), exact)
        for name, keys in {
            "beside": {"filter": "cubic"},
            "linear": {"filter": "linear"},
            "through": {"filter": "cubic", "prefilter": True},
            "catmull-rom": {"filter": "catmull-rom"},
        }.items()
    }
    assert errors["through"] < 0.3 * errors["linear"] < 0.3 * errors["beside"], errors
    assert errors["catmull-rom"] < 0.3 * errors["linear"], errors
