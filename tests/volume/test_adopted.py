"""Volumes from objects of other libraries: voxels, spacing, origin and direction as they say."""

from __future__ import annotations

import array
import subprocess
import sys

import nibabel
import numpy as np
import pytest
import SimpleITK
import zarr

from clvol import Volume, load_volume
from clvol.errors import ClvolWarning, VolumeError

VOXELS = np.arange(24, dtype=np.int16).reshape(2, 3, 4)  # [z, y, x]


def placed(volume: Volume) -> dict[tuple[float, ...], float]:
    """Each voxel's value by its rounded place in the world."""
    z, y, x = np.indices(volume.shape)
    index = np.stack([x, y, z, np.ones_like(x)], axis=-1).reshape(-1, 4)
    world = (index @ volume.grid.index_to_world().T)[:, :3].round(6) + 0.0
    values = volume.slope * volume.data.ravel().astype(float) + volume.offset
    return {tuple(place): value for place, value in zip(world.tolist(), values.tolist())}


# ---- numpy -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "other",
    [
        np.asfortranarray(VOXELS),
        VOXELS.astype(">i2"),
        np.repeat(VOXELS, 2, axis=2)[:, :, ::2],
        VOXELS[::-1, ::-1].copy()[::-1, ::-1],
        np.broadcast_to(VOXELS[:1], (1, 3, 4)).astype(np.int64),
        VOXELS.tolist(),
        VOXELS.astype(np.float16),
    ],
)
def test_any_order_stride_and_byte_order_is_the_same_volume(other):
    volume = Volume(other)
    assert np.array_equal(volume.data, np.asarray(other)) and volume.data.flags.c_contiguous
    assert volume.dtype.isnative and (volume.grid.spacing, volume.frame) == ((1, 1, 1), "index")


def test_the_buffer_protocol_is_enough():
    view = memoryview(array.array("h", range(24))).cast("B").cast("h", (2, 3, 4))
    assert np.array_equal(Volume(view).data, VOXELS)


def test_a_large_array_is_shared():
    big = np.zeros((64, 64, 64), np.float32)
    assert np.shares_memory(Volume(big).data, big)


# ---- xarray ------------------------------------------------------------------------------------------


def data_array(**keys):
    import xarray

    coords = {"x": [10.0, 12.0, 14.0, 16.0], "y": [5.0, 4.0, 3.0], "z": [0.0, 0.5]}
    return xarray.DataArray(**{"data": VOXELS, "dims": ("z", "y", "x"), "coords": coords, "name": "t", **keys})


def test_coordinates_of_xarray_are_the_grid():
    volume = Volume(data_array())
    assert volume.grid.spacing == (2.0, 1.0, 0.5) and volume.grid.origin == (10.0, 5.0, 0.0)
    assert placed(volume)[(12.0, 4.0, 0.5)] == VOXELS[1, 1, 1]
    assert (volume.name, volume.frame) == ("t", "image")


def test_dimensions_of_xarray_in_any_order_are_the_same_volume():
    one = Volume(data_array())
    other = Volume(data_array().transpose("x", "z", "y"))
    assert placed(one) == placed(other) and np.array_equal(one.data, other.data)


def test_units_of_coordinates_become_one():
    x = data_array()
    x.coords["x"].attrs["units"], x.coords["y"].attrs["units"], x.coords["z"].attrs["units"] = "um", "micron", "mm"
    volume = Volume(x)
    assert (volume.unit, volume.grid.spacing) == ("µm", (2.0, 1.0, 500.0))
    x.coords["z"].attrs["units"] = "seconds"
    with pytest.warns(ClvolWarning, match="z seconds"):
        Volume(x)


def test_a_slice_and_length_one_axes_of_xarray():
    assert Volume(data_array().isel(z=0)).shape == (1, 3, 4)
    more = data_array().expand_dims(time=[0], channel=[1])
    assert placed(Volume(more)) == placed(Volume(data_array()))
    assert Volume(data_array().drop_vars(["x", "y", "z"])).grid.spacing == (1.0, 1.0, 1.0)
    assert Volume(data_array(), spacing=(1, 1, 1)).grid.origin == (10.0, 5.0, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda x: x.assign_coords(x=[0, 1, 2, 4]), r"along x that are not evenly spaced, expected .*x\.interp\(x=…\)"),
        (lambda x: x.assign_coords(x=[0, 0, 0, 0]), "not evenly spaced"),
        (lambda x: x.assign_coords(x=[0, 1, 2, np.nan]), "not finite"),
        (lambda x: x.assign_coords(x=list("abcd")), r"drop_vars\('x'\)"),
        (lambda x: x.expand_dims(time=3), r"3 times along time, expected one of them: x\.isel\(time=0\)"),
        (lambda x: x.expand_dims(energy=3), r"axes of length energy 3.*transpose"),
        (lambda x: x.to_dataset(), r"an? xarray Dataset, expected one of its variables \('t'\)"),
        (lambda x: x.astype(complex), "complex"),
    ],
)
def test_what_xarray_says_in_vain_is_refused(change, message):
    with pytest.raises(VolumeError, match=message):
        Volume(change(data_array()))


