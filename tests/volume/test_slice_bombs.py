"""Small files that ask for much memory: refused within the memory cap, before anything is decoded."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import imagecodecs
import nibabel
import numpy as np
import pytest
from pydicom.uid import DeflatedExplicitVRLittleEndian
from slice_files import dicom_series, loaded, refusal, voxels

CAP = 1 << 20
LARGE = 96 << 20
BYTES = {"name": "bytes", "configuration": {"endian": "little"}}
ZSTD = {"name": "zstd", "configuration": {"level": 0, "checksum": False}}
BLOSC = {
    "name": "blosc",
    "configuration": {
        "cname": "lz4", "clevel": 5, "shuffle": "noshuffle", "typesize": 1, "blocksize": 0
    },
}  # fmt: skip


def zarr3(path: Path, shape: list[int], chunk: list[int], codecs: list, data: bytes) -> None:
    place = path / "c" / "0" / "0"
    place.mkdir(parents=True)
    grid = {"name": "regular", "configuration": {"chunk_shape": chunk}}
    keys = {"name": "default", "configuration": {"separator": "/"}}
    array = {
        "zarr_format": 3, "node_type": "array", "shape": shape, "data_type": "uint8",
        "chunk_grid": grid, "chunk_key_encoding": keys, "fill_value": 0, "codecs": codecs,
        "attributes": {},
    }  # fmt: skip
    (path / "zarr.json").write_text(json.dumps(array))
    (place / "0").write_bytes(data)


def zarr2(path: Path, chunk: list[int], data: bytes) -> None:
    path.mkdir()
    compressor = {"id": "blosc", "cname": "lz4", "clevel": 5, "shuffle": 0, "blocksize": 0}
    array = {
        "zarr_format": 2, "shape": [8, 7, 6], "chunks": chunk, "dtype": "|u1", "fill_value": 0,
        "order": "C", "filters": None, "compressor": compressor,
    }  # fmt: skip
    (path / ".zarray").write_text(json.dumps(array))
    (path / "0.0.0").write_bytes(data)


def sharded(inner: list) -> list:
    how = {
        "chunk_shape": [8, 7, 6], "codecs": inner, "index_codecs": [BYTES], "index_location": "end"
    }  # fmt: skip
    return [{"name": "sharding_indexed", "configuration": how}]


def shard(data: bytes) -> bytes:
    return data + struct.pack("<QQ", 0, len(data))


def tiff(path: Path, compression: int, data: bytes, width: int = 16, tile: int = 0) -> None:
    """One page, written by hand, since no library writes such a thing."""
    tags = [(256, width), (257, width), (258, 8), (259, compression), (262, 1), (277, 1)]
    if tile:
        tags += [(322, tile), (323, tile), (324, 1000), (325, len(data))]
    else:
        tags += [(273, 1000), (278, width), (279, len(data))]
    directory = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(tags))
    head = b"II*\0" + struct.pack("<IH", 8, len(tags)) + directory + bytes(4)
    path.write_bytes(head.ljust(1000, b"\0") + data)


def deflated_dicom(folder: Path) -> None:
    def edit(data, k):
        data.ImageComments = "x" * 10
        data.add_new(0x00091010, "UN", bytes(LARGE))

    dicom_series(folder, voxels()[:1], edit=edit, syntax=DeflatedExplicitVRLittleEndian)


@pytest.fixture(scope="module")
def bombs(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("bombs")
    large = bytes(LARGE)
    zstd, blosc = imagecodecs.zstd_encode(large), imagecodecs.blosc_encode(large)
    small, wide = [8, 7, 6], [1024, 512, 512]
    zarr3(folder / "chunk.zarr", small, wide, [BYTES, ZSTD], zstd)
    zarr3(folder / "stream.zarr", small, small, [BYTES, ZSTD], zstd)
    zarr3(folder / "shape.zarr", [1 << 30] * 3, small, [BYTES], b"")
    zarr3(folder / "beyond.zarr", small, [1 << 40] * 3, [BYTES], b"")
    zarr3(folder / "shard.zarr", small, wide, sharded([BYTES, ZSTD]), shard(zstd))
    zarr3(folder / "blosc.zarr", small, small, [BYTES, BLOSC], blosc)
    zarr3(folder / "blosc_shard.zarr", small, small, sharded([BYTES, BLOSC]), shard(blosc))
    zarr2(folder / "two.zarr", small, blosc)
    zarr2(folder / "two_chunk.zarr", wide, blosc)
    picture = np.zeros((8192, 8192), "u1")
    tiff(folder / "jpeg.tif", 7, imagecodecs.jpeg_encode(picture))
    tiff(folder / "j2k.tif", 34712, imagecodecs.jpeg2k_encode(picture[:2048, :2048]))
    tiff(folder / "deflate.tif", 8, zlib.compress(large))
    tiff(folder / "zstd.tif", 50000, zstd)
    tiff(folder / "tile.tif", 8, zlib.compress(bytes(256)), tile=1 << 15)
    tiff(folder / "wide.tif", 8, zlib.compress(bytes(256)), width=1 << 20)
    tiff(folder / "exotic.tif", 34887, b"Lerc2 " + bytes(90))
    header = nibabel.Nifti1Header()
    header.set_data_dtype("uint8")
    header.set_data_shape((1024, 1024, LARGE >> 20))
    header["vox_offset"], header["magic"] = 352, b"n+1"
    import gzip

    (folder / "v.nii.gz").write_bytes(gzip.compress(header.binaryblock + bytes(4) + large))
    deflated_dicom(folder / "deflated")
    return {path.name: path for path in folder.iterdir()}


READ = """
import json, resource, sys, warnings
import imagecodecs, nibabel, numpy, pydicom, tensorstore, tifffile
from clvol.errors import VolumeError
from clvol.readers import load_volume
warnings.simplefilter("ignore")
imagecodecs.zlib_decode(imagecodecs.zlib_encode(b"x"))
told = {}
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sys.argv[2:]:
    try:
        load_volume(path, memory_cap=int(sys.argv[1])).data
        said = None
    except VolumeError as error:
        said = str(error)
    now = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    told[path], before = (said, (now - before) // 1024), now
print(json.dumps(told))
"""


def test_bombs_are_refused_within_the_cap(bombs) -> None:
    paths = [str(path) for path in bombs.values()]
    done = subprocess.run(
        [sys.executable, "-c", READ, str(CAP), *paths], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout)
    assert {name for name, (said, _) in told.items() if said is None or "\n" in said} == set()
    assert {name: took for name, (_, took) in told.items() if took > 40} == {}


def test_what_is_no_bomb_is_read_within_the_same_cap(tmp_path) -> None:
    data = imagecodecs.blosc_encode(voxels("uint8").tobytes())
    zarr3(tmp_path / "v.zarr", [6, 7, 8], [6, 7, 8], [BYTES, BLOSC], data)
    how = sharded([BYTES, BLOSC])
    how[0]["configuration"]["chunk_shape"] = [6, 7, 8]
    zarr3(tmp_path / "s.zarr", [6, 7, 8], [6, 7, 8], how, shard(data))
    dicom_series(tmp_path / "d", syntax=DeflatedExplicitVRLittleEndian)
    for name in ("v.zarr", "s.zarr"):
        assert np.array_equal(loaded(tmp_path / name, memory_cap=CAP)[0].data, voxels("uint8"))
    assert np.array_equal(loaded(tmp_path / "d", memory_cap=CAP)[0].data, voxels())


def test_messages_say_what_is_too_large(bombs) -> None:
    assert "a chunk of 1024 x 512 x 512 needs 256 MiB" in refusal(bombs["chunk.zarr"], memory_cap=CAP)
    assert f"claims {LARGE} bytes" in refusal(bombs["blosc_shard.zarr"], memory_cap=CAP)
    assert "8192" in refusal(bombs["jpeg.tif"], memory_cap=CAP)
    assert "memory cap" in refusal(bombs["tile.tif"], memory_cap=CAP)
    assert "memory cap" in refusal(bombs["deflated"], memory_cap=CAP)
