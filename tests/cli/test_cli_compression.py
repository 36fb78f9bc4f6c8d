"""What commands say of a scene with [compression], and what they write."""

from __future__ import annotations

import json

import numpy as np
import pytest
from helpers.small_scenes import waves

from clvol.cli import main
from clvol.image import load_image

TABLE = """
[image]
width = 24
height = 20
[compression]
codec = "rvq"
max_voxel_error = 0.05
"""


@pytest.fixture
def scene(tmp_path):
    np.save(tmp_path / "a.npy", waves((17, 20, 24), np.uint8))
    file = tmp_path / "a.toml"
    file.write_text(f'version = 1\n[volume]\nfile = "a.npy"\n{TABLE}')
    return file


def test_explain_and_info(scene, capsys):
    assert main(["explain", str(scene)]) == 0
    said = capsys.readouterr().out
    assert "compression rvq: voxels are replaced" in said and "within 0.05 of the range" in said
    assert main(["explain", str(scene), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["compression"]["target"] == {"max_voxel_error": 0.05}
    assert main(["explain", str(scene), "--set", 'compression.codec="none"']) == 0
    assert "compression" not in capsys.readouterr().out
    assert main(["info", str(scene)]) == 0
    assert "compression" in (said := capsys.readouterr().out) and "rvq, max_voxel_error 0.05, decode auto" in said
    assert main(["info", str(scene), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["compression"]
    assert told == {"codec": "rvq", "max_voxel_error": 0.05, "decode": "auto"}
    assert main(["info", str(scene.with_suffix(".npy"))]) == 0
    assert "compression" not in capsys.readouterr().out


def test_stats_and_the_picture_say_what_was_decoded(scene, tmp_path, device, capsys):
    picture, stats = tmp_path / "a.exr", tmp_path / "a.json"
    assert main(["render", str(scene), "-o", str(picture), "--stats", str(stats), "--quiet"]) == 0
    told = json.loads(stats.read_text())["compression"]
    assert set(told) == {"codec", "bits_per_voxel", "psnr", "max_voxel_error", "device_bytes", "decoded_voxels"}
    assert told["codec"] == "rvq" and told["max_voxel_error"] <= 0.05 and told["decoded_voxels"] == 17 * 20 * 24
    header = load_image(picture)["header"]
    assert header["stats"]["compression"] == told
    assert "[compression]" in header["scene"]
    look = json.loads(header["made_from"])["look"]
    other = tmp_path / "b.exr"
    assert main(["render", str(scene), "-o", str(other), "--quiet", "--set", "compression.max_voxel_error=0.01"]) == 0
    assert json.loads(load_image(other)["header"]["made_from"])["look"] != look


def test_compare_shows_what_compression_costs(scene, tmp_path, device, capsys):
    files = [str(tmp_path / name) for name in ("a.npy", "b.npy")]
    files = [name.replace(".npy", "_picture.npy") for name in files]
    assert main(["render", str(scene), "-o", files[0], "--quiet"]) == 0
    assert main(["render", str(scene), "-o", files[1], "--quiet", "--set", 'compression.codec="none"']) == 0
    capsys.readouterr()
    assert main(["compare", *files, "--json"]) == 0
    assert 0 < json.loads(capsys.readouterr().out)["rmse"] < 0.05


def test_an_integrator_that_needs_all_voxels(scene, tmp_path, capsys):
    options = ["--set", 'compression.decode="resident"', "--set", 'integration.method="reference"']
    assert main(["render", str(scene), "-o", str(tmp_path / "a.png"), *options]) == 2
    said = capsys.readouterr().err
    assert "compression.decode: got 'resident' with the method 'reference', expected 'upload' or 'auto'" in said
    assert not (tmp_path / "a.png").exists()
