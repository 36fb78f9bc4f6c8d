"""Voxels in fewer bits: what it costs in error, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, make_scene, rms, waves

from clvol import TransferFunction
from clvol.device.quantise import quantised
from clvol.errors import SceneError
from clvol.integrators.reference.picture import render_reference


def of(array, precision, **more):
    return make_scene(array, voxel_precision=precision, **more)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint16, np.int16])
@pytest.mark.parametrize(("precision", "levels"), [("uint8", 255), ("uint16", 65535)])
def test_values_are_rounded_to_evenly_spaced_ones(dtype, precision, levels):
    array = waves((7, 8, 9), dtype, -900 if dtype is not np.uint16 else 0, 3000)
    scene = of(array, precision)
    small = quantised(scene)
    if np.dtype(dtype).itemsize <= np.dtype(precision).itemsize:
        assert small is scene
        return
    assert small.volume.dtype == precision
    low, high = scene.volume.value_range
    back = low + small.volume.data.astype(float) * (high - low) / levels
    assert np.abs(back - array).max() <= 0.5 * (high - low) / levels * (1 + 1e-9)
    # The transfer function means the same values.
    codes = (SMOOTH.values - low) / (high - low) * levels
    np.testing.assert_allclose(small.transfer_function.values, codes, rtol=1e-12, atol=1e-9)
    assert small.volume.grid is not None and small.volume.grid.spacing == scene.volume.grid.spacing


@pytest.mark.slow
def test_more_bits_mean_less_error(device):
    array = waves((15, 16, 17))
    exact = render_reference(of(array, "stored"), device)[0]
    errors = [rms(render_reference(quantised(of(array, p)), device)[0], exact) for p in ("uint8", "uint16")]
    assert 0 < errors[1] < 0.02 * errors[0] and errors[0] < 3e-3


def test_what_no_integer_says_is_refused():
    array = waves((5, 6, 7))
    array[1, 2, 3] = np.nan
    with pytest.raises(SceneError, match="voxel_precision.*1 voxels that are not finite"):
        quantised(of(array, "uint8"))
    assert quantised(of(array, "stored")).volume.nan_count == 1


def test_constant_and_extreme_volumes_stay_as_they_are():
    for array in (np.full((3, 3, 3), 7.0), np.array([[[-1.7e308, 1.7e308]]])):
        scene = of(array, "uint8", function=TransferFunction([0.0], [0.5], [[1, 1, 1]]))
        assert quantised(scene) is scene
