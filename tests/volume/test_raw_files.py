"""Bare voxels behind a header of some length, in either byte order."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from clvol.cli import main
from clvol.errors import VolumeError
from clvol.readers import load_volume

TYPES = ["uint8", "int8", "uint16", "int16", "int32", "uint32", "int64", "float32", "float64"]
DIMS = (4, 3, 2)


def voxels(dtype: str) -> np.ndarray:
    return (np.arange(24).reshape(2, 3, 4) * 5 - (0 if "u" in dtype else 60)).astype(dtype)


@pytest.mark.parametrize("header", [0, 1, 7, 348, 4096, 5000])
@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("dtype", TYPES)
def test_header_bytes_and_byte_order(tmp_path: Path, dtype, order, header) -> None:
    path = tmp_path / "v.raw"
    sign = {"little": "<", "big": ">"}[order]
    stored = voxels(dtype).astype(np.dtype(dtype).newbyteorder(sign)).tobytes()
    path.write_bytes(b"h" * header + stored)
    for asked in (header, -1):
        how = {"dims": DIMS, "header_bytes": asked}
        for said in ({"dtype": dtype, "byte_order": order}, {"dtype": sign + np.dtype(dtype).str[1:]}):
            volume = load_volume(path, **how, **said)
            assert np.array_equal(volume.data, voxels(dtype))
            assert volume.data.flags.aligned and volume.dtype.isnative


def test_from_the_command_line(tmp_path: Path, capfd) -> None:
    (tmp_path / "v.raw").write_bytes(b"12345" + voxels("int16").astype(">i2").tobytes())
    keys = {
        "dims": "[4, 3, 2]", "dtype": '"int16"', "header_bytes": "5", "byte_order": '"big"',
        "slope": "2.0", "offset": "-1.0", "spacing": "[1, 2, 3]",
    }  # fmt: skip
    sets = [word for key, value in keys.items() for word in ("--set", f"volume.{key}={value}")]
    assert main(["info", str(tmp_path / "v.raw"), "--json", *sets]) == 0
    facts = json.loads(capfd.readouterr().out)
    assert facts["value_range"] == [-121.0, 109.0] and facts["dtype"] == "int16"
    assert facts["spacing"] == [1, 2, 3] and (facts["slope"], facts["offset"]) == (2.0, -1.0)


def test_what_is_left_over_is_told_with_the_key_to_set(tmp_path: Path) -> None:
    path = tmp_path / "v.raw"
    path.write_bytes(b"12345" + voxels("uint8").tobytes())
    with pytest.raises(VolumeError, match="29 bytes of voxel data, expected 24 .*header_bytes"):
        load_volume(path, dims=DIMS, dtype="uint8")
    with pytest.raises(VolumeError, match="23 bytes of voxel data after 6 bytes of header"):
        load_volume(path, dims=DIMS, dtype="uint8", header_bytes=6)
    with pytest.raises(VolumeError, match="one byte order"):
        load_volume(path, dims=DIMS, dtype="<u1", byte_order="big")


@pytest.mark.parametrize("key", ["header_bytes", "byte_order"])
def test_keys_of_raw_files_are_refused_for_others(tmp_path: Path, key) -> None:
    np.save(tmp_path / "v.npy", voxels("uint8"))
    with pytest.raises(VolumeError, match=f"{key} only with a .raw file"):
        load_volume(tmp_path / "v.npy", **{key: 1 if key == "header_bytes" else "big"})
