"""Formats that come with extras: HDF5, Imaris, netCDF, MRC, VTI, CZI; type, values, axes and places come through."""

from __future__ import annotations

import sys

import h5py
import mrcfile
import netCDF4
import numpy as np
import pytest

from clvol import load_volume
from clvol.errors import ClvolWarning, VolumeError
from clvol.readers.recognise import ENDINGS

VOXELS = np.arange(24, dtype=np.int16).reshape(2, 3, 4)  # [z, y, x]


def place(volume, x, y, z) -> list[float]:
    return (volume.grid.index_to_world() @ [x, y, z, 1.0])[:3].round(5).tolist()


# ---- HDF5 --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["u1", "<i2", ">u2", "f4", ">f8", "?"])
def test_hdf5_keeps_type_and_values(tmp_path, dtype):
    data = VOXELS.astype(dtype)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("g/data", data=data, chunks=(1, 2, 2), compression="gzip")
        file["note"] = "text"
    volume = load_volume(tmp_path / "a.h5")
    assert not volume.is_read and volume.name == "data" and volume.frame == "index"
    assert np.array_equal(volume.data, data) and volume.data.flags.c_contiguous
    assert volume.dtype == (np.uint8 if dtype == "?" else np.dtype(dtype).newbyteorder("="))
    assert np.array_equal(volume.box(0, 1, 1, 3, 2, 4), data[0:1, 1:3, 2:4])


def test_one_of_several_arrays_of_hdf5_is_named(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"], file["b/c"], file["list"] = VOXELS, VOXELS.astype("i8") + 70000, np.arange(9)
        file["out"] = h5py.ExternalLink("other.h5", "/x")
    assert load_volume(tmp_path / "a.h5", series="/b/c").value_range == (70000, 70023)
    assert load_volume(tmp_path / "a.h5", series=0).dtype == np.int16
    with pytest.raises(VolumeError, match=r'2 series: 0 "/a", 1 "/b/c", expected volume\.series'):
        load_volume(tmp_path / "a.h5")
    with pytest.raises(VolumeError, match="among 2 series"):
        load_volume(tmp_path / "a.h5", series="/out")


def test_axes_and_places_of_hdf5(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["data"] = np.stack([VOXELS.T, VOXELS.T + 100])  # [c, x, y, z]
        for axis, name in enumerate("cxyz"):
            file["data"].dims[axis].label = name
        file["px"] = np.array([5.0, 7.0, 9.0, 11.0])
        file["px"].attrs["units"] = "mm"
        file["px"].make_scale("x")
        file["data"].dims[1].attach_scale(file["px"])
    volume = load_volume(tmp_path / "a.h5", channel=1)
    assert np.array_equal(volume.data, VOXELS + 100)
    assert place(volume, 2, 0, 0) == [9.0, 0.0, 0.0] and volume.grid.spacing == (2.0, 1.0, 1.0)
    with pytest.raises(VolumeError, match=r"2 channels: 0, 1, expected volume\.channel"):
        load_volume(tmp_path / "a.h5")
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["data"] = VOXELS
        file["data"].attrs["element_size_um"] = [3.0, 2.0, 0.5]
    volume = load_volume(tmp_path / "b.h5")
    assert (volume.grid.spacing, volume.unit) == ((0.5, 2.0, 3.0), "µm")


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda file: None, "no numeric array"),
        (lambda file: file.create_dataset("a", data=np.zeros((2, 2, 2, 2, 2))), r"an array of shape \[2, 2, 2, 2, 2\]"),
        (lambda file: file.create_dataset("a", data=np.zeros((2, 2, 2), complex)), "complex"),
        (lambda file: file.create_dataset("a", shape=(2**20, 2**20, 2**20), chunks=(1, 64, 64)), "needs"),
        (lambda file: file.create_dataset("a", shape=(4, 4, 4), maxshape=(None,) * 3, chunks=(2**10,) * 3), "needs"),
    ],
)
def test_hdf5_without_a_volume_is_refused(tmp_path, write, message):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        write(file)
    with pytest.raises(VolumeError, match=message) as caught:
        _ = load_volume(tmp_path / "a.h5", memory_cap=2**30).data
    assert str(tmp_path / "a.h5") in str(caught.value)


# ---- Imaris ------------------------------------------------------------------------------------------


