"""TIFF files of several images, hyperstacks, and folders of slices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile
from slice_files import SHAPE, loaded, refusal, voxels

from clvol.readers import load_volume

COMPRESSIONS = [None, "zlib", "lzw", "packbits", "zstd", "jpeg2000"]


@pytest.mark.parametrize("bigtiff", [False, True])
@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_frames_written_one_by_one(tmp_path, bigtiff, compression, dtype) -> None:
    with tifffile.TiffWriter(tmp_path / "v.tif", bigtiff=bigtiff) as writer:
        for plane in voxels(dtype):
            writer.write(plane, compression=compression, photometric="minisblack")
    volume, warned = loaded(tmp_path / "v.tif")
    assert np.array_equal(volume.data, voxels(dtype)) and warned == ""


@pytest.mark.parametrize("predictor", [False, True])
@pytest.mark.parametrize("tile", [None, (16, 16)])
@pytest.mark.parametrize("compression", ["lzw", "zlib"])
@pytest.mark.parametrize("dtype", ["int16", "float32"])
def test_compressed_tiles_and_strips(tmp_path, predictor, tile, compression, dtype) -> None:
    array = np.random.default_rng(1).normal(0, 99, (3, 37, 50)).astype(dtype)
    options = dict(rowsperstrip=5) if tile is None else dict(tile=tile)
    tifffile.imwrite(
        tmp_path / "v.tif",
        array,
        compression=compression,
        predictor=predictor,
        photometric="minisblack",
        **options,
    )
    assert np.array_equal(load_volume(tmp_path / "v.tif").data, array)


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_one_bit_a_voxel(tmp_path, compression) -> None:
    array = voxels("uint8") % 3 == 0
    tifffile.imwrite(
        tmp_path / "v.tif", array, photometric="minisblack", compression=compression
    )
    assert np.array_equal(load_volume(tmp_path / "v.tif").data, array)


def test_frames_of_an_ome_file_written_one_by_one(tmp_path) -> None:
    with tifffile.TiffWriter(tmp_path / "v.ome.tif") as writer:
        for plane in voxels():
            writer.write(plane, photometric="minisblack")
    assert np.array_equal(load_volume(tmp_path / "v.ome.tif").data, voxels())


def test_a_thumbnail_is_no_slice(tmp_path) -> None:
    with tifffile.TiffWriter(tmp_path / "v.tif") as writer:
        writer.write(voxels(), photometric="minisblack")
        writer.write(voxels()[0, ::2, ::2], photometric="minisblack", subfiletype=1)
    volume, warned = loaded(tmp_path / "v.tif")
    assert np.array_equal(volume.data, voxels())


def hyperstack(dtype: str = "uint8") -> np.ndarray:
    """[t, z, c, y, x], 3 times and 2 channels."""
    return np.stack(
        [np.stack([voxels(dtype) + 10 * t + c for c in range(2)], 1) for t in range(3)]
    )


def written(path: Path, kind: str, compression: str | None = None) -> Path:
    if kind == "imagej":
        tifffile.imwrite(path, hyperstack(), imagej=True, metadata=dict(axes="TZCYX"))
        return path
    metadata: dict = dict(axes="TZCYX")
    if kind == "ome":
        path = path.with_suffix(".ome.tif")
        metadata["Channel"] = {"Name": ["DAPI", "GFP"]}
    tifffile.imwrite(
        path,
        hyperstack(),
        ome=kind == "ome",
        metadata=metadata,
        photometric="minisblack",
        compression=compression,
    )
    return path


@pytest.mark.parametrize("kind", ["imagej", "ome", "plain"])
@pytest.mark.parametrize("compression", [None, "zlib"])
def test_channel_and_time_of_a_hyperstack(tmp_path, kind, compression) -> None:
    path = written(tmp_path / "v.tif", kind, compression)
    assert "2 channels: 0" in refusal(path) and "volume.channel" in refusal(path)
    assert "3 times: 0, 1, 2, expected volume.time" in refusal(path, channel=0)
    for t in range(3):
        for c in range(2):
            volume, _ = loaded(path, channel=c, time=t)
            assert np.array_equal(volume.data, voxels("uint8") + 10 * t + c)
    assert "volume.channel = 2 among 2" in refusal(path, channel=2, time=0)
    assert "volume.time = 3 among 3" in refusal(path, channel=0, time=3)


def test_channels_by_name(tmp_path) -> None:
    path = written(tmp_path / "v.tif", "ome")
    assert '0 "DAPI", 1 "GFP"' in refusal(path)
    for name in ("GFP", "gfp", "1"):
        volume = load_volume(path, channel=name, time=2)
        assert np.array_equal(volume.data, voxels("uint8") + 21)
    assert 'volume.channel = "YFP"' in refusal(path, channel="YFP")


def test_a_colour_of_a_colour_file(tmp_path) -> None:
    colours = np.stack([voxels("uint8") + k for k in range(3)], -1)
    tifffile.imwrite(tmp_path / "v.tif", colours, photometric="rgb")
    assert '0 "red", 1 "green", 2 "blue"' in refusal(tmp_path / "v.tif")
    assert np.array_equal(load_volume(tmp_path / "v.tif", channel="green").data, voxels("uint8") + 1)


def test_images_of_a_file_are_series(tmp_path) -> None:
    path = tmp_path / "v.ome.tif"
    with tifffile.TiffWriter(path) as writer:
        for k, name in enumerate(("left", "right")):
            metadata = dict(axes="ZYX", Name=name, PhysicalSizeX=1.0 + k)
            metadata |= dict(PhysicalSizeY=2.0, PhysicalSizeZ=3.0)
            writer.write(voxels() + k, metadata=metadata, photometric="minisblack")
    message = refusal(path)
    assert '0 "left" (6 x 7 x 8, ZYX), 1 "right"' in message and "volume.series" in message
    for series in (1, "right"):
        volume = load_volume(path, series=series)
        assert np.array_equal(volume.data, voxels() + 1) and volume.grid.spacing == (2, 2, 3)


def test_an_ome_image_over_several_files(tmp_path) -> None:
    """One file a time point; each names the others, and any of them is the image."""
    names = [f"v_t{t}.ome.tif" for t in range(3)]
    uuids = [f"urn:uuid:00000000-0000-0000-0000-00000000000{t}" for t in range(3)]
    data = "".join(
        f'<TiffData FirstT="{t}" FirstZ="0" FirstC="0" IFD="0" PlaneCount="6">'
        f'<UUID FileName="{names[t]}">{uuids[t]}</UUID></TiffData>'
        for t in range(3)
    )
    for t in range(3):
        xml = (
            '<?xml version="1.0" encoding="UTF-8"?><OME UUID="' + uuids[t] + '" '
            'xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
            '<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="8" SizeY="7" '
            'SizeZ="6" SizeC="1" SizeT="3" PhysicalSizeX="2" PhysicalSizeY="2" PhysicalSizeZ="3">'
            '<Channel ID="Channel:0:0" SamplesPerPixel="1"/>' + data + "</Pixels></Image></OME>"
        )
        tifffile.imwrite(
            tmp_path / names[t],
            voxels("uint8") + 40 * t,
            description=xml,
            metadata=None,
            photometric="minisblack",
        )
    assert "3 times" in refusal(tmp_path / names[0])
    for t in range(3):
        volume, _ = loaded(tmp_path / names[0], time=t)
        assert np.array_equal(volume.data, voxels("uint8") + 40 * t)
        assert volume.grid.spacing == (2, 2, 3)
        assert volume.files == tuple(str(tmp_path / name) for name in names[1:])
    (tmp_path / names[2]).unlink()
    assert "missing" in refusal(tmp_path / names[0], time=2)


def test_only_the_chosen_pages_count_for_the_memory_cap(tmp_path) -> None:
    path = written(tmp_path / "v.tif", "ome", "zlib")
    one = voxels("uint8").nbytes
    assert load_volume(path, channel=1, time=1, memory_cap=one).nbytes == one
    assert "memory cap" in refusal(path, channel=1, time=1, memory_cap=one - 1)


@pytest.mark.parametrize("bigtiff", [False, True])
@pytest.mark.parametrize("order", "<>")
def test_a_chain_of_pages_without_an_end(tmp_path, bigtiff, order) -> None:
    """The last page's link leads to the first page, or to itself."""
    (tmp_path / "s").mkdir()
    for target in (0, -1):
        path = tmp_path / "s" / "v.tif"
        with tifffile.TiffWriter(path, bigtiff=bigtiff, byteorder=order) as writer:
            for plane in voxels("uint8"):
                writer.write(plane, photometric="minisblack", metadata=None)
        with tifffile.TiffFile(path) as file:
            last = file.pages[-1].offset
            size, tag = (8, 20) if bigtiff else (2, 12)
            link = last + size + tag * len(file.pages[-1].tags)
            offset = file.pages[target].offset
        whole = bytearray(path.read_bytes())
        width = 8 if bigtiff else 4
        whole[link : link + width] = offset.to_bytes(width, "little" if order == "<" else "big")
        path.write_bytes(whole)
        assert "leads back" in refusal(path)
        tifffile.imwrite(tmp_path / "s" / "w.tif", voxels("uint8")[0])
        assert "v.tif" in refusal(tmp_path / "s")
        (tmp_path / "s" / "w.tif").unlink()


