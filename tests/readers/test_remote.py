"""Zarr by URL, from a server on this machine; a URL that cannot be had is refused as it was typed."""

from __future__ import annotations

import http.server
import threading

import numpy as np
import pytest
import zarr

from clvol import load_volume
from clvol.errors import SceneError, VolumeError
from clvol.readers.remote import is_url
from clvol.scene import load_scene

VOXELS = np.arange(120, dtype=np.uint16).reshape(4, 5, 6)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("served")

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *given) -> None:
            super().__init__(*given, directory=str(folder))

        def log_message(self, *_) -> None:
            pass

        def do_GET(self) -> None:
            if "forbidden" in self.path:
                self.send_error(403)
            else:
                super().do_GET()

        def end_headers(self) -> None:
            self.send_header("ETag", '"1"')  # S3 has one
            super().end_headers()

    (folder / "bucket").mkdir()
    for name in ("plain.zarr", "bucket/plain.zarr"):
        zarr.create_array(str(folder / name), data=VOXELS, chunks=(2, 5, 3))
    for version in (2, 3):
        group = zarr.open_group(str(folder / f"image{version}.ome.zarr"), mode="w", zarr_format=version)
        group.create_array("0", data=VOXELS, chunks=(2, 5, 3))
        axes = [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
        dataset = {"path": "0", "coordinateTransformations": [{"type": "scale", "scale": [3.0, 2.0, 0.5]}]}
        multiscales = [{"axes": axes, "datasets": [dataset], "version": "0.4" if version == 2 else "0.5"}]
        group.attrs.update({"multiscales": multiscales} if version == 2 else {"ome": {"multiscales": multiscales}})
    group = zarr.open_group(str(folder / "several.zarr"), mode="w")
    for name in ("density", "speed"):
        group.create_array(name, data=VOXELS, chunks=(2, 5, 3))
    zarr.consolidate_metadata(group.store)
    served = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=served.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{served.server_port}"
    served.shutdown()
    served.server_close()


@pytest.mark.parametrize("name", ["plain.zarr", "image2.ome.zarr", "image3.ome.zarr", "plain.zarr/"])
def test_images_are_read_by_http(server, name):
    volume = load_volume(f"{server}/{name}")
    assert np.array_equal(volume.data, VOXELS)
    assert volume.grid.spacing == ((0.5, 2.0, 3.0) if "image" in name else (1.0, 1.0, 1.0))
    assert volume.name in ("plain", "image2.ome", "image3.ome")


def test_a_member_of_a_group_is_named(server):
    assert np.array_equal(load_volume(f"{server}/several.zarr", series="speed").data, VOXELS)
    with pytest.raises(VolumeError, match='2 series: .*"density", .*"speed"'):
        load_volume(f"{server}/several.zarr")


def test_a_bucket_of_s3_is_read_without_an_account(server, monkeypatch, tmp_path):
    monkeypatch.setenv("AWS_ENDPOINT_URL", server)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("AWS_ACCESS_KEY_ID", "AWS_PROFILE", "AWS_ROLE_ARN"):
        monkeypatch.delenv(name, raising=False)
    assert np.array_equal(load_volume("s3://bucket/plain.zarr").data, VOXELS)
    with pytest.raises(VolumeError, match=r"^s3://bucket/none\.zarr: "):
        load_volume("s3://bucket/none.zarr")


def test_a_scene_names_a_url_and_keeps_it(server, tmp_path):
    url = f"{server}/plain.zarr"
    assert np.array_equal(load_scene(url).load_volume().data, VOXELS)
    (tmp_path / "s.toml").write_text(f'[volume]\nfile = "{url}"\n', encoding="utf-8")
    scene = load_scene(tmp_path / "s.toml")
    assert np.array_equal(scene.load_volume().data, VOXELS) and f'file = "{url}"' in scene.to_toml()
    assert scene.input_paths == [] and scene.volume_path is None


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("{server}/none.zarr", "no Zarr metadata there"),
        ("{server}/forbidden.zarr", "cannot be read .*403"),
        ("{server}/head.nrrd", "the URL of a NRRD file, expected a Zarr image .*; download other files"),
        ("http://127.0.0.1:9/x.zarr", "cannot be read .*connect"),
        ("http://name.invalid/x.zarr", "cannot be read"),
        ("ftp://host/x.zarr", "scheme 'ftp', expected a Zarr image by http://"),
        ("s3://", "no bucket"),
        ("http://host/x.zarr?key=1", "a query or a fragment"),
    ],
)
def test_a_url_that_cannot_be_had_is_refused_as_typed(server, url, message):
    url = url.format(server=server)
    with pytest.raises((VolumeError, SceneError), match=message) as caught:
        load_scene(url).load_volume()
    assert str(caught.value).startswith(f"{url}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize("path", ["C:\\x", "a/b", "s3:/b", "/x://y", "x:y", "c://x"])
def test_names_of_files_are_no_urls(path):
    assert not is_url(path)