def write_imaris(path, channels: int = 1) -> None:
    def text(value: str) -> np.ndarray:
        return np.array([letter.encode() for letter in value], dtype="S1")

    with h5py.File(path, "w") as file:
        info = file.create_group("DataSetInfo/Image")
        for key, value in {"X": "4", "Y": "3", "Z": "2", "Unit": "um"}.items():
            info.attrs[key] = text(value)
        for k, (low, high) in enumerate([(10, 12), (-3, 3), (0, 10)]):
            info.attrs[f"ExtMin{k}"], info.attrs[f"ExtMax{k}"] = text(str(low)), text(str(high))
        for c in range(channels):
            padded = np.zeros((2, 4, 8), np.int16)
            padded[:, :3, :4] = VOXELS + 100 * c
            file[f"DataSet/ResolutionLevel 0/TimePoint 0/Channel {c}/Data"] = padded
            file.create_group(f"DataSetInfo/Channel {c}").attrs["Name"] = text(f"dye {c}")


def test_imaris_has_its_extent_and_no_padding(tmp_path):
    write_imaris(tmp_path / "a.ims", channels=2)
    volume = load_volume(tmp_path / "a.ims", channel="dye 1")
    assert np.array_equal(volume.data, VOXELS + 100) and volume.unit == "µm"
    assert volume.grid.spacing == (0.5, 2.0, 5.0) and place(volume, 0, 0, 0) == [10.25, -2.0, 2.5]
    with pytest.raises(VolumeError, match='2 channels: 0 "dye 0", 1 "dye 1"'):
        load_volume(tmp_path / "a.ims")
    with h5py.File(tmp_path / "b.ims", "w") as file:
        file["a"] = VOXELS
    with pytest.raises(VolumeError, match="no data set of Imaris"):
        load_volume(tmp_path / "b.ims")


# ---- netCDF ------------------------------------------------------------------------------------------


def write_netcdf(path, form: str = "NETCDF4", fill: int | None = None) -> None:
    with netCDF4.Dataset(path, "w", format=form) as file:
        for name, values in {"x": [0.0, 2.0, 4.0, 6.0], "y": [3.0, 2.0, 1.0], "z": [10.0, 15.0]}.items():
            file.createDimension(name, len(values))
            coordinate = file.createVariable(name, "f8", (name,))
            coordinate[:], coordinate.units = values, "m"
        variable = file.createVariable("density", "i2", ("x", "z", "y"), fill_value=fill)
        variable.set_auto_maskandscale(False)
        variable[:] = VOXELS.transpose(2, 0, 1)
        variable.scale_factor, variable.add_offset = 0.5, 100.0


@pytest.mark.parametrize("form", ["NETCDF4", "NETCDF3_CLASSIC"])
def test_netcdf_has_coordinates_and_a_scaling(tmp_path, form):
    write_netcdf(tmp_path / "a.nc", form)
    volume = load_volume(tmp_path / "a.nc")
    assert np.array_equal(volume.data, VOXELS) and (volume.slope, volume.offset) == (0.5, 100.0)
    assert place(volume, 1, 2, 1) == [2.0, 1.0, 15.0] and (volume.unit, volume.name) == ("m", "density")


def test_fill_values_of_netcdf_are_transparent(tmp_path):
    write_netcdf(tmp_path / "a.nc", fill=5)
    volume = load_volume(tmp_path / "a.nc")
    assert volume.dtype == np.float32 and volume.nan_count == 1 and np.isnan(volume.data[0, 1, 1])
    assert volume.value_range == (100.0, 111.5)


def test_uneven_coordinates_of_netcdf_are_told(tmp_path):
    write_netcdf(tmp_path / "a.nc")
    with netCDF4.Dataset(tmp_path / "a.nc", "a") as file:
        file["x"][:] = [0, 1, 5, 9]
        file.createVariable("speed", "f4", ("z", "y", "x"))
    with pytest.warns(ClvolWarning, match="coordinates along x are not evenly spaced"):
        assert load_volume(tmp_path / "a.nc", series="density").grid.spacing[0] == 1.0
    with pytest.raises(VolumeError, match='2 series: 0 "density", 1 "speed"'):
        load_volume(tmp_path / "a.nc")


