"""The real volumes, where they are there: the facts that their README states."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from clvol.readers import load_volume

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "volumes"
# File: size x, y, z; type; spacing.
FACTS = {
    "aneurism.nrrd": ((256, 256, 256), "uint8", (1, 1, 1)),
    "engine.nrrd": ((256, 256, 128), "uint8", (1, 1, 1)),
    "stent.nrrd": ((128, 128, 256), "int16", (1, 1, 1)),
    "tooth.nrrd": ((103, 94, 161), "uint16", (1, 1, 1)),
    "vismale.nrrd": ((128, 256, 256), "uint8", (1.57774, 0.99586, 1.00797)),
    "cthead.nrrd": ((256, 256, 113), "uint16", (1, 1, 2)),
    "chest.nrrd": ((512, 512, 275), "uint16", (0.78125, 0.78125, 1)),
    "ch2.nii.gz": ((181, 217, 181), "uint8", (1, 1, 1)),
    "inia19.nrrd": ((168, 206, 128), "float32", (0.5, 0.5, 0.5)),
    "inia19_labels.nrrd": ((168, 206, 128), "int16", (0.5, 0.5, 0.5)),
    "levitus.nrrd": ((360, 180, 20), "float32", (1, 1, 1)),
}


def real(name: str) -> Path:
    path = FOLDER / name
    if not path.is_file():
        pytest.skip(f"{name} is not in the folder of real volumes beside the repository")
    return path


@pytest.mark.parametrize("name", FACTS)
def test_size_type_and_spacing(name) -> None:
    size, dtype, spacing = FACTS[name]
    volume = load_volume(real(name))
    assert (volume.grid.size, volume.dtype.name) == (size, dtype)
    assert volume.grid.spacing == spacing


def test_nan_on_land_is_counted_and_leaves_the_range_finite() -> None:
    volume = load_volume(real("levitus.nrrd"))
    assert 0 < volume.nan_count < volume.data.size
    assert -5.0 < volume.value_range[0] < volume.value_range[1] < 40.0


def test_ras_affine_with_a_negative_origin() -> None:
    volume = load_volume(real("ch2.nii.gz"))
    assert volume.frame.startswith("RAS")
    assert max(volume.grid.origin) < 0


PEAK = """
import resource, sys
from clvol.readers import load_volume
import nrrd
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
volume = load_volume(sys.argv[1])
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 - volume.nbytes)
"""


def test_loading_a_compressed_volume_takes_little_more_than_the_volume() -> None:
    """chest.nrrd is 76 MB in its file and 144 MB decoded; 16 MiB beside the voxels are enough."""
    command = [sys.executable, "-c", PEAK, str(real("chest.nrrd"))]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    assert int(result.stdout) < 16 << 20