# ---- folders -------------------------------------------------------------------------------------


def slices(folder: Path, names: list[str], array: np.ndarray | None = None, **options) -> Path:
    folder.mkdir(parents=True)
    array = np.stack([np.full((7, 8), k, "uint8") for k in range(len(names))]) if array is None else array
    for name, plane in zip(names, array):
        tifffile.imwrite(folder / name, plane, photometric="minisblack", **options)
    return folder


@pytest.mark.parametrize(
    "names",
    [
        [f"sl_{k}.tif" for k in range(1, 13)],
        [f"sl_{k:03}.TIF" for k in range(12)],
        [f"2020-03-04 scan{k}.tiff" for k in (1, 2, 9, 10, 11, 100, 101)],
        ["a.tif", "b.tif", "C.tif"],
    ],
)
def test_slices_come_in_natural_order(tmp_path, names) -> None:
    folder = slices(tmp_path / "s", names)
    (folder / "Thumbs.db").write_bytes(b"\0" * 900)
    (folder / "notes.txt").write_text("no image")
    (folder / "._sl_1.tif").write_bytes(b"resource fork")
    (folder / "more").mkdir()
    volume, _ = loaded(folder)
    assert volume.data[:, 0, 0].tolist() == list(range(len(names)))
    assert volume.format == "TIFF slices" and volume.frame == "image"