@pytest.mark.parametrize("form", ["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF3_64BIT_DATA"])
@pytest.mark.parametrize("others", [0, 1])
def test_a_classic_netcdf_that_ends_early_is_refused(tmp_path, form, others):
    """The library would read zeros."""
    with netCDF4.Dataset(tmp_path / "a.nc", "w", format=form) as file:
        file.title = "records"
        for name, n in (("t", None), ("z", 2), ("y", 3), ("x", 3)):
            file.createDimension(name, n)
        for k in range(others):
            file.createVariable(f"o{k}", "i1", ("t",))
        file.createVariable("v", "i1", ("t", "z", "y", "x"))[:] = np.arange(1, 55, dtype=np.int8).reshape(3, 2, 3, 3)
        for k in range(others):
            file[f"o{k}"][:] = 1
    whole = (tmp_path / "a.nc").read_bytes()
    assert load_volume(tmp_path / "a.nc", time=2).data.ravel().tolist() == list(range(37, 55))
    end = whole.rindex(bytes([53, 54])) + 2
    (tmp_path / "b.nc").write_bytes(whole[:end])
    assert load_volume(tmp_path / "b.nc", time=2).data.max() == 54
    (tmp_path / "b.nc").write_bytes(whole[: end - 1])
    with pytest.raises(VolumeError, match=f"{end - 1} bytes, expected {end} bytes as the header promises"):
        load_volume(tmp_path / "b.nc", time=2)


# ---- MRC ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", ["i1", "i2", "u2", "f4", "f2"])
@pytest.mark.parametrize("name", ["a.mrc", "a.map"])
def test_mrc_has_cell_and_origin(tmp_path, dtype, name):
    with mrcfile.new(tmp_path / name) as file:
        file.set_data(VOXELS.astype(dtype))
        file.voxel_size = (0.5, 2.0, 3.0)
        file.header.origin = (10.0, 20.0, -30.0)
    volume = load_volume(tmp_path / name)
    assert np.array_equal(volume.data, VOXELS) and volume.unit == "Å"
    assert place(volume, 3, 1, 1) == [11.5, 22.0, -27.0]


def test_axes_of_mrc_in_another_order(tmp_path):
    with mrcfile.new(tmp_path / "a.mrc") as file:
        file.set_data(np.ascontiguousarray(VOXELS.transpose(2, 0, 1)).astype(np.float32))  # sections are x, rows z
        file.header.mapc, file.header.mapr, file.header.maps = 2, 3, 1
        file.header.mx, file.header.my, file.header.mz = 4, 3, 2
        file.header.cella = (2.0, 6.0, 6.0)
        file.header.nxstart, file.header.nystart, file.header.nzstart = 1, 0, 4
    volume = load_volume(tmp_path / "a.mrc")
    assert np.array_equal(volume.data, VOXELS)
    assert place(volume, 1, 1, 1) == [2.5, 4.0, 3.0]


def test_a_skewed_cell_of_mrc_is_a_skewed_grid(tmp_path):
    with mrcfile.new(tmp_path / "a.mrc") as file:
        file.set_data(VOXELS)
        file.voxel_size = 1.0
        file.header.cellb = (90.0, 90.0, 120.0)
    volume = load_volume(tmp_path / "a.mrc")
    assert place(volume, 0, 2, 1) == pytest.approx([-1.0, 3**0.5, 1.0], abs=1e-4)


def test_mrc_without_a_cell_and_with_damage(tmp_path):
    with mrcfile.new(tmp_path / "a.mrc") as file:
        file.set_data(VOXELS)
        file.header.cella = (0.0, 0.0, 0.0)
    with pytest.warns(ClvolWarning, match="no unit cell; the spacing is 1"):
        assert load_volume(tmp_path / "a.mrc").unit is None
    raw = bytearray((tmp_path / "a.mrc").read_bytes())
    for at, value, message in ((0, 2**30, "needs|unreadable"), (12, 4, "complex"), (12, 77, "mode 77|unreadable")):
        damaged = bytearray(raw)
        damaged[at : at + 4] = value.to_bytes(4, "little")
        (tmp_path / "b.mrc").write_bytes(damaged)
        with pytest.raises(VolumeError, match=message):
            load_volume(tmp_path / "b.mrc", memory_cap=2**30)
    (tmp_path / "b.mrc").write_bytes(raw[:-7])
    with pytest.raises(VolumeError, match=r"b\.mrc"):
        load_volume(tmp_path / "b.mrc")


