"""Pictures come back as they were written, and a file is there whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from clvol.errors import RenderError, UsageError
from clvol.image import atomic_path, check_output, load_image, save_frame
from clvol.image.png import display
from clvol.transfer.color import srgb_to_linear


def frame(height: int = 5, width: int = 7, **other):
    random = np.random.default_rng(1)
    alpha = random.random((height, width, 1), dtype=np.float32)
    color = random.random((height, width, 3), dtype=np.float32)
    rgba = np.concatenate([color * alpha, alpha], axis=-1)
    depth = random.random((height, width), dtype=np.float32) * 100.0
    depth[0, 0] = np.inf
    content = dict(rgba=rgba, depth=depth, background=np.array([0.1, 0.2, 0.3]),
                   stats={"devices": ["pocl"], "samples": np.int64(12)},
                   scene_source='version = 1\n# Köln "x"\n')
    return SimpleNamespace(**{**content, **other})


# --- what is written is read


def test_exr_keeps_every_bit_of_colour_and_depth(tmp_path):
    f = frame()
    f.rgba[1, 1] = [1e-30, 3e4, -0.0, 1.0]
    save_frame(f, tmp_path / "a.exr")
    image = load_image(tmp_path / "a.exr")
    assert image["rgba"].dtype == np.float32 and image["rgba"].tobytes() == f.rgba.tobytes()
    assert image["depth"].dtype == np.float32 and image["depth"].tobytes() == f.depth.tobytes()


def test_exr_holds_float32_channels_in_a_zip_compressed_file(tmp_path):
    import OpenEXR

    save_frame(frame(), tmp_path / "a.exr")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert sorted(file.channels()) == ["A", "B", "G", "R", "Z"]
        assert all(c.pixels.dtype == np.float32 for c in file.channels().values())
        assert file.header()["compression"] == OpenEXR.ZIP_COMPRESSION


def test_exr_says_how_it_was_made(tmp_path):
    f = frame()
    save_frame(f, tmp_path / "a.exr")
    header = load_image(tmp_path / "a.exr")["header"]
    assert header["scene"] == f.scene_source
    assert header["stats"] == {"devices": ["pocl"], "samples": 12}
    assert header["device"] == "pocl" and header["numpy_version"] == np.__version__
    assert header["clvol_version"] and header["pyopencl_version"]


def test_exr_without_depth_has_no_z(tmp_path):
    save_frame(frame(depth=None, scene_source=None, stats={}), tmp_path / "a.exr")
    image = load_image(tmp_path / "a.exr")
    assert image["depth"] is None and "scene" not in image["header"]


def test_npy_is_rgba_as_it_is(tmp_path):
    f = frame()
    save_frame(f, tmp_path / "a.npy")
    array = np.load(tmp_path / "a.npy", allow_pickle=False)
    assert array.dtype == np.float32 and np.array_equal(array, f.rgba)
    assert np.array_equal(load_image(tmp_path / "a.npy")["rgba"], f.rgba)


def test_png_is_the_image_over_the_background_in_srgb(tmp_path):
    f = frame()
    save_frame(f, tmp_path / "a.png")
    image = load_image(tmp_path / "a.png")
    over = f.rgba[..., :3] + (1.0 - f.rgba[..., 3:]) * f.background
    encoded = np.where(over <= 0.0031308, 12.92 * over, 1.055 * over ** (1 / 2.4) - 0.055)
    shown = np.floor(255.0 * np.clip(encoded, 0.0, 1.0) + 0.5) / 255.0
    assert np.allclose(image["rgba"][..., :3], srgb_to_linear(shown), rtol=1e-6)
    assert np.all(image["rgba"][..., 3] == 1.0)
    assert image["header"]["Scene"] == f.scene_source
    assert image["header"]["Software"].startswith("clvol ")


def test_a_png_with_straight_alpha_is_premultiplied(tmp_path):
    from PIL import Image

    Image.fromarray(np.array([[[255, 128, 0, 51]]], dtype=np.uint8)).save(tmp_path / "a.png")
    expected = np.array([1.0, srgb_to_linear(128 / 255), 0.0, 1.0]) * 0.2
    assert np.allclose(load_image(tmp_path / "a.png")["rgba"], expected, rtol=1e-6)


@pytest.mark.parametrize("ending", ["exr", "png", "npy", "PNG", "NPY", "EXR"])
def test_one_pixel_and_any_case_of_the_ending(tmp_path, ending):
    save_frame(frame(1, 1), tmp_path / f"a.{ending}")
    assert load_image(tmp_path / f"a.{ending}")["rgba"].shape == (1, 1, 4)
    assert os.listdir(tmp_path) == [f"a.{ending}"]


# --- display


def test_every_level_of_eight_bits_survives_decoding_and_encoding():
    levels = np.arange(256)
    rgba = np.ones((1, 256, 4), dtype=np.float32)
    rgba[0, :, :3] = srgb_to_linear(levels / 255.0)[:, None]
    assert np.array_equal(display(rgba, (0, 0, 0))[0, :, 0], levels)


def test_levels_are_rounded_to_nearest():
    edges = (np.arange(255) + 0.5) / 255.0  # between a level and the next
    below, above = (srgb_to_linear(edges + d) for d in (-1e-5, 1e-5))
    for light, level in ((below, np.arange(255)), (above, np.arange(1, 256))):
        rgba = np.ones((1, 255, 4))
        rgba[0, :, :3] = light[:, None]
        assert np.array_equal(display(rgba, (0, 0, 0))[0, :, 1], level)


def test_pixels_that_are_no_numbers_never_become_garbage():
    rgba = np.zeros((2, 3, 4), dtype=np.float32)
    rgba[0, 0] = [np.nan, 0.5, 0.5, 1.0]
    rgba[0, 1] = [0.5, 0.5, 0.5, np.nan]
    rgba[0, 2] = [np.inf, -np.inf, 0.0, 1.0]
    rgba[1, 0] = [0.0, 0.0, 0.0, np.inf]
    rgba[1, 1] = [0.0, 0.0, 0.0, -np.inf]
    rgba[1, 2] = [7.0, -7.0, 1.0, 1.0]
    with np.errstate(all="raise"):
        shown = display(rgba, (1.0, 0.0, 0.0))
    red = [255, 0, 0]
    assert shown.tolist() == [[red, red, [255, 0, 0]], [[0, 0, 0], red, [255, 0, 255]]]


# --- whole or not at all


@pytest.mark.parametrize("ending", ["exr", "png", "npy"])
def test_a_file_is_replaced_and_nothing_else_is_left(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    path.write_bytes(b"old")
    save_frame(frame(), path)
    assert os.listdir(tmp_path) == [path.name]
    assert load_image(path)["rgba"].shape == (5, 7, 4)


_FULL = """
import resource, sys
import numpy as np
from types import SimpleNamespace
from clvol.errors import RenderError
from clvol.image import save_frame
import clvol.image.exr, clvol.image.png, clvol.image.npy, OpenEXR, PIL.Image
rgba = np.random.default_rng(0).random((64, 64, 4), dtype=np.float32)
frame = SimpleNamespace(rgba=rgba, depth=None, background=(0, 0, 0), stats={}, scene_source=None)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    save_frame(frame, sys.argv[1])
except RenderError as error:
    right = error.exit_status == 4 and sys.argv[1] in str(error)
    sys.exit(0 if right else f"wrong message: {error}")
