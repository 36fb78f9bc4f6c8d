"""Volumes made from arrays: types kept, layouts made native, values counted."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.volume import ACCEPTED_TYPES, Volume, describe


def ramp(dtype: str = "float32") -> np.ndarray:
    return np.arange(3 * 4 * 5).reshape(3, 4, 5).astype(dtype)


@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
@pytest.mark.parametrize("order", ["<", ">"])
def test_values_and_type_survive_either_byte_order(dtype, order) -> None:
    array = ramp(dtype).astype(np.dtype(dtype).newbyteorder(order))
    volume = Volume(array)
    assert volume.dtype == np.dtype(dtype) and volume.dtype.isnative
    assert volume.data.flags.c_contiguous
    assert np.array_equal(volume.data, ramp(dtype))


def test_a_native_c_array_is_shared_not_copied() -> None:
    array = ramp()
    assert np.shares_memory(Volume(array).data, array)


def test_strided_and_fortran_arrays_become_c_contiguous() -> None:
    array = ramp()
    for view in (np.asfortranarray(array), array[::-1, :, ::2], array.transpose(2, 0, 1)):
        volume = Volume(view)
        assert volume.data.flags.c_contiguous
        assert np.array_equal(volume.data, view)


def test_bool_is_viewed_as_uint8() -> None:
    volume = Volume(ramp() > 30)
    assert volume.dtype == np.uint8
    assert volume.value_range == (0.0, 1.0)


@pytest.mark.parametrize("dtype", ["longdouble", "complex64", "O", "U3", "datetime64[s]"])
def test_other_types_are_refused_naming_what_is_accepted(dtype) -> None:
    with pytest.raises(VolumeError, match="uint8, int8, uint16, int16, float32, float64"):
        Volume(np.zeros((2, 2, 2), dtype=dtype))


@pytest.mark.parametrize("shape", [(4,), (4, 4), (4, 4, 4, 3), (0, 4, 4), ()])
def test_other_dimensions_and_empty_arrays_are_refused(shape) -> None:
    with pytest.raises(VolumeError):
        Volume(np.zeros(shape, dtype=np.uint8))


def test_masked_and_ragged_arrays_are_refused() -> None:
    with pytest.raises(VolumeError, match="masked"):
        Volume(np.ma.masked_equal(ramp(), 3))
    with pytest.raises(VolumeError):
        Volume([[[1.0, 2.0], [3.0]]])


def test_data_cannot_be_changed_behind_the_cached_range() -> None:
    volume = Volume(ramp())
    with pytest.raises(ValueError):
        volume.data[0, 0, 0] = 9.0


@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_range_reaches_the_types_limits(dtype) -> None:
    limits = np.iinfo(dtype) if np.dtype(dtype).kind in "iu" else np.finfo(dtype)
    array = np.zeros((3, 4, 5), dtype=dtype)
    array[2, 1, 3], array[0, 3, 4] = limits.min, limits.max
    assert Volume(array).value_range == (float(limits.min), float(limits.max))


def test_range_and_counts_leave_out_what_is_not_finite() -> None:
    array = ramp("float64")
    array[0, 0, :3] = np.nan
    array[1, 0, 0], array[1, 1, 1] = np.inf, -np.inf
    volume = Volume(array)
    finite = array[np.isfinite(array)]
    assert volume.value_range == (finite.min(), finite.max())
    assert (volume.nan_count, volume.inf_count) == (3, 2)


@pytest.mark.parametrize("fill, counts", [(np.nan, (60, 0)), (np.inf, (0, 60)), (-np.inf, (0, 60))])
def test_nothing_finite_gives_zero_range_without_warnings(fill, counts) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        volume = Volume(np.full((3, 4, 5), fill, dtype=np.float32))
        assert volume.value_range == (0.0, 0.0)
        assert (volume.nan_count, volume.inf_count) == counts


def test_every_block_counts() -> None:
    """Marks in the first, a middle and the last block of a volume larger than a block."""
    array = np.zeros((33, 256, 256), dtype=np.float32)
    array[0, 0, 0], array[16, 0, 5], array[-1, -1, -1] = np.nan, -7.0, 9.0
    array[-1, -1, -2] = np.inf
    volume = Volume(array)
    assert volume.value_range == (-7.0, 9.0)
    assert (volume.nan_count, volume.inf_count) == (1, 1)


def test_description_is_plain_json_with_every_fact() -> None:
    volume = Volume(ramp("int16"), (0.5, 2.0, 3.0), (1.0, 2.0, 3.0), np.diag([-1.0, 1.0, 1.0]))
    facts = json.loads(json.dumps(describe(volume)))
    assert facts["shape_zyx"] == [3, 4, 5] and facts["size_xyz"] == [5, 4, 3]
    assert facts["dtype"] == "int16" and facts["nbytes"] == 120
    assert facts["spacing"] == [0.5, 2.0, 3.0] and facts["origin"] == [1.0, 2.0, 3.0]
    assert facts["direction"][0] == [-1.0, 0.0, 0.0]
    assert facts["value_range"] == [0.0, 59.0]
    assert facts["bounds_world"] == [[-1.0, 2.0, 3.0], [1.0, 8.0, 9.0]]
    assert {"path", "format", "frame", "nan_count", "inf_count"} <= set(facts)


@pytest.mark.parametrize("dtype", ACCEPTED_TYPES)
def test_an_array_that_is_computed_in_place_is_found(dtype) -> None:
    array = np.ones((40, 50, 60), dtype=dtype)
    volume = Volume(array)
    array += 1  # nobody has looked yet
    assert volume.value_range == (2.0, 2.0)
    volume.check_unchanged()
    array += 1
    with pytest.raises(VolumeError, match="another Volume"):
        volume.check_unchanged()
    assert Volume(array).value_range == (3.0, 3.0)


def test_an_array_that_nobody_can_write_to_is_not_looked_at() -> None:
    array = np.frombuffer(bytes(60), np.uint8).reshape(3, 4, 5)
    volume = Volume(array)
    assert volume.value_range == (0.0, 0.0) and volume._seen is None
    volume.check_unchanged()
