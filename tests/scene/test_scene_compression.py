"""The table [compression]: what is accepted, and how mistakes are reported."""

from __future__ import annotations

import numpy as np
import pytest

from clvol import Compression, Scene, Volume
from clvol.errors import SceneError
from clvol.scene import load_scene
from clvol.store.codecs.coded_blocks import RateTarget

SCENE = """version = 1
[volume]
field = "radial"
size = [8, 8, 8]
"""


@pytest.mark.parametrize(
    ("table", "error"),
    [
        ('codec = "zfp"', "compression.codec: got 'zfp', expected 'none', 'vq', 'vq-mean', 'hvq', 'rvq' or 'lab"),
        ('codec = "rvq"\npsnr = 40.0\nmax_voxel_error = 0.1', "compression.psnr: got 40.0, expected either max_voxel_"),
        ('codec = "rvq"\nbits_per_voxel = 1\npsnr = 40', "compression.bits_per_voxel: got 1.0, expected either psnr"),
        ("psnr = 40.0", "compression.codec: missing, expected a codec beside psnr, such as 'rvq'"),
        ("max_voxel_error = 0.1", "compression.codec: missing, expected a codec beside max_voxel_error"),
        ('codec = "rvq"\nmax_voxel_error = 0', "compression.max_voxel_error: got 0, expected a number greater than 0"),
        ('codec = "rvq"\nmax_voxel_error = 1.5', "compression.max_voxel_error: got 1.5, expected a number greater"),
        ('codec = "rvq"\npsnr = "high"', "compression.psnr: got 'high', expected a number"),
        ('codec = "rvq"\nbits_per_voxel = nan', "compression.bits_per_voxel: got nan"),
        ('codec = "labels"\npsnr = 40', "compression.psnr: got 40.0, expected no target beside the codec 'labels'"),
        ('codec = "rvq"\ndecode = "late"', "compression.decode: got 'late', expected 'auto', 'upload' or 'resident'"),
        ('codec = "rvq"\nmemory = "much"', 'compression.memory: got \'much\', expected a size such as "96 MiB"'),
        ('codec = "rvq"\nseed = -1', "compression.seed: got -1, expected a whole number from 0"),
        ('codec = "rvq"\ntarget = 3', "compression.target: unknown key"),
    ],
)
def test_mistakes(table, error, tmp_path):
    file = tmp_path / "a.toml"
    file.write_text(f"{SCENE}[compression]\n{table}\n")
    with pytest.raises(SceneError) as caught:
        load_scene(file)
    assert f"{file}: {error}" in str(caught.value)


def test_a_target_of_no_codec_is_left_alone():
    """So that codec = "none" alone switches compression off."""
    table = Compression(codec="none", max_voxel_error=0.1)
    assert not table.is_lossy and table.stated == ("max_voxel_error",)
    assert Compression(codec="rvq", psnr=40.0).model_copy(update={"codec": "none"}).psnr == 40.0


def test_targets_and_sizes():
    assert Compression(codec="rvq", psnr=40.0).target == RateTarget(psnr=40.0)
    assert Compression(codec="rvq").target == RateTarget() and Compression().memory_bytes is None
    assert Compression(memory="2 KiB").memory_bytes == Compression(memory=2048).memory_bytes == 2048


def test_a_scene_file_reads_back(tmp_path):
    scene = Scene(
        volume=Volume(np.zeros((4, 4, 4), np.uint8)), compression={"codec": "hvq", "psnr": 33.0, "decode": "upload"}
    )
    text = scene.to_toml()
    assert '[compression]\ncodec = "hvq"\npsnr = 33.0\ndecode = "upload"\n' in text
    file = tmp_path / "a.toml"
    file.write_text(SCENE + text.partition("# volume")[2].partition("\n")[2])
    assert load_scene(file).compression == scene.compression
    assert "compression" not in Scene(volume=Volume(np.zeros((4, 4, 4), np.uint8))).to_toml()
