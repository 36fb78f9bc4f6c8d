"""Stores of labels: the same voxels as without codes, and at every level only labels that there are."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.readers import load_volume
from clvol.store.build import build_store
from clvol.store.zarr_store import open_store
from clvol.volume import Volume


def segmentation(shape, dtype, seed: int = 0) -> np.ndarray:
    """The nearest of thirty places says which label a voxel has."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.indices(shape), -1)[..., None, :]
    nearest = ((places - rng.uniform(0, shape, (30, 3))) ** 2).sum(-1).argmin(-1)
    return rng.integers(0, 120, 30).astype(dtype)[nearest]


@pytest.mark.parametrize("dtype", ("uint8", "int8", "uint16", "int16", "float32", "float64"))
def test_a_store_of_labels_holds_the_voxels_of_one_without_codes(tmp_path, dtype):
    volume = Volume(segmentation((37, 40, 50), dtype), labels=True)
    plain = build_store(volume, tmp_path / "plain", codec="none", shard=32)
    stored = build_store(volume, tmp_path / "labels", codec="labels", shard=32)
    stored = open_store(stored.path)
    assert stored.dtype == plain.dtype == np.dtype(dtype)
    assert stored.volume_level(0).tobytes() == plain.volume_level(0).tobytes()
    for level in range(stored.blocks.levels):
        assert np.isin(stored.volume_level(level), volume.data).all()
    assert stored.codes.measured.max_voxel_error == 0 and stored.codes.measured.psnr == np.inf
    for one, other in zip(stored.statistics(), plain.statistics()):
        for name, value in vars(one).items():
            wanted = vars(other)[name]
            by_level = np.ndim(value) > 1
            np.testing.assert_array_equal(value[0] if by_level else value, wanted[0] if by_level else wanted, name)


def test_labels_of_a_brain_take_less_than_any_compressor_makes_of_them(tmp_path, shared_volume):
    volume = load_volume(shared_volume("inia19_labels.nrrd"), labels=True)
    bits = {}
    for codec in ("labels", "zstd", "blosc-lz4"):
        store = build_store(volume, tmp_path / codec, codec=codec)
        assert np.array_equal(store.volume_level(), volume.data)
        bits[codec] = 8 * store.bytes_on_disk / volume.data.size
    assert bits["labels"] < min(bits["zstd"], bits["blosc-lz4"])
