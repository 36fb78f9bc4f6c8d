"""Nothing that a command reads is overwritten by what it writes; devices are never replaced."""

from __future__ import annotations

import os
import stat

import numpy as np
import pytest

from clvol.inputs import Inputs
from clvol.volume.parts import parts_of

NRRD = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 4 4\nencoding: raw\n"
META = "ObjectType = Image\nNDims = 3\nDimSize = 4 4 4\nElementType = MET_UCHAR\n"


def _scene(folder, more: str = "", file: str = "cube.npy") -> None:
    text = f'version = 1\n[volume]\nfile = "{file}"\n[image]\nwidth = 8\nheight = 6\n{more}'
    (folder / "scene.toml").write_text(text, encoding="utf-8")


def _data(folder, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(bytes(range(64)))


def environment(folder):
    _data(folder, "sky.exr")
    _scene(folder, '[environment]\nfile = "sky.exr"\n')
    return ["sky.exr", "cube.npy", "scene.toml"]


def fields(folder):
    np.save(folder / "mask.npy", np.zeros((2, 2, 2), np.uint8))
    _data(folder, "voxels.raw")
    (folder / "more.nhdr").write_text(NRRD + "data file: voxels.raw\n")
    _scene(folder, '[[field]]\nfile = "mask.npy"\nrole = "mask"\n[[field]]\nfile = "more.nhdr"\nrole = "mask"\n')
    return ["mask.npy", "more.nhdr", "voxels.raw"]


def nrrd(folder):
    _data(folder, "größe 1.raw")
    (folder / "v.nhdr").write_text(NRRD + "Data File:  größe 1.raw\n", encoding="utf-8")
    _scene(folder, file="v.nhdr")
    return ["v.nhdr", "größe 1.raw"]


def nrrd_old_spelling(folder):
    _data(folder, "data/v.raw")
    (folder / "v.nrrd").write_text(NRRD + "datafile: data/v.raw\n")
    _scene(folder, file="v.nrrd")
    return ["data/v.raw"]


def nrrd_list(folder):
    _data(folder, "a.raw", "b.raw")
    (folder / "v.nhdr").write_text(NRRD + "data file: LIST\na.raw\nb.raw\n")
    _scene(folder, file="v.nhdr")
    return ["a.raw", "b.raw"]


def nrrd_pattern(folder):
    _data(folder, "s_01.raw", "s_02.raw")
    (folder / "v.nhdr").write_text(NRRD + "data file: s_%02d.raw 1 2 1\n")
    _scene(folder, file="v.nhdr")
    return ["s_01.raw", "s_02.raw"]


def metaimage(folder):
    _data(folder, "v.zraw")
    (folder / "v.mhd").write_text(META + "ElementDataFile = v.zraw\n")
    _scene(folder, file="v.mhd")
    return ["v.mhd", "v.zraw"]


def metaimage_list(folder):
    _data(folder, "a 1.raw", "b.raw")
    (folder / "v.mhd").write_text(META + "ElementDataFile = LIST 2\na 1.raw\nb.raw\n")
    _scene(folder, file="v.mhd")
    return ["a 1.raw", "b.raw"]


def metaimage_pattern(folder):
    _data(folder, "s001.raw", "s002.raw")
    (folder / "v.mha").write_text(META + "ElementDataFile = s%03d.raw 1 2 1\n")
    _scene(folder, file="v.mha")
    return ["s001.raw", "s002.raw"]


def nifti_pair(folder):
    _data(folder, "v.hdr", "v.img")
    (folder / "cube.hdr").write_bytes(b"")
    np.save(folder / "v.npy", np.zeros((2, 2, 2), np.uint8))
    _scene(folder, '[[field]]\nfile = "v.hdr"\nrole = "mask"\n')
    return ["v.hdr", "v.img"]


def raw(folder):
    _data(folder, "v.raw")
    _scene(folder, "", 'v.raw"\ndims = [4, 4, 4]\ndtype = "uint8')
    return ["v.raw"]


def dicom(folder):
    _data(folder, "slices/1.dcm", "slices/2")
    (folder / "slices/3.dcm").write_bytes(b"\x89PNG" + bytes(124) + b"DICM")  # a liar's preamble
    _scene(folder, file="slices")
    return ["slices/1.dcm", "slices/2", "slices/3.dcm"]


def one_dicom_file(folder):
    """It may stand for the series that it belongs to."""
    for name in ("one", "two"):
        (folder / name).write_bytes(bytes(128) + b"DICM")
    _scene(folder, file="one")
    return ["one", "two"]


def tiff_slices(folder):
    _data(folder, "slices/s1.tif", "slices/s2.tif")
    _scene(folder, file="slices")
    return ["slices/s1.tif", "slices/s2.tif"]


def store(folder):
    from clvol.store.build import build_store
    from clvol.volume import Volume

    build_store(Volume(np.arange(4096, dtype=np.uint8).reshape(16, 16, 16)), folder / "v.zarr")
    _scene(folder, file="v.zarr")
    return ["v.zarr/zarr.json", "v.zarr/0/zarr.json", "v.zarr/0/c/0/0/0", "v.zarr/new"]


def array_of_a_store(folder):
    """Its group is not to be written to, either."""
    store(folder)
    _scene(folder, file="v.zarr/1")
    return ["v.zarr/zarr.json", "v.zarr/0/c/0/0/0", "v.zarr/blocks/new"]


KINDS = [
    environment, fields, nrrd, nrrd_old_spelling, nrrd_list, nrrd_pattern, metaimage, metaimage_list,
    metaimage_pattern, nifti_pair, raw, dicom, one_dicom_file, tiff_slices, store, array_of_a_store,
]  # fmt: skip


def direct(folder, name):
    return name


def dotted(folder, name):
    return f"./x/../{name}"


def symlink(folder, name):
    (folder / "out.png").symlink_to(folder / name)
    return "out.png"


def hard_link(folder, name):
    if not (folder / name).exists():
        pytest.skip("a file that is not there has no links")
    os.link(folder / name, folder / "out.png")
    return "out.png"


def folder_link(folder, name):
    (folder / "way").symlink_to((folder / name).parent)
    return f"way/{os.path.basename(name)}"


@pytest.mark.parametrize("way", [direct, dotted, symlink, hard_link, folder_link])
@pytest.mark.parametrize("kind", KINDS)
def test_no_input_is_overwritten(refused, folder, renderer, kind, way):
    (folder / "x").mkdir()
    for name in kind(folder):
        before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        output = way(folder, name)
        here = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        line = refused(2, "render", "scene.toml", "-o", "good.png", "--stats", output)
        assert "input" in line and line.startswith(output), line
        if output.endswith((".png", ".exr", ".npy")):
            assert "input" in refused(2, "render", "scene.toml", "-o", output)
        assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == here
        for link in (folder / "out.png", folder / "way"):
            link.unlink(missing_ok=True)
        assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    assert renderer.calls == []


def test_a_frame_of_an_animation_is_no_input(refused, folder, renderer):
    (folder / "a_2.npy").write_bytes((folder / "cube.npy").read_bytes())
    _scene(folder, file="a_2.npy")
    line = refused(2, "render", "scene.toml", "-o", "a_%d.npy", "--set", "animation.frames=3")
    assert "a_2.npy: is also an input" in line


def test_pictures_may_lie_beside_slices(run, folder, renderer):
    """Nobody reads them; and the second time they are replaced."""
    _data(folder, "slices/1.dcm")
    _scene(folder, '[[field]]\nfile = "slices"\nrole = "mask"\n')
    inputs = Inputs(["scene.toml", "slices", "cube.npy"])
    for _ in range(2):
        inputs.check_file("slices/out.png")
        inputs.check_file("slices/stats.json")
        (folder / "slices/out.png").write_bytes(b"\x89PNG")
        (folder / "slices/stats.json").write_text("{}")
        inputs = Inputs(["scene.toml", "slices", "cube.npy"])


@pytest.mark.parametrize("way", [direct, symlink, hard_link])
def test_compare_overwrites_neither(refused, folder, way):
    np.save("a.npy", np.zeros((2, 3, 4), np.float32))
    np.save("b.npy", np.zeros((2, 3, 4), np.float32))
    for name in ("a.npy", "b.npy"):
        output = way(folder, name)
        assert "input" in refused(2, "compare", "a.npy", "b.npy", "-o", output)
        (folder / "out.png").unlink(missing_ok=True)
    assert np.load("a.npy").shape == (2, 3, 4)


def test_two_outputs_are_two_files(refused, folder, renderer):
    (folder / "a.png").write_bytes(b"old")
    os.link("a.png", "b.png")
    (folder / "c.png").symlink_to("a.png")
    for other in ("b.png", "c.png"):
        assert "given twice" in refused(2, "render", "scene.toml", "-o", "a.png", "-o", other)


def test_a_report_overwrites_no_input(refused, folder):
    _data(folder, "sky.exr")
    _scene(folder, '[environment]\nfile = "sky.exr"\n')
    (folder / "out" / "images").mkdir(parents=True)
    for name in ("tradeoff.png", "index.html", "images/a.png"):
        os.link("cube.npy", folder / "out" / name)
        assert "input" in refused(2, "tradeoff", "scene.toml", "-o", "out")
        (folder / "out" / name).unlink()
    store(folder)
    assert "input" in refused(2, "tradeoff", "scene.toml", "-o", "v.zarr/0")


@pytest.fixture
def around(folder):
    """Folders that a store would take the place of, with what is read in them."""
    from clvol.store.build import build_store
    from clvol.volume import Volume

    for name in ("v.zarr", "old.zarr"):
        build_store(Volume(np.arange(4096, dtype=np.uint8).reshape(16, 16, 16)), folder / name)
    return folder


@pytest.mark.parametrize(
    "words",
    [
        ["v.zarr", "-o", "v.zarr"],
        ["v.zarr", "-o", "./x/../v.zarr"],
        ["v.zarr", "-o", "v.zarr/inside"],
        ["v.zarr", "-o", "link/inside"],
        ["v.zarr/0", "-o", "v.zarr"],
        ["old.zarr/cube.npy", "-o", "old.zarr"],
        ["scene.toml", "-o", "old.zarr"],
        ["slices", "-o", "slices/new"],
    ],
)
def test_a_store_takes_no_input_s_place(refused, around, words):
    (around / "x").mkdir()
    (around / "link").symlink_to("v.zarr")
    os.rename("cube.npy", "old.zarr/cube.npy")
    _scene(around, file="old.zarr/cube.npy")
    _data(around, "slices/1.dcm")
    before = {p: p.read_bytes() for p in around.rglob("*") if p.is_file()}
    line = refused(2, "store", *words, "--overwrite")
    assert "input" in line, line
    assert {p: p.read_bytes() for p in around.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("ending", [".partial", ".replaced"])
def test_a_store_is_not_built_in_an_input(refused, around, ending):
    os.rename("v.zarr", f"new{ending}")
    line = refused(2, "store", f"new{ending}", "-o", "new", "--restart")
    assert "input" in line or "something else" in line
    assert (around / f"new{ending}" / "zarr.json").exists()


def test_what_is_no_store_is_not_removed(refused, around):
    """A store that is replaced is put aside first, at a place that may be somebody's."""
    (around / "v.zarr.replaced").mkdir()
    (around / "v.zarr.replaced" / "thesis.txt").write_text("years")
    assert "something else" in refused(2, "store", "cube.npy", "-o", "v.zarr", "--overwrite")
    assert (around / "v.zarr.replaced" / "thesis.txt").read_text() == "years"


# --- devices


@pytest.fixture
def special(folder):
    """A pipe, a socket and, for root, a device, each as a name with an ending of a picture."""
    import socket

    os.mkfifo("pipe.png")
    listening = socket.socket(socket.AF_UNIX)
    listening.bind("socket.png")
    names = ["pipe.png", "socket.png"]
    try:
        os.mknod("device.png", 0o666 | stat.S_IFCHR, os.makedev(1, 3))
        names.append("device.png")
    except PermissionError:  # only root can make one
        pass
    (folder / "null.png").symlink_to("/dev/null")
    yield [*names, "null.png"]
    listening.close()


def test_devices_pipes_and_sockets_are_refused_and_stay(refused, folder, renderer, special):
    before = {name: os.stat(name) for name in special}
    for name in special:
        for words in (
            ["render", "scene.toml", "-o", name],
            ["render", "scene.toml", "-o", "x.png", "--stats", name],
            ["compare", "a.npy", "a.npy", "-o", name],
        ):
            assert refused(2, *words).startswith(f"{name}: this is a ")
    for name in special:
        after = os.stat(name)
        assert (after.st_mode, after.st_ino) == (before[name].st_mode, before[name].st_ino)
    for device in ("/dev/null", "/dev/full"):
        assert "this is a device" in refused(2, "render", "scene.toml", "-o", "x.png", "--stats", device)
        assert stat.S_ISCHR(os.stat(device).st_mode)


def test_a_device_that_comes_meanwhile_stays(folder):
    from clvol.errors import UsageError
    from clvol.image import atomic_path

    with pytest.raises(UsageError, match="pipe"), atomic_path("late.png") as temporary:
        temporary.write_bytes(b"x")
        os.mkfifo("late.png")
    assert stat.S_ISFIFO(os.stat("late.png").st_mode)
    assert not [name for name in os.listdir() if name.startswith(".")]


def test_where_standard_output_goes_is_no_output(folder):
    import subprocess
    import sys

    with open("log.json", "w") as log:
        words = ["render", "scene.toml", "-o", "x.png", "--stats", "log.json"]
        done = subprocess.run(
            [sys.executable, "-m", "clvol", *words], stdout=log, stderr=subprocess.PIPE, text=True
        )
    assert done.returncode == 2 and "standard output is redirected to it" in done.stderr


# --- parts


def test_parts_are_files_that_are_there(folder):
    _data(folder, "a.raw")
    for text in (
        "data file: none.raw\n", "data file: ../../../../etc\n", "data file:\n", "# data file: a.raw\n",
        "content: a.raw\n", "data file: %d%d%s\n", "data file: [a.raw\n",
    ):  # fmt: skip
        (folder / "v.nhdr").write_text(NRRD + text)
        assert parts_of("v.nhdr") == []
    (folder / "v.nhdr").write_bytes(NRRD.encode() + b"data file: \xff\x00\n\xfe")
    assert parts_of("v.nhdr") == [] == parts_of("none.nhdr") == parts_of("x" * 300 + ".nhdr")


def test_parts_of_an_ome_tiff_over_several_files(folder):
    import tifffile

    _data(folder, "second.ome.tif")
    told = (
        '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image>'
        '<Pixels><TiffData><UUID FileName="second.ome.tif">x</UUID></TiffData></Pixels></Image></OME>'
    )
    tifffile.imwrite("first.ome.tif", np.zeros((4, 4), np.uint8), description=told, metadata=None)
    assert [part.name for part in parts_of("first.ome.tif")] == ["second.ome.tif"]
