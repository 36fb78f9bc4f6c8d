"""Properties that hold for every scene, on random small ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.small_scenes import exact, make_scene, picture
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clvol import TransferFunction, Volume

# What compiles a program of its own: voxel type, holes, classification, filter.
VARIANTS = {
    "uint8, preintegrated": (np.uint8, False, "preintegrated", "linear"),
    "int16, pre": (np.int16, False, "pre", "linear"),
    "float32, post": (np.float32, False, "post", "linear"),
    "float32 with holes, preintegrated": (np.float32, True, "preintegrated", "linear"),
    "float32 with holes, pre": (np.float32, True, "pre", "linear"),
    "float64 with holes, nearest": (np.float64, True, "post", "nearest"),
}
variants = pytest.mark.parametrize("variant", VARIANTS)
WIDTH, HEIGHT = 12, 10


def examples(count: int):
    slow = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
    return settings(
        max_examples=count, deadline=None, derandomize=True, database=None,
        suppress_health_check=slow,
    )  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A scene's parts; values run from 0 to ``top`` in the voxels' type."""

    array: np.ndarray
    function: TransferFunction
    spacing: tuple
    camera: dict
    integration: dict

    def scene(self, origin=(0.0, 0.0, 0.0), **integration):
        grid = {"spacing": self.spacing, "origin": origin}
        return make_scene(
            self.array, self.function, camera=self.camera, width=WIDTH, height=HEIGHT, grid=grid,
            **{"table_size": 64, **self.integration, **integration},
        )  # fmt: skip


@st.composite
def cases(draw, variant, smooth=False, smallest=1) -> Case:
    """``smooth``: neither steps nor opacities next to 1 nor holes, and fields without noise."""
    dtype, holes, classification, filter_name = VARIANTS[variant]
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    shape = tuple(draw(st.integers(smallest, 9)) for _ in range(3))
    top = {np.uint8: 255.0, np.int16: 30000.0, np.float32: 1.0, np.float64: 1e5}[dtype]
    kind = "waves" if smooth else draw(st.sampled_from(["noise", "levels", "waves"]))
    field = _field(rng, shape, kind)
    array = field * top
    array = np.round(array).astype(dtype) if np.dtype(dtype).kind in "iu" else array.astype(dtype)
    if holes and not smooth:
        share = draw(st.sampled_from([0.02, 0.05, 0.3, 1.0]))
        bad = rng.choice([np.nan, np.inf, -np.inf], shape)
        array = np.where(rng.random(shape) < share, bad, array).astype(dtype)
    spacing = tuple(10.0 ** rng.uniform(-1, 1, 3) * 10.0 ** draw(st.sampled_from([-6, 0, 3])))
    size = np.array(shape[::-1]) * spacing
    unit = float(size.max()) * 10.0 ** (0.0 if smooth else draw(st.sampled_from([-3, -1, 0, 1])))
    function = _function(draw, rng, top, unit, smooth)
    camera = _camera(draw, rng, size)
    step = draw(st.sampled_from([0.3, 1.0, 3.0]))
    keys = {"classification": classification, "filter": filter_name, "step": step}
    return Case(array, function, spacing, camera, keys)


def _field(rng, shape, kind):
    if kind == "noise":
        return rng.random(shape)
    if kind == "levels":  # exactly on control points
        return rng.choice([0.0, 0.25, 0.5, 0.75, 1.0], shape)
    axes = np.meshgrid(*(np.linspace(0, 1, n) for n in shape), indexing="ij")
    phases = sum(rng.uniform(-2, 2) * axis for axis in axes) + rng.uniform(0, 6)
    return 0.5 + 0.5 * np.sin(phases)


def _function(draw, rng, top, unit, smooth):
    if smooth:
        values = np.linspace(0, 1, draw(st.integers(2, 5)))
        return TransferFunction(
            values * top, rng.uniform(0, 0.8, values.size), rng.random((values.size, 3)), unit
        )
    places = [0, 0.25, 0.5, 0.5, 0.75, 1, 1, 0.3, 0.3001, *rng.uniform(-0.2, 1.2, 3)]
    count = draw(st.integers(1, 8))
    values = np.sort(rng.choice(places, count, replace=False)) * top
    opacities = rng.choice([0, 1, 1 - 1e-7, 1e-7, 0.5, 0.99, *rng.random(5)], count)
    return TransferFunction(values, opacities, rng.random((count, 3)), unit)