# ---- VTI, CZI ----------------------------------------------------------------------------------------


def test_vti_has_its_grid_and_several_arrays(tmp_path):
    xml = pytest.importorskip("vtkmodules.vtkIOXML", reason="vtk (extra vtk) is not installed")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData

    image = vtkImageData()
    image.SetDimensions(4, 3, 2)
    image.SetSpacing(0.5, 2.0, 3.0)
    image.SetOrigin(1.0, 2.0, 3.0)
    for name, more in (("a", 0), ("b", 100)):
        array = numpy_to_vtk(VOXELS.ravel() + more, deep=True)
        array.SetName(name)
        image.GetPointData().AddArray(array)
    writer = xml.vtkXMLImageDataWriter()
    writer.SetFileName(str(tmp_path / "a.vti"))
    writer.SetInputData(image)
    writer.Write()
    volume = load_volume(tmp_path / "a.vti", series="b")
    assert np.array_equal(volume.data, VOXELS + 100) and place(volume, 3, 1, 1) == [2.5, 4.0, 6.0]
    with pytest.raises(VolumeError, match='2 series: 0 "a", 1 "b"'):
        load_volume(tmp_path / "a.vti")
    (tmp_path / "b.vti").write_bytes((tmp_path / "a.vti").read_bytes()[:300])
    with pytest.raises(VolumeError, match=r"b\.vti: (no image data|damaged)"):
        load_volume(tmp_path / "b.vti")


def test_czi_has_its_pixel_size_and_channels(tmp_path):
    pytest.importorskip("bioio_czi", reason="bioio-czi (extra microscopy) is not installed")
    czi = pytest.importorskip("pylibCZIrw.czi", reason="pylibCZIrw (extra microscopy) is not installed")
    data = VOXELS.astype(np.uint16)
    with czi.create_czi(str(tmp_path / "a.czi")) as file:
        for c in range(2):
            for z in range(2):
                file.write(data=data[z][..., None] + 100 * c, plane={"C": c, "Z": z, "T": 0})
        file.write_metadata("a", scale_x=0.5e-6, scale_y=2e-6, scale_z=3e-6)
    volume = load_volume(tmp_path / "a.czi", channel=1)
    assert np.array_equal(volume.data, data + 100)
    assert volume.grid.spacing == pytest.approx((0.5, 2.0, 3.0)) and volume.unit == "µm"
    with pytest.raises(VolumeError, match="2 channels"):
        load_volume(tmp_path / "a.czi")


# ---- all ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ending", "library", "extra"),
    [
        (".h5", "h5py", "hdf5"),
        (".ims", "h5py", "hdf5"),
        (".nc", "netCDF4", "netcdf"),
        (".mrc", "mrcfile", "mrc"),
        (".vti", "vtkmodules", "vtk"),
        (".czi", "bioio", "microscopy"),
        (".nd2", "bioio", "microscopy"),
    ],
)
def test_a_missing_library_names_its_extra(tmp_path, monkeypatch, ending, library, extra):
    for name in [library, *(name for name in sys.modules if name.startswith(f"{library}."))]:
        monkeypatch.setitem(sys.modules, name, None)  # makes its import fail
    (tmp_path / f"a{ending}").write_bytes(b"x")
    with pytest.raises(VolumeError, match=rf"{library} is not installed, expected pip install 'clvol\[{extra}\]'"):
        load_volume(tmp_path / f"a{ending}")


@pytest.mark.parametrize("ending", [".h5", ".ims", ".nc", ".mrc", ".mrc.gz", ".vti", ".czi", ".nd2"])
def test_garbage_is_refused_in_one_line(tmp_path, ending, capfd):
    assert ending in ENDINGS
    (tmp_path / f"a{ending}").write_bytes(b"\x89garbage" * 300)
    with pytest.raises(VolumeError) as caught:
        load_volume(tmp_path / f"a{ending}")
    assert str(caught.value).startswith(str(tmp_path)) and "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_openvdb_is_refused_with_a_way(tmp_path):
    (tmp_path / "a.vdb").write_bytes(b"x")
    with pytest.raises(VolumeError, match=r"\.vdb cannot be read, expected .*numpy\.save"):
        load_volume(tmp_path / "a.vdb")
