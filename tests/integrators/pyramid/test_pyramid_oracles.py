"""Oracles: their maps beside what numpy finds cell by cell, and oracles of a caller's own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.pyramid_scenes import SHELL, map_distances, pyramid_picture, pyramid_scene, rendered, twin_picture
from helpers.small_scenes import rms, waves

from clvol import TransferFunction
from clvol.errors import RenderError, SceneError
from clvol.integrators.pyramid import oracles as known
from clvol.integrators.pyramid.caster import PyramidCaster
from clvol.integrators.pyramid.cells import (
    distance_map,
    raise_to_ways,
    read_distances,
    upload_cells,
    upload_distances,
    voxels_bad_for_error,
    voxels_of_steep_opacity,
    way_map,
)
from clvol.integrators.pyramid.oracles import KERNEL_CUSTOM, MapOracle, Oracle, register
from clvol.integrators.pyramid.oracles.visible import visible_in_cells

SHAPE = (17, 14, 21)
EDGES = (1.0, 1.7, 2.3)  # smallest edges a voxel x, y, z
CODE = 1 / 16  # bytes have four binary digits after the first
GRID = {"spacing": EDGES}


@pytest.fixture
def asked(context):
    """Of a grid that is no cube, maps as fine as voxels."""
    array = waves(SHAPE)
    return PyramidCaster(context, pyramid_scene(array, SHELL, grid=GRID, camera=None)).march.asked


def ways(bad, edges=EDGES, cell=1) -> np.ndarray:
    """From each cell [z, y, x] to the nearest bad one: between the nearest points of both."""
    places = np.argwhere(bad)
    out = np.full(bad.shape, np.inf)
    for z, y, x in np.ndindex(bad.shape):
        apart = np.maximum(np.abs(places - (z, y, x)) - 1, 0) * np.array(edges)[::-1] * cell
        if len(places):
            out[z, y, x] = np.sqrt((apart**2).sum(axis=1).min())
    return out


def check_map(found, exact, unit=0.25) -> None:
    """Rounded down, by no more than bytes and whole units of squares make it."""
    assert (found <= exact + 1e-6).all()
    assert (found >= (exact - unit) * (1 - CODE) - 1e-6).all()


# Distances


def test_distances_are_the_least_of_half_a_scale_and_the_way(asked):
    rng = np.random.default_rng(1)
    scales = [1.0, 2.0, 4.0, 8.0]
    shape = asked.shape
    bits = np.zeros(shape, np.uint8)
    for bit in range(4):  # what is bad for a scale is bad for longer ones
        bits |= (rng.random(shape) < 0.004 * 2**bit).astype(np.uint8) * np.uint8(0xFF << bit & 0xFF)
    found = distance_map(asked, upload_cells(asked, bits), scales)
    exact = np.full(shape, asked.reach)
    for bit, scale in enumerate(scales):
        exact = np.minimum(exact, scale / 2 + ways(bits >> bit & 1))
    check_map(read_distances(asked.context, found, shape), exact)
    marked = np.zeros(shape, np.uint8)
    marked[3, 4, 5] = 1
    raise_to_ways(asked, upload_cells(asked, marked), 0, found)
    raised = np.maximum(exact, np.minimum(0.5 + ways(marked), asked.reach))
    check_map(read_distances(asked.context, found, shape), raised)


def test_without_bad_cells_distances_are_as_long_as_they_may_be(asked):
    none = upload_cells(asked, np.zeros(asked.shape, np.uint8))
    found = read_distances(asked.context, distance_map(asked, none, [1.0]), asked.shape)
    assert (found == asked.reach).all()
    everywhere = upload_cells(asked, np.ones(asked.shape, np.uint8))
    found = read_distances(asked.context, distance_map(asked, everywhere, [1.0]), asked.shape)
    assert (found == 0.5).all()


def test_ways_reach_farther_with_a_coarser_unit(asked):
    bits = np.zeros(asked.shape, np.uint8)
    bits[2, 3, 4] = bits[15, 0, 18] = 1
    found = read_distances(asked.context, way_map(asked, upload_cells(asked, bits), 250.0, 1.0), asked.shape)
    exact = ways(bits)
    assert (found <= exact + 1e-6).all() and (found >= (exact - 1.0) * (1 - CODE)).all()


@pytest.mark.parametrize("shape", [(5, 3, 2), (4, 8, 12), (1, 9, 6)])
def test_maps_from_the_host_are_read_back(context, shape):
    distances = np.random.default_rng(2).random(shape) * 60
    read = read_distances(context, upload_distances(context, distances), shape)
    assert (read <= distances).all() and (read >= distances * (1 - CODE) - 0.07).all()


@pytest.mark.parametrize(
    ("oracle", "function"),
    [("visible", "shell"), ("opacity-gradient", "shell"), ("opacity-gradient", "smooth"),
     ("bandwidth", "smooth"), ("error", "shell"), ("error", "smooth")],
)  # fmt: skip
def test_distances_grow_by_no_more_than_the_way(context, oracle, function):
    """What the march relies on to find what it synthesises fresh; but for rounding."""
    epsilon = 0.3 if oracle == "bandwidth" else 0.01
    more = {"function": SHELL} if function == "shell" else {}
    resolved = pyramid_scene(waves(SHAPE), grid=GRID, camera=None, oracle=oracle, epsilon=epsilon, **more)
    caster = PyramidCaster(context, resolved)
    found = map_distances(caster)
    assert found.max() > 0.5
    for axis, edge in enumerate(EDGES[::-1]):
        grows = np.abs(np.diff(found, axis=axis))
        nearer = np.minimum(np.delete(found, 0, axis), np.delete(found, -1, axis))
        assert (grows <= 2 * edge + 0.25 + CODE * (nearer + 2 * edge)).all()


# What each of them asks


def test_visible_is_what_a_cell_can_show(asked):
    """Values of the shell's function show between 150 and 180."""
    from clvol.integrators.pyramid.cells import padded_cells

    cells = padded_cells(asked)
    visible_in_cells(asked, cells)
    nz, ny, nx = asked.shape
    shown = asked.context.read(cells)[:nz, :ny, :nx].astype(bool)
    array = waves(SHAPE)
    low, high = (corner_extremes(array, f) for f in (np.minimum, np.maximum))
    inside = (low < 179.5) & (high > 150.5)
    assert shown[inside].all() and not shown[(low > 180.5) | (high < 149.5)].any()
    assert 0.05 < shown.mean() < 0.9