def _camera(draw, rng, size):
    centre = size / 2
    away = rng.normal(size=3)
    away *= np.linalg.norm(size) / np.linalg.norm(away) * draw(st.sampled_from([0.1, 1.5, 20.0]))
    target = centre + 0.1 * size * rng.normal(size=3)
    distance = np.linalg.norm(away)
    fov = 2 * np.degrees(np.arctan(np.linalg.norm(size) / distance / 1.5))
    return {
        "projection": draw(st.sampled_from(["perspective", "orthographic"])),
        "position": (target + away).tolist(), "target": target.tolist(),
        "up": rng.normal(size=3).tolist(), "fov_degrees": float(min(fov, 150.0)),
        "height": float(np.linalg.norm(size)),
    }  # fmt: skip


def check_bounds(rgba, function, slack):
    assert np.isfinite(rgba).all()
    alpha = rgba[..., 3:]
    assert alpha.min() >= 0.0 and alpha.max() <= 1.0
    assert rgba[..., :3].min() >= -slack
    assert (rgba[..., :3] <= alpha * function.colors.max(axis=0) + slack).all()


def check_same(one, other, limit, jumps=0.0):
    """Pixels differ by at most ``limit``, but for a share of ``jumps``."""
    far = np.abs(np.asarray(one, float) - other).max(axis=-1) > limit
    most = np.abs(one - other).max()
    assert far.mean() <= jumps, f"{far.sum()} of {far.size} pixels, by up to {most}"


# A ray that meets a jump (a hole, an opaque voxel's cell, a step) within rounding may fall either
# way, and where samples lie relative to it decides: of some pixels, nothing can be said.
JUMPS = 0.03


@pytest.mark.slow
@variants
def test_a_picture_is_finite_and_bounded_by_its_transfer_function(context, variant):
    @examples(60)
    @given(cases(variant))
    def check(case):
        data = picture(context, case.scene())
        check_bounds(data.rgba, case.function, 2e-6)
        seen = data.rgba[..., 3] > 0.5 + 1e-6
        assert np.isfinite(data.depth[seen]).all() and not np.isnan(data.depth).any()
        assert (data.depth >= 0).all()
        visible.append(data.rgba[..., 3].max() > 0.01)

    visible: list = []
    check()
    assert np.mean(visible) > 0.3, "too many of these scenes are blank"


@variants
def test_the_reference_is_finite_and_bounded_by_its_transfer_function(device, variant):
    @examples(40)
    @given(cases(variant))
    def check(case):
        check_bounds(exact(device, case.scene()), case.function, 1e-9)

    check()


@variants
def test_scaling_the_world_scales_nothing_in_the_picture(device, context, variant):
    @examples(20)
    @given(cases(variant), st.sampled_from([2.0**-40, 2.0**20, 2.0**70, 1e-6, 3.7, 1e6]))
    def check(case, scale):
        function, lengths = case.function, ("position", "target", "height")
        camera = {
            key: (np.array(value) * scale).tolist() if key in lengths else value
            for key, value in case.camera.items()
        }  # fmt: skip
        larger = replace(
            case, camera=camera, spacing=tuple(scale * s for s in case.spacing),
            function=TransferFunction(
                function.values, function.opacities, function.colors, scale * function.opacity_unit
            ),
        )  # fmt: skip
        one, other = (picture(context, c.scene()).rgba for c in (case, larger))
        if np.log2(scale) == round(np.log2(scale)):
            assert np.array_equal(one, other)
        check_same(one, other, 1e-4, JUMPS)
        check_same(*(exact(device, c.scene()) for c in (case, larger)), 3e-9, JUMPS)

    check()


@variants
def test_mirroring_the_volume_mirrors_the_picture(device, context, variant):
    @examples(20)
    @given(cases(variant), st.integers(0, 2))
    def check(case, axis):
        last = (case.array.shape[2 - axis] - 1) * case.spacing[axis]
        camera = dict(case.camera)
        for key, sum_ in (("position", last), ("target", last), ("up", 0.0)):
            camera[key] = list(camera[key])
            camera[key][axis] = sum_ - camera[key][axis]
        mirrored = replace(case, camera=camera, array=np.flip(case.array, 2 - axis))
        one, other = (picture(context, c.scene()).rgba for c in (case, mirrored))
        check_same(one, other[:, ::-1], 1e-4, JUMPS)
        one, other = (exact(device, c.scene()) for c in (case, mirrored))
        check_same(one, other[:, ::-1], 3e-9, JUMPS)

    check()