def test_slices_of_a_folder_keep_type_spacing_and_compression(tmp_path) -> None:
    names = [f"s{k}.tif" for k in range(6)]
    folder = slices(
        tmp_path / "s", names, voxels(), compression="lzw", resolution=(20, 5), resolutionunit=3
    )
    volume, warned = loaded(folder)
    assert np.array_equal(volume.data, voxels()) and warned == ""
    assert volume.grid.spacing == (0.5, 2.0, 0.5) and volume.unit == "mm"


@pytest.mark.parametrize("odd", [0, 3, 5])
def test_slices_of_several_sizes_or_types_are_named(tmp_path, odd) -> None:
    names = [f"s{k}.tif" for k in range(6)]
    folder = slices(tmp_path / "s", names)
    tifffile.imwrite(folder / f"s{odd}.tif", np.zeros((7, 9), "u1"))
    message = refusal(folder)
    assert f"s{odd}.tif (9 x 7)" in message and "8 x 7" in message and "5 slices" in message
    tifffile.imwrite(folder / f"s{odd}.tif", np.zeros((7, 8), "u2"))
    assert f"s{odd}.tif (uint16)" in refusal(folder)


def test_a_gap_in_the_numbers_is_told(tmp_path) -> None:
    volume, warned = loaded(slices(tmp_path / "s", [f"s{k}.tif" for k in (1, 2, 3, 5, 6)]))
    assert volume.shape[0] == 5
    assert "between s3.tif and s5.tif" in warned
    assert loaded(slices(tmp_path / "t", [f"s{k}.tif" for k in (10, 20, 30)]))[1] == ""


def test_several_stacks_in_a_folder_are_series(tmp_path) -> None:
    names = [f"{kind}_{k}.tif" for kind in ("raw", "seg") for k in range(3)]
    folder = slices(tmp_path / "s", names)
    message = refusal(folder)
    assert '0 "raw_#.tif" (3 files), 1 "seg_#.tif" (3 files)' in message
    for series in (1, "seg_#.tif"):
        assert load_volume(folder, series=series).data[:, 0, 0].tolist() == [3, 4, 5]


def test_names_that_count_channels_and_times(tmp_path) -> None:
    places = [(t, c, z) for t in (1, 2, 3) for c in (0, 1) for z in (8, 9, 10, 11)]
    names = [f"img_t{t}_ch{c}_z{z}.tif" for t, c, z in places]
    folder = slices(tmp_path / "s", names)
    assert "3 times: 1, 2, 3" in refusal(folder)
    assert "2 channels: 0, 1" in refusal(folder, time=2)
    volume, warned = loaded(folder, time=2, channel=1)
    assert volume.data[:, 0, 0].tolist() == [names.index(f"img_t2_ch1_z{z}.tif") for z in (8, 9, 10, 11)]
    assert warned == ""
    plain = slices(tmp_path / "p", [f"{a}-{z}.tif" for a in (3, 4) for z in range(3)])
    assert "2 series: 3, 4" in refusal(plain)
    assert load_volume(plain, series=4).data[:, 0, 0].tolist() == [3, 4, 5]
    stamped = slices(tmp_path / "d", [f"{k}_{1000 + 7 * k * k}.tif" for k in range(12)])
    assert load_volume(stamped).data[:, 0, 0].tolist() == list(range(12))


def test_damaged_and_many_paged_slices_are_named(tmp_path) -> None:
    folder = slices(tmp_path / "s", [f"s{k}.tif" for k in range(4)])
    whole = (folder / "s2.tif").read_bytes()
    (folder / "s2.tif").write_bytes(b"no tiff")
    assert "s2.tif" in refusal(folder)
    (folder / "s2.tif").write_bytes(whole[:-9])
    assert "cut off" in refusal(folder)
    tifffile.imwrite(folder / "s2.tif", voxels(), photometric="minisblack")
    assert "s2.tif holds 6 images" in refusal(folder)


def test_one_file_in_a_folder_is_read_as_a_file(tmp_path) -> None:
    (tmp_path / "s").mkdir()
    tifffile.imwrite(tmp_path / "s" / "stack.tif", voxels(), photometric="minisblack")
    assert load_volume(tmp_path / "s").shape == SHAPE