def corner_extremes(array, which):
    for axis in range(3):
        array = which(np.delete(array, 0, axis), np.delete(array, -1, axis))
    return array


def test_steep_voxels_are_those_whose_opacity_changes_by_more_than_epsilon(context):
    array = waves((30, 28, 33))
    caster = PyramidCaster(context, pyramid_scene(array, SHELL, oracle="opacity-gradient", epsilon=0.05))
    steep = context.read(voxels_of_steep_opacity(caster.march.asked)).astype(bool)
    opacity = SHELL.opacity(array)
    padded = np.pad(opacity, 1, mode="edge")
    middle = [slice(1, -1)] * 3
    square = 0.0
    for axis in range(3):
        ahead, behind = list(middle), list(middle)
        ahead[axis], behind[axis] = slice(2, None), slice(None, -2)
        square += ((padded[tuple(ahead)] - padded[tuple(behind)]) / 2) ** 2
    expected = np.sqrt(square)
    assert steep[expected > 0.056].all() and not steep[expected < 0.044].any()
    assert 0.02 < steep.mean() < 0.5


def test_voxels_are_bad_where_interpolation_would_show(context):
    """By the error oracle: where a segment of the interpolated value differs by epsilon from one of the voxel's, it
    must have said so. (It may say so elsewhere: it looks at all values in between.)"""
    array = waves((30, 28, 33)) + np.random.default_rng(4).normal(0, 6, (30, 28, 33)).astype(np.float32)
    epsilon = 0.03
    caster = PyramidCaster(context, pyramid_scene(array, SHELL, oracle="error", epsilon=epsilon))
    bits = context.read(voxels_bad_for_error(caster.march.asked))
    shares = []
    for bit, scale in enumerate(caster.march.asked.scales[:4]):
        half = max(int(scale / 2), 1)
        share = min(scale / 2 / half, 1.0)
        interpolated = array.astype(np.float64)
        for axis in range(3):
            index = np.arange(array.shape[axis])
            before = np.take(array, np.maximum(index - half, 0), axis)
            behind = np.take(array, np.minimum(index + half, array.shape[axis] - 1), axis)
            interpolated += share * ((before + behind) / 2.0 - array)
        differs = np.abs(shown(SHELL, array, scale) - shown(SHELL, interpolated, scale)).max(axis=-1)
        bad = (bits >> bit & 1).astype(bool)
        assert bad[differs > epsilon + 0.01].all()
        shares.append(bad.mean())
    assert 0.01 < shares[0] < shares[-1] < 0.9


