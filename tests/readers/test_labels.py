"""Volumes of which clvol knows that their voxels are labels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from clvol.readers import load_volume
from clvol.volume import Volume

DATA = np.arange(24, dtype=np.uint8).reshape(2, 3, 4)


def test_in_memory():
    assert not Volume(DATA).labels
    assert Volume(DATA, labels=True).labels and Volume(DATA > 3).labels


def test_by_the_caller(tmp_path):
    np.save(tmp_path / "v.npy", DATA)
    assert not load_volume(tmp_path / "v.npy").labels
    assert load_volume(tmp_path / "v.npy", labels=True).labels


@pytest.mark.parametrize(("intent", "labels"), [("none", False), ("label", True), ("t test", False)])
def test_nifti_intents(tmp_path, intent, labels):
    nibabel = pytest.importorskip("nibabel")
    image = nibabel.Nifti1Image(DATA.T.copy(), np.eye(4))
    image.header.set_intent(intent, (1.0,) if intent == "t test" else ())
    nibabel.save(image, tmp_path / "v.nii")
    volume = load_volume(tmp_path / "v.nii")
    np.testing.assert_array_equal(volume.data, DATA)
    assert volume.labels == labels


@pytest.mark.parametrize(
    ("pair", "labels"),
    [("Segment0_ID:=Segment_1", True), ("Segment0_Name:=a", True), ("a:=Segment0_ID", False), ("# Segment0", False)],
)
def test_segmentations_of_3d_slicer(tmp_path, pair, labels):
    header = f"NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 3 2\nencoding: raw\n{pair}\n\n"
    (tmp_path / "v.seg.nrrd").write_bytes(header.encode() + DATA.tobytes())
    volume = load_volume(tmp_path / "v.seg.nrrd")
    np.testing.assert_array_equal(volume.data, DATA)
    assert volume.labels == labels


@pytest.mark.parametrize("labels", (False, True))
def test_labels_of_ome_zarr(tmp_path, labels):
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(tmp_path / "v.zarr"), mode="w", zarr_format=3)
    group.create_array("0", data=DATA)
    axes = [{"name": name, "type": "space"} for name in "zyx"]
    dataset = {"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [1, 1, 1]}]}
    ome = {"version": "0.5", "multiscales": [{"axes": axes, "datasets": [dataset]}]}
    group.attrs.update({"ome": ome | ({"image-label": {}} if labels else {})})
    assert load_volume(tmp_path / "v.zarr").labels == labels


def test_a_zarr_array_of_bool(tmp_path):
    zarr = pytest.importorskip("zarr")
    zarr.create_array(str(tmp_path / "b"), data=DATA > 4)
    assert load_volume(tmp_path / "b").labels
    path = Path(tmp_path / "b" / "zarr.json")
    assert json.loads(path.read_text())["data_type"] == "bool"