@pytest.mark.parametrize("start", [0.0, 1e4])
def test_coordinates_in_single_precision_are_even(start):
    x = data_array().assign_coords(x=(start + 0.1 * np.arange(4)).astype(np.float32))
    assert Volume(x).grid.spacing[0] == pytest.approx(0.1, rel=1e-2)


# ---- SimpleITK, nibabel ------------------------------------------------------------------------------


def sitk_image() -> SimpleITK.Image:
    image = SimpleITK.GetImageFromArray(VOXELS)
    image.SetSpacing((0.5, 2.0, 3.0))
    image.SetOrigin((10.0, -20.0, 30.0))
    image.SetDirection((0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -1.0))
    return image


def test_an_image_of_simpleitk_is_what_its_file_would_be(tmp_path):
    SimpleITK.WriteImage(sitk_image(), str(tmp_path / "a.mha"))
    volume, read = Volume(sitk_image()), load_volume(tmp_path / "a.mha")
    assert (volume.grid, volume.frame, volume.unit) == (read.grid, "LPS", "mm")
    assert np.array_equal(volume.data, read.data)
    place = sitk_image().TransformIndexToPhysicalPoint((3, 1, 1))
    assert placed(volume)[tuple(np.round(place, 6) + 0.0)] == VOXELS[1, 1, 3]


def test_images_of_simpleitk_that_are_no_volume_are_refused():
    with pytest.raises(VolumeError, match="2 dimensions"):
        Volume(SimpleITK.Image(3, 3, SimpleITK.sitkInt16))
    with pytest.raises(VolumeError, match="2 components per voxel, expected one: SimpleITK.Vector"):
        Volume(SimpleITK.Image([3, 3, 3], SimpleITK.sitkVectorFloat32, 2))
    with pytest.raises(VolumeError, match=r"an image, as of SimpleITK\.ReadImage"):
        Volume(SimpleITK.AffineTransform(3))


@pytest.mark.parametrize("slope", [None, 0.5])
def test_an_image_of_nibabel_is_what_its_file_says(tmp_path, slope):
    affine = np.array([[0, -2.0, 0, 5], [1.5, 0, 0, 6], [0, 0, 3.0, 7], [0, 0, 0, 1]])
    image = nibabel.Nifti1Image(VOXELS.T.copy(), affine)
    if slope:
        image.header.set_slope_inter(slope, -3.0)
    nibabel.save(image, tmp_path / "a.nii.gz")
    read = load_volume(tmp_path / "a.nii.gz")
    volume = Volume(nibabel.load(tmp_path / "a.nii.gz"))
    assert (volume.grid, volume.frame, volume.unit) == (read.grid, read.frame, "mm")
    assert placed(volume) == pytest.approx(placed(read))
    if not slope:
        assert placed(Volume(image)) == placed(read)
        assert volume.dtype == np.int16


def test_images_of_nibabel_without_a_place_or_with_times():
    image = nibabel.Nifti1Image(VOXELS.T.copy(), None)
    image.header.set_zooms((1.0, 2.0, 3.0))
    image.header["sform_code"] = image.header["qform_code"] = 0
    volume = Volume(image)
    assert (volume.grid.spacing, volume.frame) in (((1, 2, 3), "index"), ((1, 1, 1), "index"))
    with pytest.raises(VolumeError, match=r"\(4, 3, 2, 5\), expected three dimensions: image\.slicer"):
        Volume(nibabel.Nifti1Image(np.zeros((4, 3, 2, 5), np.int16), np.eye(4)))
    assert Volume(nibabel.Nifti1Image(np.zeros((4, 3, 2, 1), np.int16), np.eye(4))).shape == (2, 3, 4)


# ---- VTK ---------------------------------------------------------------------------------------------


@pytest.fixture
def vtk_image():
    data = pytest.importorskip("vtkmodules.vtkCommonDataModel", reason="vtk (extra vtk) is not installed")
    from vtkmodules.util.numpy_support import numpy_to_vtk

    image = data.vtkImageData()
    image.SetExtent(2, 5, 0, 2, 0, 1)
    image.SetSpacing(0.5, 2.0, 3.0)
    image.SetOrigin(1.0, 2.0, 3.0)
    image.SetDirectionMatrix(0, -1, 0, 1, 0, 0, 0, 0, 1)
    array = numpy_to_vtk(VOXELS.ravel(), deep=True)
    array.SetName("density")
    image.GetPointData().SetScalars(array)
    return image