def shown(function: TransferFunction, values, edges: float) -> np.ndarray:
    """Premultiplied colour and opacity of a segment of one value, ``edges`` long."""
    opacity = 1.0 - (1.0 - function.opacity(values)) ** edges
    return np.concatenate([function.color(values) * opacity[..., None], opacity[..., None]], axis=-1)


def test_bandwidth_is_right_about_the_data(context):
    """Where it allows a distance, all values nearer than half of that lie within epsilon of the range."""
    array = waves((40, 37, 45))
    caster = PyramidCaster(context, pyramid_scene(array, oracle="bandwidth", epsilon=0.2))
    found = map_distances(caster)
    rng = np.random.default_rng(5)
    many = 0
    for z, y, x in rng.integers(0, found.shape, (300, 3)):
        r = int(found[z, y, x] / 2 - 1e-9)  # whole voxels within
        if found[z, y, x] < 4:
            continue
        many += 1
        near = array[max(z - r, 0) : z + r + 1, max(y - r, 0) : y + r + 1, max(x - r, 0) : x + r + 1]
        # Half a scale, and the way to where it is bad: at most twice what is allowed.
        assert np.ptp(near) <= 2.5 * 0.2 * np.ptp(array)
    assert many > 20


@pytest.mark.parametrize("oracle", ["visible", "opacity-gradient", "bandwidth", "error"])
def test_no_oracle_steps_over_a_hole(context, oracle):
    array = waves((24, 22, 26))
    array[10, 11, 5:20:3] = np.nan
    caster = PyramidCaster(context, pyramid_scene(array, oracle=oracle, epsilon=0.3))
    found = map_distances(caster)
    assert (found[9:11, 10:12, 5:20:3] <= 1.0).all()
    picture, twin = rendered(caster), twin_picture(caster)
    assert np.isfinite(picture.rgba).all() and rms(picture.rgba, twin.rgba) < 1e-3


# Oracles of a caller's own


@pytest.fixture
def registered():
    """``registered(oracle)``: known for a test."""
    before = dict(known._known)
    yield register
    known._known.clear()
    known._known.update(before)


class _Everywhere(MapOracle):
    name = "everywhere"
    takes_epsilon = False

    def distances(self, asked):
        return np.full(asked.shape, 6.0)


def test_an_oracle_from_python(context, registered):
    with pytest.raises(SceneError, match="everywhere"):
        refused(pyramid_scene(oracle="everywhere"))
    registered(_Everywhere())
    assert "everywhere" in known.names()
    caster = PyramidCaster(context, pyramid_scene(oracle="everywhere"))
    assert (map_distances(caster) == 6.0).all()
    few, all_ = rendered(caster), pyramid_picture(context, pyramid_scene(oracle="minimum"))
    assert few.samples < 0.4 * all_.samples and rms(few.rgba, all_.rgba) < 0.02
    assert rms(few.rgba, twin_picture(caster).rgba) < 1e-3


def refused(resolved):
    from clvol.integrators.registry import check_scene

    check_scene(resolved)


_BY_VALUE = """
INLINE floatN oracle_distance(const Source *in, floatN x, floatN y, floatN z, floatN value, floatN mapped, floatN left)
{
  return select((floatN)in->pyramid->oracle.y, (floatN)in->pyramid->oracle.x, MASK(value > 127.0f));
}
"""


def test_maps_that_do_not_fit_are_refused(context, registered):
    """The kernel would look beyond them."""

    class Wrong(_Everywhere):
        found = np.zeros((3, 3, 3))

        def distances(self, asked):
            return self.found

    class NoMap(Oracle):
        name = "no-map"

    wrong = Wrong()
    registered(wrong), registered(NoMap())
    scene = pyramid_scene(oracle="everywhere")
    with pytest.raises(RenderError, match=r"gave distances \(3, 3, 3\)"):
        PyramidCaster(context, scene)
    for number in (np.nan, -1.0):
        wrong.found = np.full((39, 36, 44), number)
        with pytest.raises(RenderError, match="negative or not a number"):
            PyramidCaster(context, scene)
    wrong.found = np.full((39, 36, 44), np.inf)
    assert np.isfinite(pyramid_picture(context, scene).rgba).all()
    with pytest.raises(RenderError, match="gave a map of 0 bytes"):
        PyramidCaster(context, pyramid_scene(oracle="no-map"))