@variants
def test_adding_a_control_point_that_says_nothing_new_changes_nothing(device, context, variant):
    @examples(20)
    @given(cases(variant), st.floats(0.01, 0.99), st.integers(0, 7), st.booleans())
    def check(case, share, piece, outside):
        function = case.function
        # Transparent, so that beyond the first point and on the first piece nothing is seen.
        opacities = function.opacities.copy()
        opacities[0] = 0.0
        if opacities.size > 1 and piece % 2:
            opacities[1] = 0.0
        function = TransferFunction(
            function.values, opacities, function.colors, function.opacity_unit
        )
        pieces = np.flatnonzero(np.diff(function.values) > 0)
        if outside or not pieces.size:
            value = function.values[0] - share * 10
        else:
            k = pieces[min(piece // 2, pieces.size - 1)]
            value = function.values[k] + share * (function.values[k + 1] - function.values[k])
        at = np.searchsorted(function.values, value)
        more = TransferFunction(
            np.insert(function.values, at, value),
            np.insert(function.opacities, at, function.opacity(value)),
            np.insert(function.colors, at, function.color(value), axis=0),
            function.opacity_unit,
        )
        scenes = [replace(case, function=f).scene() for f in (function, more)]
        # The tables have other nodes then.
        check_same(*(picture(context, scene).rgba for scene in scenes), 5e-3, JUMPS)
        check_same(*(exact(device, scene) for scene in scenes), 3e-9, JUMPS)

    check()


def split(case, axis, place):
    """The scenes of the volume cut at a plane of voxels, that at the eye's side first."""
    array_axis = 2 - axis
    n = case.array.shape[array_axis]
    k = 1 + place % (n - 2)
    low = np.split(case.array, [k + 1], array_axis)[0]
    high = np.split(case.array, [k], array_axis)[1]
    origin = np.zeros(3)
    origin[axis] = k * case.spacing[axis]
    parts = [replace(case, array=np.ascontiguousarray(p)) for p in (low, high)]
    scenes = [parts[0].scene(), parts[1].scene(origin=tuple(origin))]
    position, target = (np.array(case.camera[key])[axis] for key in ("position", "target"))
    perspective = case.camera["projection"] == "perspective"
    low_first = position < origin[axis] if perspective else target > position
    return scenes if low_first else scenes[::-1]


def over(front, back):
    return front + (1.0 - front[..., 3:]) * back


@variants
def test_the_reference_of_a_volume_cut_at_a_plane_composites_to_the_whole(device, variant):
    @examples(30)
    @given(cases(variant, smallest=3), st.integers(0, 2), st.integers(0, 7))
    def check(case, axis, place):
        if VARIANTS[variant][3] == "nearest":
            return  # voxels' own cells end between the voxels: there is no plane to cut at
        front, back = (exact(device, scene) for scene in split(case, axis, place))
        check_same(over(front, back), exact(device, case.scene()), 5e-9)

    check()


@variants
def test_a_volume_cut_at_a_plane_composites_to_the_whole(context, variant):
    @examples(20)
    @given(cases(variant, smooth=True, smallest=3), st.integers(0, 2), st.integers(0, 7))
    def check(case, axis, place):
        fine = replace(case, integration={**case.integration, "step": 0.02})
        front, back = (picture(context, scene).rgba for scene in split(fine, axis, place))
        # Both have an error of their own, of the step and of tables over other ranges of values.
        limit = 2e-2 if VARIANTS[variant][3] == "nearest" else 2e-3
        check_same(over(front, back), picture(context, fine.scene()).rgba, limit)

    check()


@variants
def test_a_fine_step_comes_to_the_reference(device, context, variant):
    @examples(20)
    @given(cases(variant, smooth=True))
    def check(case):
        rgba = picture(context, case.scene(step=0.02, table_size=256)).rgba
        limit = 2e-2 if VARIANTS[variant][3] == "nearest" else 2e-3
        check_same(rgba, exact(device, case.scene()), limit)

    check()


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["uint8, preintegrated", "float32 with holes, preintegrated"])
def test_leaping_over_empty_space_changes_no_bit(context, variant):
    @examples(25)
    @given(cases(variant), st.integers(9, 40))
    def check(case, length):
        # Longer than one cell of the map, mostly of the lowest value.
        array = np.full((*case.array.shape[:2], length), case.array.dtype.type(0))
        array[..., : case.array.shape[2]] = case.array
        long = replace(case, array=array)
        leaping, walking = (picture(context, long.scene(), skip=skip) for skip in (True, False))
        assert np.array_equal(leaping.rgba, walking.rgba)
        assert leaping.samples <= walking.samples

    check()


def test_random_volumes_are_volumes():
    """The strategy gives what it says: some holes, some opacity, more than one size."""
    seen = []

    @examples(30)
    @given(cases("float32 with holes, pre"))
    def collect(case):
        volume = Volume(case.array)
        holes = volume.nan_count + volume.inf_count
        seen.append((holes, volume.shape, case.function.opacities.max()))

    collect()
    holes, shapes, opacities = zip(*seen)
    assert sum(n > 0 for n in holes) > 15 and len(set(shapes)) > 10
    assert sum(opacity > 0 for opacity in opacities) > 15