def test_an_image_of_vtk_has_its_extent_and_direction(vtk_image):
    volume = Volume(vtk_image)
    assert (volume.shape, volume.name) == ((2, 3, 4), "density")
    place = [0.0] * 3
    vtk_image.TransformIndexToPhysicalPoint((4, 1, 1), place)
    assert placed(volume)[tuple(np.round(place, 6) + 0.0)] == VOXELS[1, 1, 2]


def test_cells_of_vtk_lie_between_its_points(vtk_image):
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData

    image = vtkImageData()
    image.SetDimensions(4, 3, 2)
    cells = numpy_to_vtk(np.arange(6.0), deep=True)
    cells.SetName("c")
    image.GetCellData().AddArray(cells)
    volume = Volume(image)
    assert (volume.shape, volume.grid.origin) == ((1, 2, 3), (0.5, 0.5, 0.5))
    assert placed(volume)[(1.5, 1.5, 0.5)] == 4.0
    other = numpy_to_vtk(np.arange(6.0), deep=True)
    other.SetName("d")
    image.GetCellData().AddArray(other)
    with pytest.raises(VolumeError, match=r"no active scalars \(arrays: 'c', 'd'\)"):
        Volume(image)


# ---- zarr, dask, h5py, DLPack ------------------------------------------------------------------------


def test_arrays_in_chunks_are_read(tmp_path):
    import dask.array
    import h5py

    stored = zarr.create_array(str(tmp_path / "a.zarr"), data=VOXELS, chunks=(1, 2, 2))
    named = zarr.create_array(
        str(tmp_path / "b.zarr"), data=VOXELS.T.copy(), chunks=(2, 2, 1), dimension_names=("x", "y", "z")
    )
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["g/a"] = VOXELS
        for other in (stored, named, dask.array.from_array(VOXELS, chunks=2), file["g/a"]):
            assert np.array_equal(Volume(other).data, VOXELS)
        for group in (file, file["g"], zarr.open_group(str(tmp_path / "g.zarr"))):
            with pytest.raises(VolumeError, match=r"expected one of the arrays in it"):
                Volume(group)


class Tensor:
    """What DLPack needs, as a tensor of torch has it."""

    def __init__(self, fails: Exception | None = None, device: str = "cpu", requires_grad: bool = False) -> None:
        self._fails, self.device, self.requires_grad = fails, device, requires_grad

    def __dlpack__(self, **keys):
        if self._fails is not None:
            raise self._fails
        return VOXELS.__dlpack__(**keys)

    def __dlpack_device__(self):
        return VOXELS.__dlpack_device__()


def test_tensors_of_the_host_are_shared_and_others_refused():
    assert np.shares_memory(Volume(Tensor()).data, VOXELS)
    with pytest.raises(VolumeError, match=r"on cuda:0, expected memory of the host: x\.cpu\(\)"):
        Volume(Tensor(BufferError("no"), "cuda:0"))
    with pytest.raises(VolumeError, match=r"x\.detach\(\)"):
        Volume(Tensor(BufferError("grad"), requires_grad=True))


# ---- what is no volume -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("x.nrrd", r"a path, 'x\.nrrd', expected an array; clvol\.load_volume\('x\.nrrd'\)"),
        ({"file": "x"}, r"a dict, expected .*clvol\.Scene\(volume=\{\.\.\.\}\)"),
        (None, "None, expected an array"),
        (3, "an object of type int"),
        (object(), "an object of type object"),
        (np.zeros((2, 2)), "2-D array"),
        (np.zeros((2, 2, 2, 3)), "4-D array"),
        (np.ma.zeros((2, 2, 2)), "masked"),
        (np.array([["a"]]), "type"),
    ],
)
def test_errors_say_what_to_write_instead(given, message):
    with pytest.raises(VolumeError, match=message) as caught:
        Volume(given)
    assert "\n" not in str(caught.value)


def test_a_scalar_spacing_is_refused_with_three():
    with pytest.raises(VolumeError, match=r"spacing: got 0.5, expected three .* such as \(0.5, 0.5, 0.5\)"):
        Volume(VOXELS, spacing=0.5)


def test_no_library_is_imported_for_an_array():
    libraries = {"xarray", "SimpleITK", "nibabel", "vtkmodules", "zarr", "dask", "h5py"}
    code = (
        "import numpy, sys, clvol; clvol.Volume(numpy.zeros((2, 2, 2)))\n"
        f"sys.exit(', '.join({libraries} & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