sys.exit("no error")
"""


@pytest.mark.parametrize("room", [0, 100, 9000])
@pytest.mark.parametrize("ending", ["exr", "png", "npy"])
def test_a_disk_that_is_full_leaves_the_old_file_and_no_other(tmp_path, ending, room):
    path = tmp_path / f"a.{ending}"
    path.write_bytes(b"old")
    done = subprocess.run([sys.executable, "-c", _FULL, str(path), str(room)],
                          stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0, done.stderr
    assert os.listdir(tmp_path) == [path.name] and path.read_bytes() == b"old"


@pytest.mark.parametrize("failure", [
    OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), KeyboardInterrupt(), MemoryError(),
    ValueError("bug")])
def test_whatever_ends_the_writing_leaves_nothing(tmp_path, failure):
    expected = RenderError if isinstance(failure, OSError) else type(failure)
    with pytest.raises(expected) as raised, atomic_path(tmp_path / "a.exr") as temporary:
        temporary.write_bytes(b"half")
        raise failure
    assert os.listdir(tmp_path) == []
    if expected is RenderError:
        assert "No space left" in str(raised.value) and "a.exr" in str(raised.value)


def test_a_flush_that_fails_leaves_nothing(tmp_path, monkeypatch):
    def full(_descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RenderError, match="No space left"):
        save_frame(frame(), tmp_path / "a.npy")
    assert os.listdir(tmp_path) == []


def test_a_link_is_followed(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "a.npy").write_bytes(b"old")
    (tmp_path / "a.npy").symlink_to(tmp_path / "real" / "a.npy")
    save_frame(frame(), tmp_path / "a.npy")
    assert (tmp_path / "a.npy").is_symlink()
    assert load_image(tmp_path / "real" / "a.npy")["rgba"].shape == (5, 7, 4)


# --- wrong places and wrong files


@pytest.mark.parametrize("path, part", [
    ("nowhere/a.exr", "does not exist"), ("a.bmp", ".exr or .png or .jpg or .jpeg or .tif or "), ("a", "ending"),
    ("folder.exr", "folder"), ("file.txt/a.png", "is not a folder"),
    ("x" * 300 + "/a.png", "does not exist"), ("x" * 300 + ".png", "too long"),
    ("a\0b.png", "null"),
])
def test_an_impossible_place_is_the_user_s_error(tmp_path, path, part):
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "file.txt").write_text("")
    for call in (check_output, lambda p: save_frame(frame(), p)):
        with pytest.raises(UsageError, match=part) as raised:
            call(tmp_path / path)
        assert raised.value.exit_status == 2 and "\n" not in str(raised.value)
    assert sorted(os.listdir(tmp_path)) == ["file.txt", "folder.exr"]


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.EPERM])
def test_a_folder_that_cannot_be_written_to_is_the_user_s_error(tmp_path, monkeypatch, code):
    def refuse(*_arguments):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr("clvol.image.atomic.os.open", refuse)
    with pytest.raises(UsageError, match="that can be written to"):
        check_output(tmp_path / "a.exr")


def test_checking_an_output_leaves_what_is_there(tmp_path):
    (tmp_path / "a.exr").write_bytes(b"old")
    check_output(tmp_path / "a.exr")
    assert (tmp_path / "a.exr").read_bytes() == b"old" and os.listdir(tmp_path) == ["a.exr"]


@pytest.mark.parametrize("ending", ["exr", "png", "npy"])
@pytest.mark.parametrize("keep", [0, 4, 60, 200])
def test_a_damaged_picture_is_refused_in_one_line(tmp_path, ending, keep, capfd):
    path = tmp_path / f"a.{ending}"
    save_frame(frame(), path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UsageError) as raised:
        load_image(path)
    assert raised.value.exit_status == 2 and "a." in str(raised.value)


def test_a_missing_picture_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no such file"):
        load_image(tmp_path / "a.exr")


@pytest.mark.parametrize("array", [np.zeros((3, 4)), np.zeros((2, 2, 4), int), np.zeros((0, 2, 4)),
                                   np.zeros((2, 2, 2)), np.array([{}], dtype=object)])
def test_an_array_that_is_no_picture_is_refused(tmp_path, array):
    np.save(tmp_path / "a.npy", array, allow_pickle=True)
    with pytest.raises(UsageError):
        load_image(tmp_path / "a.npy")


@pytest.mark.parametrize("shape", [(4,), (3, 4), (2, 2, 3), (0, 3, 4)])
def test_a_frame_of_a_wrong_shape_is_refused(tmp_path, shape):
    with pytest.raises(UsageError, match="height, width, 4"):
        save_frame(frame(rgba=np.zeros(shape, dtype=np.float32)), tmp_path / "a.exr")
    assert os.listdir(tmp_path) == []


def test_the_statistics_are_json_whatever_they_hold(tmp_path):
    given = {"a": np.float32(0.5), "b": np.arange(2), "c": Path("x")}
    save_frame(frame(stats=given), tmp_path / "a.exr")
    stats = load_image(tmp_path / "a.exr")["header"]["stats"]
    assert stats == {"a": 0.5, "b": [0, 1], "c": "x"} and json.dumps(stats)
