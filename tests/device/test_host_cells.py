"""What is computed on the host in place of cl/empty_space.cl, beside these kernels: the same bits."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import Volume
from clvol.device import host_cells
from clvol.device.empty_space import distance_map
from clvol.device.volume import DeviceVolume
from clvol.volume.voxel_layout import FINE_SHIFT, cell_count

SHAPES = ((2, 2, 2), (9, 17, 8), (31, 5, 18), (1, 40, 70))


@pytest.fixture(params=["uint8", "float32"])
def arrays(request):
    rng, dtype = np.random.default_rng(3), np.dtype(request.param)
    made = [(rng.random(shape) * 250).astype(dtype) for shape in SHAPES]
    if dtype.kind == "f":
        for array in made:
            array[rng.random(array.shape) < 0.4] = np.nan
            array[: array.shape[0] // 2] = np.inf
    return made


def kernels_only(monkeypatch):
    monkeypatch.setattr(host_cells, "_MOST_VOXELS", -1)
    monkeypatch.setattr(host_cells, "_MOST_CELLS", -1)
    monkeypatch.setattr(host_cells, "_MOST_CELLS_OF_OCTANTS", -1)


def masks_of_cells(rng) -> list[np.ndarray]:
    masks = [rng.random(shape) < share for shape in ((7, 9, 12), (1, 1, 300), (30, 2, 5)) for share in (0.01, 0.3)]
    masks += [np.zeros((3, 4, 5), bool), np.ones((3, 4, 5), bool)]
    masks[2][0, 0, 0] = True
    return masks


def test_volumes_are_those_of_the_kernels(contexts, device, arrays, monkeypatch):
    context = contexts(device)
    if not context.is_cpu:
        pytest.skip("the host prepares volumes for CPU devices alone")
    found = []
    for by_kernels in (False, True):
        if by_kernels:
            kernels_only(monkeypatch)
        volumes = [DeviceVolume(context, Volume(array)) for array in arrays]
        for volume in volumes:
            wanted = np.ones([cell_count(n, FINE_SHIFT) for n in volume.size[::-1]], bool)
            bounds = [*volume.bounds(0), *volume.bounds(1), *volume.fine_bounds(1, wanted)]
            voxels = context.read(volume.voxels).ravel()
            voxels = voxels[:-8] if volume.switches["VOXEL_PAIRS"] else voxels  # those at the end are not initialised
            found.append([voxels, *bounds])
    for host, kernel in zip(found[: len(arrays)], found[len(arrays) :]):
        for a, b in zip(host, kernel, strict=True):
            np.testing.assert_array_equal(a, b)


def test_distances_are_those_of_the_kernel(contexts, device, monkeypatch):
    context, rng = contexts(device), np.random.default_rng(4)
    masks = masks_of_cells(rng)
    host = [context.read(distance_map(context, mask)) for mask in masks]
    kernels_only(monkeypatch)
    for mask, distances in zip(masks, host):
        np.testing.assert_array_equal(distances, context.read(distance_map(context, mask)))


def test_maps_of_octants_have_the_distances_to_what_is_ahead():
    for mask in masks_of_cells(np.random.default_rng(4)):
        places, seen = np.stack(np.indices(mask.shape), axis=-1).reshape(-1, 3), np.argwhere(mask)
        for octant, found in enumerate(host_cells.octant_distances(mask)):
            signs = np.array([1 if octant & bit else -1 for bit in (4, 2, 1)])
            ways = (seen[None] - places[:, None]) * signs
            far = np.where((ways >= 0).all(axis=-1), ways.max(axis=-1), 255)
            expected = np.minimum(far.min(axis=1, initial=255), 255)
            np.testing.assert_array_equal(found.ravel(), expected, err_msg=f"octant {octant} of {mask.shape}")


def test_maps_of_octants_are_those_of_the_kernel(contexts, device, monkeypatch):
    context = contexts(device)
    if not context.is_cpu:
        pytest.skip("the host prepares volumes for CPU devices alone")
    masks = masks_of_cells(np.random.default_rng(5))
    host = [context.read(distance_map(context, mask, octants=True)) for mask in masks]
    kernels_only(monkeypatch)
    for mask, maps in zip(masks, host):
        assert maps.size == 9 * mask.size + 4
        np.testing.assert_array_equal(maps[: mask.size], context.read(distance_map(context, mask))[: mask.size])
        np.testing.assert_array_equal(maps, context.read(distance_map(context, mask, octants=True)))
