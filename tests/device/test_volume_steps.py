"""A volume on the device takes the voxels of another step as if it had been made of them, in the same memory."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.small_scenes import waves

from clvol import VolumeSeries
from clvol.device.volume import DeviceVolume


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(9, 10, 11), (1, 8, 9)])
@pytest.mark.parametrize("is_cpu", [True, False], ids=["shared memory", "memory of its own"])
@pytest.mark.every_case
def test_another_step_in_the_same_memory(context, monkeypatch, dtype, shape, is_cpu):
    monkeypatch.setattr(context, "is_cpu", is_cpu)
    series = VolumeSeries([np.roll(waves(shape, dtype, high=100.0), k, axis=1) for k in range(3)])
    volume = DeviceVolume(context, series.step(0))
    used = volume.voxels
    for k in (1, 2, 0):
        volume.change(series.step(k))
        made = DeviceVolume(context, series.step(k))
        n = made.voxels.nbytes // made.voxels.dtype.itemsize - 8  # the last few elements are never used
        for one, other in ((volume.voxels, made.voxels), (volume.plain(), made.plain())):
            np.testing.assert_array_equal(context.read(one).reshape(-1)[:n], context.read(other).reshape(-1)[:n])
        for apron in (0, 1):
            np.testing.assert_array_equal(volume.bounds(apron), made.bounds(apron))
    if dtype != np.int8 and (dtype == np.uint8 or not is_cpu):
        assert volume.voxels is used