def test_a_renderer_has_the_oracle_that_a_name_means_now(context, registered):
    from clvol.render.prepared_cache import PreparedCache

    engines = PreparedCache(context)
    registered(_Everywhere())
    scene = pyramid_scene(oracle="everywhere")
    first = engines.prepare(scene)
    assert engines.prepare(scene).march.oracle is first.march.oracle
    registered(_Everywhere())
    assert engines.prepare(scene).march.oracle is not first.march.oracle


def test_an_oracle_in_opencl_c(context, registered, tmp_path):
    """It may look at the value: then every coarse sample is one of the volume, too."""

    class ByValue(Oracle):
        name, kernel, folder, leaps = "by-value", KERNEL_CUSTOM, tmp_path, False

        def numbers(self, asked):
            return (asked.epsilon, 8.0, 0.0, 0.0)

    (tmp_path / "oracle_custom.h").write_text(_BY_VALUE)
    registered(ByValue())
    picture = pyramid_picture(context, pyramid_scene(oracle="by-value", epsilon=0.1))
    full = pyramid_picture(context, pyramid_scene(oracle="minimum"))
    assert picture.samples == picture.counters["oracle_samples"]
    share = picture.samples / full.counters["oracle_samples"]
    assert 0.02 < share < 0.9 and rms(picture.rgba, full.rgba) < 0.01
    # The same that says it looks at no value is asked without.
    blind = _BY_VALUE.replace("value > 127.0f", "x > 20.0f")
    folder = tmp_path / "blind"
    folder.mkdir()
    (folder / "oracle_custom.h").write_text("#define ORACLE_NEEDS_VALUE 0\n" + blind)
    ByValue.folder = folder
    picture = pyramid_picture(context, pyramid_scene(oracle="by-value", epsilon=0.1))
    assert picture.samples < picture.counters["oracle_samples"]


def test_an_oracle_that_does_not_compile_is_named(context, registered, tmp_path):
    class Broken(Oracle):
        name, kernel, folder = "broken", KERNEL_CUSTOM, tmp_path

    (tmp_path / "oracle_custom.h").write_text("INLINE floatN oracle_distance() { return nothing; }")
    registered(Broken())
    caster = PyramidCaster(context, pyramid_scene(oracle="broken"))
    with pytest.raises(RenderError, match=r"pyramid\.cl.*does not build"):
        caster.warm_up(16, 16)


# What epsilon does


def test_errors_fall_with_epsilon_to_those_of_full_resolution(context):
    """And samples rise. Beside the same slices and rays all sampled."""
    array = waves((40, 37, 45))
    full = pyramid_picture(context, pyramid_scene(array, SHELL, oracle="minimum", step=0.5))
    for oracle in ("error", "opacity-gradient", "bandwidth"):
        errors, samples = [], []
        for epsilon in (1.0, 0.1, 0.01, 1e-3, 1e-5):
            found = pyramid_picture(context, pyramid_scene(array, SHELL, oracle=oracle, epsilon=epsilon, step=0.5))
            errors.append(rms(found.rgba, full.rgba)), samples.append(found.samples)
        assert all(less <= more * 1.05 + 1e-6 for more, less in zip(errors, errors[1:])), (oracle, errors)
        assert samples == sorted(samples) and samples[0] < 0.2 * samples[-1] <= 0.2 * full.samples
        assert errors[-1] < 2e-4 and errors[-1] < 0.05 * errors[0]


def test_pictures_go_to_the_exact_integral(device, context):
    """As epsilon, levels and steps go to 0 together: with the order of pre-integration."""
    from helpers.small_scenes import exact

    array = waves((20, 19, 22))
    camera = {"position": (-35.0, -20.0, -30.0), "target": (10.0, 9.0, 10.0), "fov_degrees": 40.0}
    base = {"camera": camera, "width": 16, "height": 14, "table_size": 512}
    scene = pyramid_scene(array, **base)
    plain = replace(scene, integration=scene.integration.model_copy(update={"method": "raycast"}))
    truth = exact(device, plain, 1e-6)
    errors = [
        rms(pyramid_picture(context, pyramid_scene(array, levels=n, epsilon=e, step=h, **base)).rgba, truth)
        for n, e, h in ((3, 0.3, 1.0), (2, 0.03, 0.5), (1, 3e-3, 0.25), (0, 3e-4, 0.125))
    ]
    assert all(less < 0.6 * more for more, less in zip(errors, errors[1:])), errors
    assert errors[-1] < 2e-4
