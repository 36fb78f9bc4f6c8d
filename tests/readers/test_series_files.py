"""Series in files: patterns, lists, and files with an axis of times, each step as it would be read alone."""

from __future__ import annotations

import gzip
import http.server
import json
import os
import threading
import warnings

import nibabel
import nrrd
import numpy as np
import pytest
import tifffile
import zarr

from clvol import Scene, load_volume
from clvol.errors import ClvolWarning, SceneError, VolumeError
from clvol.readers import samples
from clvol.readers.series import file_series, files_of

RNG = np.random.default_rng(3)
TIMES = RNG.integers(0, 300, (4, 3, 5, 6)).astype(np.int16)
TIMES[2] //= 9


@pytest.fixture(autouse=True)
def cache(tmp_path_factory, monkeypatch):
    """A cache folder of its own for every test."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setattr("clvol.cache_folder.cache_folder", lambda: folder)
    return folder


def written(folder, names, values=None) -> list[str]:
    """.npy files; the k-th holds ``values[k]``, by default k."""
    for k, name in enumerate(names):
        (folder / name).parent.mkdir(exist_ok=True)
        np.save(folder / name, np.full((2, 3, 4), k if values is None else values[k], np.uint8))
    return [str(folder / name) for name in names]


def series_of(folder, file, **keys):
    scene = Scene.from_data({"version": 1, "volume": {"file": file, **keys}}, "s.toml", folder)
    return scene.load_series()


def values_of(series) -> list[int]:
    return [int(series.step(k).data[0, 0, 0]) for k in range(len(series))]


# ---- patterns and lists


def test_numbers_in_names_are_in_their_order(tmp_path):
    written(tmp_path, ["t_10.npy", "t_2.npy", "t_1.npy", "t_100.npy", "other.npy"])
    assert values_of(series_of(tmp_path, "t_*.npy")) == [2, 1, 0, 3]


def test_a_thousand_names(tmp_path):
    written(tmp_path, [f"{k}.npy" for k in range(1000)], [k % 251 for k in range(1000)])
    files = files_of(["*.npy"], tmp_path, "volume.file")
    assert [os.path.basename(file) for file in files] == [f"{k}.npy" for k in range(1000)]
    series = series_of(tmp_path, "*.npy", value_range=[0, 250])
    assert len(series) == 1000 and int(series.step(999).data.max()) == 999 % 251 and series.reads == 2


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("t_?.npy", [0, 1]), ("t_[12].npy", [0, 1]), ("*/t_*.npy", [3, 4]), ("[u]_*.npy", [5, 6]),
        ("t_[!3]*.npy", [0, 1, 2]),
    ],
)
def test_patterns(tmp_path, pattern, expected):
    written(tmp_path, ["t_1.npy", "t_2.npy", "t_10.npy", "a/t_1.npy", "b/t_1.npy", "u_1.npy", "u_2.npy"])
    assert values_of(series_of(tmp_path, pattern)) == expected


def test_names_with_the_characters_of_patterns(tmp_path):
    folder = tmp_path / "run [1]*"
    written(folder, ["t_[1].npy", "t_[2].npy", "t_1.npy"])
    assert values_of(series_of(folder, "t_?[12]?.npy")) == [0, 1]
    one = Scene.from_data({"version": 1, "volume": {"file": "t_[1].npy"}}, "s.toml", folder)
    assert one.load_series() is None and one.load_volume().data.max() == 0  # a file of exactly this name is that file


@pytest.mark.parametrize(
    ("pattern", "what"), [("x_*.npy", "no file is named like"), ("t_*.npy", "only '.*t_7.npy' is")]
)
def test_patterns_of_no_file_and_of_one_are_refused(tmp_path, pattern, what):
    written(tmp_path, ["t_7.npy"])
    with pytest.raises(SceneError, match=rf"^s.toml: volume.file: {what} .*, expected a pattern of two files"):
        series_of(tmp_path, pattern)


def test_lists_keep_their_order_and_what_is_in_them_twice(tmp_path):
    written(tmp_path, ["a.npy", "b.npy", "sub/c.npy"])
    assert values_of(series_of(tmp_path, ["sub/c.npy", "b.npy", "a.npy", "b.npy"])) == [2, 1, 0, 1]
    assert values_of(series_of(tmp_path, [str(tmp_path / "b.npy")])) == [1]  # a series of one step
    assert values_of(series_of(tmp_path / "sub", ["../a.npy", "c.npy"])) == [0, 2]


def test_a_missing_file_of_a_list_is_named(tmp_path):
    written(tmp_path, ["a.npy", "c.npy"])
    series = series_of(tmp_path, ["a.npy", "b.npy", "c.npy"])
    with pytest.warns(ClvolWarning, match=r"1 step of 3 cannot be read: step 1, .*b.npy: no such file"):
        assert series.step(2).value_range == (0.0, 1.0)
    with pytest.raises(VolumeError, match=r"b.npy: no such file"):
        _ = series.step(1).data


def test_a_step_that_differs_is_named_by_its_file(tmp_path):
    written(tmp_path, ["t_1.npy", "t_2.npy", "t_3.npy"])
    np.save(tmp_path / "t_2.npy", np.zeros((2, 3, 5), np.uint8))
    with pytest.raises(VolumeError, match=r"t_2.npy: 5 x 3 x 2 voxels, expected 4 x 3 x 2, as .*t_1.npy has"):
        _ = series_of(tmp_path, "t_*.npy").facts


def test_nan_is_replaced_in_every_step(tmp_path):
    for k in range(3):
        array = np.full((2, 2, 2), float(k), np.float32)
        array[0, 0, 0] = np.nan if k else 5.0
        np.save(tmp_path / f"t_{k}.npy", array)
    series = series_of(tmp_path, "t_*.npy", nan=-7.0)
    assert series.step(0).value_range == (-7.0, 5.0) and series.step(0).nan_count == 0
    assert series.step(2).data[0, 0, 0] == -7.0
    assert series_of(tmp_path, "t_*.npy").step(0).nan_count == 1  # in another step


def test_a_file_that_changes_is_named(tmp_path):
    files = written(tmp_path, ["t_1.npy", "t_2.npy", "t_3.npy"])
    series = series_of(tmp_path, "t_*.npy")
    assert values_of(series) == [0, 1, 2]
    np.save(files[1], np.full((2, 3, 4), 9, np.uint8))
    os.utime(files[1], ns=(1, 1))
    with pytest.raises(VolumeError, match=r"t_2.npy: has changed since it was read first"):
        _ = series.step(1).data
    assert int(series.step(0).data.max()) == 0


# ---- times in a file


def _nifti(path, array):
    nibabel.save(nibabel.Nifti1Image(array.transpose(3, 2, 1, 0), np.eye(4)), path)


def _nrrd(encoding="raw"):
    header = {"encoding": encoding, "kinds": ["domain"] * 3 + ["time"]}
    return lambda path, array: nrrd.write(str(path), array, header, index_order="C")


def _fastest(path, array):
    kinds = {"encoding": "gzip", "kinds": ["time"] + ["domain"] * 3}
    nrrd.write(str(path), np.ascontiguousarray(array.transpose(1, 2, 3, 0)), kinds, index_order="C")


def _metaimage(path, array):
    sizes = " ".join(map(str, array.shape[::-1]))
    head = f"ObjectType = Image\nNDims = 4\nDimSize = {sizes}\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    path.write_bytes(head.encode() + array.astype("<i2").tobytes())


def _zarr(path, array):
    zarr.create_array(str(path), data=array, chunks=(1, *array.shape[1:]), dimension_names=["t", "z", "y", "x"])


def _hdf5(path, array):
    h5py = pytest.importorskip("h5py", reason="h5py comes with an extra")
    with h5py.File(path, "w") as file:
        file["v"] = array
        for dim, label in zip(file["v"].dims, "tzyx"):
            dim.label = label


WRITERS = {
    "a.nii": _nifti, "a.nii.gz": _nifti, "raw.nrrd": _nrrd(), "gz.nrrd": _nrrd("gzip"), "bz.nrrd": _nrrd("bzip2"),
    "fastest.nrrd": _fastest, "a.mha": _metaimage, "a.zarr": _zarr, "a.h5": _hdf5,
    "a.ome.tif": lambda path, array: tifffile.imwrite(path, array, metadata={"axes": "TZYX"}),
    "a.npy": np.save,
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_every_time_of_a_file_is_a_step(tmp_path, name):
    WRITERS[name](tmp_path / name, TIMES)
    series = series_of(tmp_path, name, time="all")
    assert len(series) == 4
    for k in (0, 1, 2, 3, 1, 0):
        np.testing.assert_array_equal(series.step(k).data, TIMES[k])
        assert series.step(k).value_range == (TIMES.min(), TIMES.max())
    one = load_volume(tmp_path / name, time=2)
    np.testing.assert_array_equal(one.data, TIMES[2])
    assert one.grid == series.step(2).grid
    with pytest.raises(VolumeError, match="times|4-D"):
        load_volume(tmp_path / name)
    with pytest.raises(VolumeError, match="time = 'all', where one of 4 times is read"):
        load_volume(tmp_path / name, time="all")


def test_times_that_are_numbered_otherwise(tmp_path):
    """Slices of a folder are counted as their names say."""
    for t in range(3):
        for z in range(3):
            tifffile.imwrite(tmp_path / f"img_t{t + 7:03d}_z{z}.tif", TIMES[t, z].astype(np.uint16))
    series = series_of(tmp_path.parent, tmp_path.name, time="all")
    assert [step.name.rpartition(" ")[2] for step in series.steps] == ["7", "8", "9"]
    for t in range(3):
        np.testing.assert_array_equal(series.step(t).data, TIMES[t])


@pytest.mark.parametrize("name", ["a.nii.gz", "gz.nrrd", "bz.nrrd"])
def test_compressed_times_are_decoded_once_for_each_pass(tmp_path, name, monkeypatch):
    WRITERS[name](tmp_path / name, TIMES)
    begun = []
    decoded = samples._decoded
    monkeypatch.setattr(samples, "_decoded", lambda *given: begun.append(1) or decoded(*given))
    series = series_of(tmp_path, name, time="all")
    _ = series.facts
    assert len(begun) == 1
    assert [int(series.step(k).data[0, 0, 0]) for k in range(4)] == TIMES[:, 0, 0, 0].tolist()
    assert len(begun) == 2


def test_damaged_times_of_a_file_leave_those_before(tmp_path):
    path = tmp_path / "a.nii.gz"
    rough = RNG.integers(0, 2**15, (6, 8, 16, 16)).astype(np.int16)
    _nifti(path, rough)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    series = series_of(tmp_path, "a.nii.gz", time="all")
    with pytest.warns(ClvolWarning, match="cannot be read: step"):
        _ = series.facts
    np.testing.assert_array_equal(series.step(1).data, rough[1])
    with pytest.raises(VolumeError, match=r"a.nii.gz: time 5: compressed data"):
        _ = series.step(5).data
    np.testing.assert_array_equal(series.step(0).data, rough[0])


def test_channels_are_no_times(tmp_path):
    nrrd.write(str(tmp_path / "c.nrrd"), TIMES, {"kinds": ["domain"] * 3 + ["vector"]}, index_order="C")
    tifffile.imwrite(tmp_path / "c.ome.tif", TIMES, metadata={"axes": "CZYX"})
    zarr.create_array(str(tmp_path / "c.zarr"), data=TIMES, dimension_names=["c", "z", "y", "x"])
    for name in ("c.nrrd", "c.ome.tif", "c.zarr"):
        with pytest.raises(VolumeError, match="4 channels: .* expected volume.channel = one of them"):
            _ = series_of(tmp_path, name, time="all").facts
        series = series_of(tmp_path, name, time="all", channel=2)  # which has one time
        assert len(series) == 1
        np.testing.assert_array_equal(series.step(0).data, TIMES[2])


def test_holes_of_one_time_give_all_times_a_type_for_them(tmp_path):
    netcdf = pytest.importorskip("netCDF4", reason="netCDF4 comes with an extra")
    with netcdf.Dataset(tmp_path / "a.nc", "w") as file:
        for name, n in zip("tzyx", TIMES.shape):
            file.createDimension(name, n)
        variable = file.createVariable("v", "i2", tuple("tzyx"), fill_value=-1)
        array = TIMES.copy()
        array[3, 0, 0, 0] = -1
        variable.set_auto_maskandscale(False)
        variable[:] = array
    series = series_of(tmp_path, "a.nc", time="all")
    assert {series.step(k).data.dtype for k in range(4)} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(series.step(1).data, TIMES[1])
    assert np.isnan(series.step(3).data[0, 0, 0]) and series.step(0).nan_count == 1


def test_all_times_of_several_files_are_refused(tmp_path):
    written(tmp_path, ["t_1.npy", "t_2.npy"])
    with pytest.raises(SceneError, match="volume.time: got 'all' with 2 files"):
        series_of(tmp_path, "t_*.npy", time="all")
    with pytest.raises(SceneError, match="volume.file: got 'no.nii', no such file"):
        series_of(tmp_path, "no.nii", time="all")


def test_one_time_of_each_of_several_files(tmp_path):
    for k in range(3):
        _nifti(tmp_path / f"p_{k}.nii", TIMES + k)
    series = series_of(tmp_path, "p_*.nii", time=1)
    for k in range(3):
        np.testing.assert_array_equal(series.step(k).data, TIMES[1] + k)


def test_times_of_a_remote_image(tmp_path):
    _zarr(tmp_path / "a.zarr", TIMES)

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *given) -> None:
            super().__init__(*given, directory=str(tmp_path))

        def log_message(self, *_) -> None:
            pass

    served = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=served.serve_forever, daemon=True).start()
    try:
        url = f"http://127.0.0.1:{served.server_port}/a.zarr"
        series = series_of(tmp_path, url, time="all")
        assert len(series) == 4
        np.testing.assert_array_equal(series.step(3).data, TIMES[3])
        listed = series_of(tmp_path, [url, url], time=2)
        np.testing.assert_array_equal(listed.step(1).data, TIMES[2])
    finally:
        served.shutdown()
        served.server_close()


# ---- what is known of the range


def test_ranges_are_kept_for_as_long_as_files_stay_as_they_are(tmp_path, cache):
    files = written(tmp_path, ["t_1.npy", "t_2.npy", "t_3.npy"])
    first = series_of(tmp_path, "t_*.npy")
    assert first.facts.census.upper == 2 and first.reads == 3
    again = series_of(tmp_path, "t_*.npy")
    assert again.facts == first.facts and again.reads == 0
    np.save(files[1], np.full((2, 3, 4), 77, np.uint8))
    os.utime(files[1], ns=(5, 5))
    written(tmp_path, ["t_4.npy"], [99])
    more = series_of(tmp_path, "t_*.npy")  # reads the one that has changed, and the one that is new
    assert more.facts.census.upper == 99 and more.reads == 2
    assert series_of(tmp_path, "t_*.npy", slope=2.0).facts.axis.slope == 2.0


@pytest.mark.parametrize("text", ["", "[]", "{", '{"a": 1}', "null", '{"%s:": {"shape": "x"}}', '{"%s:": 3}'])
def test_a_damaged_cache_is_no_harm(tmp_path, cache, text):
    files = written(tmp_path, ["t_1.npy", "t_2.npy"])
    assert series_of(tmp_path, "t_*.npy").facts.census.upper == 1
    (kept,) = (cache / "series").iterdir()
    assert json.loads(kept.read_text())
    kept.write_text(text.replace("%s", files[0]))
    again = series_of(tmp_path, "t_*.npy")
    assert again.facts.census.upper == 1 and again.reads == 2


def test_no_cache_is_no_harm(tmp_path, monkeypatch):
    written(tmp_path, ["t_1.npy", "t_2.npy"])
    for place in (None, tmp_path / "t_1.npy"):
        monkeypatch.setattr("clvol.cache_folder.cache_folder", lambda place=place: place)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert series_of(tmp_path, "t_*.npy").facts.census.upper == 1


def test_what_a_reader_warns_of_is_said_once(tmp_path):
    for k in range(4):
        head = 'NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\nunits: "mm" "kg" "mm"\n\n'
        (tmp_path / f"t_{k}.nrrd").write_bytes(head.encode() + bytes(8))
    with pytest.warns(ClvolWarning) as caught:
        series = file_series(files_of(["t_*.nrrd"], tmp_path, ""), {})
        _ = series.facts
        values_of(series)
    assert len(caught) == 1 and "units" in str(caught[0].message)


def test_stored_gzip_is_not_mistaken(tmp_path):
    """A stream in two members, as some writers make them."""
    _nifti(tmp_path / "plain.nii", TIMES)
    raw = (tmp_path / "plain.nii").read_bytes()
    (tmp_path / "a.nii.gz").write_bytes(gzip.compress(raw[:500]) + gzip.compress(raw[500:]))
    series = series_of(tmp_path, "a.nii.gz", time="all")
    for k in (3, 0, 2):
        np.testing.assert_array_equal(series.step(k).data, TIMES[k])
