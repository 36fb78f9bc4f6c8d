"""Scale: the smallest and the widest pictures, the largest volumes, the longest rays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from small_scenes import axis_camera, exact, make_scene, picture, waves

from clvol import TransferFunction, Volume
from clvol.device.volume import DeviceVolume
from clvol.errors import DeviceError, VolumeError
from clvol.integrators.reference.picture import render_reference
from clvol.opencl.structs import view_dtype
from clvol.volume.voxel_layout import LARGEST_OFFSET

CLASSIFICATIONS = ("pre", "post", "preintegrated")
GREY = [[0.3, 0.5, 0.7]]
SOURCE = Path(__file__).with_name("corner_offsets.cl")
# All but 2^31 voxels: one long axis, two, three alike.
LONG = 2**29 - 1
LARGEST = [(LONG, 2, 2), (2, LONG, 2), (2, 2, LONG), (32767, 32767, 2), (1290, 1290, 1290)]


# --- pictures --------------------------------------------------------------------------------------


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("lanes", [1, 16])
def test_a_picture_of_one_pixel(device, context, projection, lanes):
    scene = make_scene(
        waves((9, 10, 11)), camera={"projection": projection}, width=1, height=1, step=0.125
    )
    data, reference = picture(context, scene, lanes=lanes), exact(device, scene)
    assert data.rgba.shape == (1, 1, 4) and reference[0, 0, 3] > 0.2
    np.testing.assert_allclose(data.rgba, reference, atol=2e-4)


@pytest.mark.parametrize("size", [(8192, 2), (2, 8192), (8191, 1)])
def test_a_picture_8192_pixels_wide_or_high(device, context, size):
    width, height = size
    long = max(size)
    array = waves((5, 5, 5))
    camera = {
        "projection": "orthographic", "position": [2, 2, -9], "target": [2, 2, 2], "up": [0, 1, 0],
        "height": 3.9 * height / long,
    }  # fmt: skip
    scene = make_scene(array, camera=camera, width=width, height=height, step=0.125)
    rgba = picture(context, scene).rgba
    assert rgba.shape == (height, width, 4)
    some = np.unique(np.linspace(0, long - 1, 201).astype(int))
    line = np.zeros_like(some)
    pixels = np.stack([line, some] if width == long else [some, line], axis=1)
    reference = render_reference(scene, device, pixels=pixels)[0]
    assert reference[:, 3].min() > 0
    np.testing.assert_allclose(rgba[pixels[:, 0], pixels[:, 1]], reference, atol=2e-4)
    # No seam anywhere: neighbours differ by what one pixel's width can give.
    steps = np.abs(np.diff(rgba[0] if width == long else rgba[:, 0], axis=0))
    assert steps.max() < 2e-3


# --- volumes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_a_volume_of_more_than_2_31_voxels_is_refused_before_anything_is_uploaded(
    context, monkeypatch, dtype
):
    class Vast:
        """The device, if it had the memory."""

        def __init__(self, device):
            self._device = device
            self.max_mem_alloc_size = self.global_mem_size = 2**50

        def __getattr__(self, name):
            return getattr(self._device, name)

    def no_upload(*_):
        raise AssertionError("uploaded")

    class Large(Volume):
        """Says that it is larger than it is."""

        def __init__(self, shape):
            super().__init__(np.zeros((2, 2, 2), dtype), name="large")
            self.grid = Volume(np.zeros((1, 1, 1), dtype)).grid.__class__(shape)

    for name in ("upload", "share", "empty"):
        monkeypatch.setattr(context, name, no_upload)
    shape = (1291, 1291, 1291)
    with pytest.raises(VolumeError, match="large: .* need .* bytes on .*, expected at most"):
        device = Vast(context.device)
        device.max_mem_alloc_size = 2**20
        monkeypatch.setattr(context, "device", device)
        DeviceVolume(context, Large(shape))
    monkeypatch.setattr(context, "device", Vast(context.device))
    with pytest.raises(VolumeError, match=f"2151685171 voxels, expected at most {LARGEST_OFFSET}"):
        DeviceVolume(context, Large(shape))


@pytest.mark.parametrize("lanes", [1, 16])
@pytest.mark.parametrize("bits, pairs", [(8, 0), (8, 1), (16, 0), (32, 0), (64, 0)])
def test_addresses_are_right_up_to_2_31_voxels(context, lanes, bits, pairs):
    """Offsets computed on the device; the voxels themselves need not be there."""
    switches = {
        "LANES": lanes, "VOXEL_BITS": bits, "VOXEL_PAIRS": pairs, "VOXEL_SIGNED": 0,
        "VOXEL_SCALED": 0, "VOXEL_HOLES": 0,
    }  # fmt: skip
    kernel = context.kernel(
        str(SOURCE), "corner_offsets",
        "in view V1, in x int32, in y int32, in z int32, out offsets int32, out bytes uint64",
        switches,
    )  # fmt: skip
    rng = np.random.default_rng(5)
    for size in LARGEST:
        nx, ny, nz = size
        assert 2**31 - 2**20 < nx * ny * nz <= LARGEST_OFFSET
        cells = np.stack([rng.integers(0, n - 1, 64) for n in size])
        cells[:, 0], cells[:, 1] = 0, [n - 2 for n in size]
        stride = (nx, nx * (ny - 1)) if pairs else (nx, nx * ny)
        view = np.zeros(1, view_dtype(bits))
        view["size"][0, :3], view["stride"][0, :2] = size, stride
        offsets, sizes = context.empty(np.int32, (64,)), context.empty(np.uint64, (64,))
        kernel(
            context.queue, (64 // lanes,), (1,), view=context.upload(view),
            **{name: context.upload(cells[k].astype(np.int32)) for k, name in enumerate("xyz")},
            offsets=offsets, bytes=sizes,
        )  # fmt: skip
        x, y, z = cells.astype(np.int64)
        expected = (z * stride[1]) + y * stride[0] + x
        assert np.array_equal(context.read(offsets), expected)
        far = expected + stride[1] + stride[0]
        element = 2 if pairs else bits // 8
        assert np.array_equal(context.read(sizes).astype(np.int64), far * element + bits // 8)
        assert expected.max() + stride[1] + stride[0] * (not pairs) + 1 < nx * ny * nz
        assert bits == 8 or far.max() * element > 2**31


def test_voxels_beyond_2_31_bytes_are_read(context):
    """A view of a volume whose bytes no 32-bit offset reaches, most of it memory never touched."""
    if not context.is_cpu:
        pytest.skip("the volume is copied to this device")
    shape = (4, 16384, 18000)
    try:
        array = np.zeros(shape, np.uint16)  # 2.4e9 bytes, of which pages are made when touched
    except MemoryError:
        pytest.skip("no address space for the volume")
    volume = Volume.__new__(Volume)
    array[2:, -9:, -9:] = 500
    volume.data, volume.name = array, "sparse"
    volume.grid = Volume(np.zeros((1, 1, 1))).grid.__class__(shape)
    volume.frame, volume.path, volume.format = "index", None, None
    volume.__dict__["_census"] = Volume(np.array([[[0, 500]]], np.uint16))._census
    if array.nbytes > context.device.max_mem_alloc_size:
        with pytest.raises((VolumeError, DeviceError), match="bytes"):
            DeviceVolume(context, volume)
        return
    camera = axis_camera([17995.0, 16379.0, 2.5], 2, 4.0, distance=9.0)
    function = TransferFunction([0, 500], [0.0, 0.2], GREY * 2)
    scene = make_scene(volume, function, camera=camera, width=4, height=4, step=0.02)
    from clvol.device import volume as device_volume

    grid = np.zeros(tuple(device_volume.cell_count(n) for n in (4, 16384, 18000)))
    known = DeviceVolume._min_max
    DeviceVolume._min_max = lambda *_: (grid, grid + 500.0)  # reads all that was never touched
    try:
        alpha = picture(context, scene, skip=False).rgba[..., 3]
    finally:
        DeviceVolume._min_max = known
    np.testing.assert_allclose(alpha, np.full((4, 4), exact_tail()), rtol=2e-3)


def exact_tail() -> float:
    """Opacity 0 to 0.2 along the cell before the two slices that hold 500, then one cell of 0.2."""
    q = 0.8
    ramp = 1.0 - (0.0 - q * np.log(q)) / (1.0 - q)  # mean of -log(1 - a) for a from 0 to 0.2
    return float(-np.expm1(-(ramp - np.log(q))))


# --- rays ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("classification", CLASSIFICATIONS)
@pytest.mark.parametrize("towards", [(1.0, 0.0, 0.0), (1.0, 0.003, 0.002), (-1.0, 0.001, -0.003)])
def test_1e5_steps_a_ray_arrive_within_1e_3_voxel(device, context, classification, towards):
    """Three cells of a ramp at the far end: how opaque they are says where the samples were."""
    n = 1000
    array = np.zeros((9, 9, n), np.uint8)
    if towards[0] > 0:
        array[..., -4:] = np.arange(4)
    else:
        array[..., :4] = np.arange(4)[::-1]
    towards = np.array(towards)
    end = np.array([n - 2.0 if towards[0] > 0 else 1.0, 4.0, 4.0])
    camera = {
        "projection": "orthographic", "position": (end - 2000 * towards).tolist(),
        "target": end.tolist(), "up": [0, 0, 1], "height": 0.2,
    }  # fmt: skip
    function = TransferFunction([0, 3], [0.0, 0.5], GREY * 2)
    scene = make_scene(
        array, function, camera=camera, width=4, height=4, step=0.01, classification=classification
    )
    data = picture(context, scene, skip=False)
    assert data.samples > 16 * 0.99e5
    reference = exact(device, scene)
    # A shift of all samples by d voxels adds or takes d of the largest extinction, log 2, behind what
    # lets a third of the light through: 1e-3 voxel shows as 2.5e-4, and more where the end is cut.
    np.testing.assert_allclose(data.rgba[..., 3], reference[..., 3], atol=2.5e-4)
    leaping = picture(context, scene)
    np.testing.assert_array_equal(leaping.rgba, data.rgba)
    assert leaping.samples < data.samples / 20


def test_1e5_voxels_a_ray_arrive_within_an_ulp_or_two(device, context):
    """A coordinate of 1e5 in float32 is known to 2^-8 voxel: that, not the way there, is the bound."""
    n = 100_001
    array = np.zeros((2, 2, n), np.uint8)
    array[..., -4:] = np.arange(4)
    camera = axis_camera([n / 2, 0.5, 0.5], 0, 0.1, distance=6e4)
    function = TransferFunction([0, 3], [0.0, 0.5], GREY * 2)
    scene = make_scene(array, function, camera=camera, width=2, height=2, step=1.0)
    data = picture(context, scene, skip=False)
    assert data.samples >= 4 * 1e5
    reference = exact(device, scene)
    np.testing.assert_allclose(data.rgba[..., 3], reference[..., 3], atol=2 * 2.0**-8)


def test_the_largest_number_of_steps_that_float32_counts_is_the_limit():
    from clvol.errors import SceneError

    array = np.zeros((2, 2, 2), np.uint8)
    with pytest.raises(SceneError, match="integration.step: got 1e-08, expected at least"):
        make_scene(array, step=1e-8)
    make_scene(array, step=2e-7)
