"""Levels of a volume: layout, means, and what cells of them can show, against numpy's own."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.field_points import rough
from helpers.small_scenes import make_scene
from reference.levels import LevelsField, level_array

from clvol import Volume
from clvol.device.footprint import footprint_of, levels_seen
from clvol.device.levels import LevelledVolume, SeenLevels, means
from clvol.device.view import PixelLattice, ray_frame
from clvol.errors import VolumeError
from clvol.volume.level_layout import MOST_VOLUME_LEVELS, coarser_bytes, level_edge, levels_of
from clvol.volume.voxel_layout import CELL_SHIFT, FINE_SHIFT

SHAPES = [((19, 16, 33), (1.0, 1.0, 1.0)), ((9, 30, 40), (0.5, 0.5, 2.2)), ((1, 17, 12), (1.0, 1.0, 1.0))]


@pytest.mark.parametrize(("shape", "spacing"), SHAPES)
def test_voxels_of_a_level_are_as_nearly_cubes_as_halves_allow(shape, spacing):
    volume = Volume(np.zeros(shape, np.uint8), spacing)
    levels, edge = levels_of(volume), level_edge(volume)
    assert levels[0].halvings == (0, 0, 0) and min(levels[-1].size) >= 2
    end = 0
    for k, level in enumerate(levels):
        assert level.first == end
        end += level.elements
        for halvings, size, n, step in zip(level.halvings, level.size, volume.grid.size, spacing):
            assert size == max(-(-n // 2**halvings), 2)
            if halvings and size > 2:
                assert 2**-0.51 < step * 2**halvings / (edge * 2**k) < 2**0.51
            if size > 2:  # one more would be too many
                assert step * 2**halvings > 0.7 * edge * 2**k


def test_a_level_that_is_as_the_one_before_takes_no_memory():
    volume = Volume(np.zeros((3, 3, 256), np.float32), (1.0, 16.0, 16.0))
    levels = levels_of(volume)
    assert levels[1] != levels[2] and levels[1].size == (128, 3, 3)
    short = Volume(np.zeros((64, 64, 4), np.float32), (1.0, 8.0, 8.0))
    assert levels_of(short)[1] == levels_of(short)[2]  # x is too short, and y and z are not yet fine enough
    assert len(levels_of(Volume(np.zeros((2, 1, 2), np.uint8)))) == 1
    assert len(levels_of(Volume(np.broadcast_to(np.uint8(0), (2, 2, 5000))))) == MOST_VOLUME_LEVELS


def test_levels_take_a_seventh_of_a_volume():
    volume = Volume(np.zeros((64, 64, 64), np.float32))
    assert coarser_bytes(volume) == 4 * sum(k**3 for k in (32, 16, 8, 4, 2))


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint16", "int16", "float32", "float64"])
@pytest.mark.parametrize(("shape", "spacing"), SHAPES[:2])
def test_means_are_numpys(shape, spacing, dtype):
    volume = Volume(rough(shape, np.dtype(dtype)), spacing)
    levels = levels_of(volume)
    for k, found in enumerate(means(volume.data, levels)):
        wanted, halvings = level_array(volume.data, spacing, k)
        assert found.dtype == volume.dtype and halvings == levels[k].halvings
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1.0 if k and found.dtype.kind in "iu" else 1e-6)
        assert (found != wanted).mean() < 0.02 or found.dtype.kind == "f"  # halves that rounding decides
        assert found.min() >= volume.data.min() and found.max() <= volume.data.max()


def test_a_ramp_keeps_its_place():
    """A mean is the value in the middle of what it stands for, where that is inside."""
    data = np.broadcast_to(np.arange(32, dtype=np.float32), (8, 8, 32)).copy()
    volume = Volume(data)
    for level, found in zip(levels_of(volume)[:4], means(data, levels_of(volume))):
        edge = 2 ** level.halvings[0]
        np.testing.assert_array_equal(found[0, 0], (np.arange(32 // edge) + 0.5) * edge - 0.5)


def test_constants_and_extremes_stay(context):
    for value in (np.float32(0.1), np.float64(1e308), np.float32(-3e38)):
        data = np.full((9, 7, 5), value)
        assert all((level == value).all() for level in means(data, levels_of(Volume(data))))
    data = np.array([-1.7e308, 1.7e308] * 32).reshape(4, 4, 4)
    assert all(np.isfinite(level).all() for level in means(data, levels_of(Volume(data))))


def test_a_mean_is_of_finite_voxels_and_of_half_of_them_at_least():
    data = np.full((4, 4, 4), 5.0, np.float32)
    data[0, 0, 0], data[0, 0, 1], data[2:, 2:, 2:] = np.nan, 9.0, np.nan
    data[2, 2, 2:], data[0, 2:, 2:], data[1, 2, 2:] = 1.0, np.inf, np.nan
    level = means(data, levels_of(Volume(data)))[1]
    assert level[0, 0, 0] == np.float32((9 + 6 * 5) / 7)  # seven of eight
    assert np.isnan(level[1, 1, 1]) and np.isnan(level[0, 1, 1])  # two of eight each
    np.testing.assert_allclose(level, level_array(data, (1, 1, 1), 1)[0])


def places_in_cells(size, shift, rng):
    """Lattice places [n, 3] and the cells (x, y, z) that hold them; many on their faces."""
    at = rng.random((4000, 3)) * (np.asarray(size) - 1)
    at[::3] = np.clip(np.round(at[::3] / 2**shift) * 2**shift, 0, np.asarray(size) - 1)
    last = [max(-(-(n - 1) // 2**shift), 1) - 1 for n in size]
    return at, np.minimum(at.astype(int) >> shift, last)


@pytest.mark.parametrize("shift", [CELL_SHIFT, FINE_SHIFT])
@pytest.mark.parametrize(("shape", "spacing"), SHAPES[:2])
def test_cells_bound_all_that_samples_in_them_can_be(context, shape, spacing, shift):
    data = rough(shape, np.float32)
    data[3, 4:9, 5] = np.nan
    volume = Volume(data, spacing)
    on_device = LevelledVolume(context, volume)
    field = LevelsField(volume, None, 1, 0.0)
    at, cells = places_in_cells(on_device.size, shift, np.random.default_rng(1))
    for first, last in ((0, 0), (0, 2), (1, 2), (3, 3)):
        seen = SeenLevels(on_device, first, last)
        low, high = seen.bounds(0)
        if shift == FINE_SHIFT:
            every = np.ones(on_device.bounds_of_level(0, shift)[0].shape, bool)
            low, high = (part.reshape(every.shape) for part in seen.fine_bounds(0, every))
        x, y, z = cells.T
        for level in range(first, last + 1):
            values = field._of_level(level, at)
            finite = np.isfinite(values)
            assert (low[z, y, x] - 1e-4 <= values)[finite].all()
            assert (values <= high[z, y, x] + 1e-4)[finite].all()
    tight = SeenLevels(on_device, 2, 2).bounds(0)
    assert (tight[1] - tight[0]).max() < np.nanmax(data) - np.nanmin(data)  # means, not what they are of


def test_the_finest_level_bounds_what_voxels_do(context):
    volume = Volume(rough((19, 16, 33), np.uint8))
    on_device = LevelledVolume(context, volume)
    for found, wanted in zip(SeenLevels(on_device, 0, 0).bounds(0), on_device.bounds(0)):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("camera", [
    {"position": (70.0, 9.0, -40.0), "target": (8.0, 8.0, 5.0), "up": (0.0, 1.0, 0.0), "fov_degrees": 40.0},
    {"position": (9.0, 7.0, 4.0), "target": (60.0, 20.0, 5.0), "up": (0.0, 0.0, 1.0), "fov_degrees": 80.0},
    {"projection": "orthographic", "position": (70.0, 9.0, -40.0), "target": (8.0, 8.0, 5.0), "up": (0.0, 1.0, 0.0),
     "height": 100.0},
])  # fmt: skip
def test_the_footprint_is_a_pixels_side(camera):
    """On the plane through a place that is parallel to the picture, for an oblique grid."""
    skew = np.array([[1.0, 0.3, 0.0], [0.0, 0.9539392, 0.0], [0.0, 0.0, -1.0]])
    volume = Volume(np.zeros((19, 16, 33), np.uint8), (0.5, 0.7, 1.5), (3.0, 1.0, 20.0), skew)
    resolved = make_scene(volume, camera=camera, width=16, height=12)
    found = footprint_of(ray_frame(resolved.camera, volume.grid, 16, 12), volume, -0.5)
    index = np.random.default_rng(0).random((50, 3)) * (np.asarray(volume.grid.size) - 1)
    world = index @ volume.grid.index_to_world()[:3, :3].T + volume.grid.origin
    wanted = LevelsField(volume, resolved.camera, 12, -0.5).footprint(world)
    np.testing.assert_allclose(found.constant + index @ found.slope, wanted, rtol=1e-9, atol=1e-9)
    first, last = levels_seen(found, volume)
    clamped = np.maximum(wanted, 1.0)
    assert 2.0**first <= 1.0001 * clamped.min() and clamped.max() <= 1.0001 * 2.0**last


def test_the_footprint_is_the_pictures_whatever_rays_are_cast():
    resolved = make_scene(width=64, height=48)
    grid, volume = resolved.volume.grid, resolved.volume
    whole = footprint_of(ray_frame(resolved.camera, grid, 64, 48), volume, 0.0)
    sparse = footprint_of(ray_frame(resolved.camera, grid, 64, 48, PixelLattice(4, 1, 2)), volume, 0.0)
    of_four = PixelLattice(4, 1, 2, alone=True, covers=2.0)
    shares = footprint_of(ray_frame(resolved.camera, grid, 256, 192, of_four), volume, 0.0)
    assert np.isclose(sparse.constant, whole.constant) and np.isclose(2 * shares.constant, whole.constant)
    assert np.allclose(sparse.slope, whole.slope) and np.allclose(2 * np.array(shares.slope), whole.slope)


def test_levels_that_do_not_fit_are_refused(context, monkeypatch):
    volume = Volume(np.zeros((16, 16, 16), np.float32))
    monkeypatch.setattr("clvol.device.levels.LARGEST_OFFSET", 4200)
    with pytest.raises(VolumeError, match="4680 voxels with their levels.*minification = 'off'"):
        LevelledVolume(context, volume)
