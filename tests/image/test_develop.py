"""Light becomes the colours of a displayed picture: exposure, tone curve, background, transparency; in every format."""

from __future__ import annotations

import io
import json
from types import SimpleNamespace

import numpy as np
import pytest

from clvol.errors import UsageError
from clvol.image import is_intact, load_image, picture_texts, save_frame, write_frame
from clvol.image.develop import TONE_CURVES, developed, display
from clvol.scene import Display
from clvol.transfer.color import linear_to_srgb, srgb_to_linear

DISPLAYED = ["png", "jpg", "tif"]


def light(height: int = 9, width: int = 11) -> np.ndarray:
    """Premultiplied light from dark to brighter than white, of any opacity."""
    random = np.random.default_rng(3)
    alpha = random.random((height, width, 1))
    alpha[0] = 1.0
    alpha[1] = 0.0
    color = 3.0 * random.random((height, width, 3)) ** 2
    return np.concatenate([color * alpha, alpha], axis=-1).astype(np.float32)


def frame(rgba=None, **other):
    content = dict(rgba=light() if rgba is None else rgba, depth=None, background=np.array([0.1, 0.2, 0.3]), stats={},
                   scene_source="version = 1\n", made_from=lambda: {"voxels": "x"}, display=Display())
    return SimpleNamespace(**{**content, **other})


def test_without_settings_the_picture_is_the_light_over_the_background():
    rgba, behind = light(), np.array([0.1, 0.2, 0.3])
    over = np.clip(rgba[..., :3].astype(float) + (1 - rgba[..., 3:].astype(float)) * behind, 0, 1)
    expected = np.floor(255 * linear_to_srgb(over) + 0.5).astype(np.uint8)
    assert np.array_equal(display(rgba, behind), expected)
    assert np.array_equal(developed(rgba, behind, Display()), expected)


@pytest.mark.parametrize("stops", [-3.0, 1.0, 2.5])
def test_a_stop_doubles_the_light_and_leaves_the_background(stops):
    rgba, behind = light(), (0.5, 0.25, 0.75)
    doubled = rgba.astype(np.float64)
    doubled[..., :3] *= 2.0**stops
    found = developed(rgba, behind, Display(exposure=stops))
    assert np.abs(found.astype(int) - developed(doubled, behind).astype(int)).max() <= 1
    assert np.array_equal(found[1], display(rgba, behind)[1])  # nothing but background


@pytest.mark.parametrize("curve", TONE_CURVES)
def test_curves_are_monotonous_from_black_to_white(curve):
    white = 4.0
    levels = np.linspace(0.0, 1.5 * white, 400)
    grey = np.concatenate([np.repeat(levels[:, None], 3, axis=1), np.ones((400, 1))], axis=1)[None].astype(np.float32)
    shown = developed(grey, (0, 0, 0), Display(tone_curve=curve, white=white), bits=16)[0, :, 0].astype(int)
    assert shown[0] == 0 and shown[-1] == 65535 and (np.diff(shown) >= 0).all()
    if curve != "clip":
        assert shown[levels < 0.95 * white].max() < 65535  # white is where it is said to be
        at_white = shown[np.argmin(np.abs(levels - white))]
        assert at_white > 65300


def test_the_filmic_curve_keeps_middle_grey():
    grey = np.array([[[0.18, 0.18, 0.18, 1.0]]], np.float32)
    found = srgb_to_linear(developed(grey, (0, 0, 0), Display(tone_curve="filmic"), bits=16)[0, 0] / 65535)
    assert np.allclose(found, 0.18, atol=2e-5)


def test_reinhard_keeps_the_ratios_of_the_channels():
    pixel = np.array([[[0.8, 0.4, 0.2, 1.0]]], np.float32)
    found = srgb_to_linear(developed(pixel, (0, 0, 0), Display(tone_curve="reinhard"), bits=16)[0, 0] / 65535)
    assert found[0] / found[1] == pytest.approx(2, rel=1e-3) and found[1] / found[2] == pytest.approx(2, rel=1e-3)


@pytest.mark.parametrize("curve", ["reinhard", "filmic"])
def test_a_pixel_that_is_half_covered_is_half_of_the_mapped_colour(curve):
    how = Display(tone_curve=curve)
    whole = np.array([[[2.0, 1.0, 0.5, 1.0]]], np.float32)
    mapped = srgb_to_linear(developed(whole, (0, 0, 0), how, bits=16)[0, 0] / 65535)
    half = srgb_to_linear(developed(0.5 * whole, (0.3, 0.3, 0.3), how, bits=16)[0, 0] / 65535)
    assert np.allclose(half, 0.5 * mapped + 0.15, atol=1e-4)


@pytest.mark.parametrize("curve", TONE_CURVES)
def test_numbers_that_are_none_show_the_background(curve):
    rgba = light()
    rgba[3, 3, 3] = 1.0
    rgba[2, 2, 0], rgba[3, 3, 1], rgba[4, 4, 2] = np.nan, np.inf, -np.inf
    shown = developed(rgba, (0.2, 0.2, 0.2), Display(tone_curve=curve, exposure=100.0))
    assert (shown[2, 2] == display(np.zeros((1, 1, 4), np.float32), (0.2, 0.2, 0.2))[0, 0]).all()
    assert shown[3, 3, 1] == 255


@pytest.mark.parametrize(("ending", "bits"), [("png", 8), ("tif", 16)])
def test_transparent_pictures_are_the_same_over_any_background(tmp_path, ending, bits):
    rgba = np.clip(light(), 0.0, 1.0)
    rgba[..., :3] = np.minimum(rgba[..., :3], rgba[..., 3:])
    f = frame(rgba, display=Display(transparent=True))
    save_frame(f, tmp_path / f"a.{ending}")
    read = load_image(tmp_path / f"a.{ending}")
    assert read["has_alpha"] and read["header"]["bits"] == bits
    assert np.abs(read["rgba"] - rgba).max() < 2.5 / 2**bits * (1 if bits == 8 else 1.5)
    assert is_intact(tmp_path / f"a.{ending}", read)
    assert not read["rgba"][1].any()


@pytest.mark.parametrize("ending", [*DISPLAYED, "jpeg", "tiff", "TIF"])
def test_displayed_pictures_come_back_as_they_were_shown(tmp_path, ending):
    f = frame()
    save_frame(f, tmp_path / f"a.{ending}")
    read = load_image(tmp_path / f"a.{ending}")
    assert not read["has_alpha"] and (read["rgba"][..., 3] == 1).all()
    shown = display(read["rgba"], (0, 0, 0)).astype(int)
    limit = 24 if ending.startswith("jp") else 0  # noise is what JPEG compresses worst
    assert np.abs(shown - display(f.rgba, f.background).astype(int)).max() <= limit
    assert is_intact(tmp_path / f"a.{ending}", read) and read["made_from"]["voxels"] == "x"
    assert np.allclose(read["background"], f.background)
    read["rgba"][0, 0] = 0.5
    assert not is_intact(tmp_path / f"a.{ending}", read)


def test_a_tiff_has_sixteen_bits_that_other_tools_read(tmp_path):
    import tifffile

    f = frame()
    save_frame(f, tmp_path / "a.tif")
    pixels = tifffile.imread(tmp_path / "a.tif")
    assert pixels.dtype == np.uint16
    assert np.array_equal(pixels, developed(f.rgba, f.background, f.display, 16))


@pytest.mark.parametrize("extra", [None, "unassalpha", "assocalpha"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_tiffs_of_other_tools_are_read(tmp_path, dtype, extra):
    import tifffile

    full = np.iinfo(dtype).max
    pixels = np.zeros((2, 3, 3 if extra is None else 4), dtype)
    pixels[..., 0] = full // 2 if extra == "assocalpha" else full
    if extra is not None:
        pixels[..., 3] = full // 2
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb", extrasamples=None if extra is None else [extra])
    rgba = load_image(tmp_path / "a.tif")["rgba"]
    alpha = 1.0 if extra is None else (full // 2) / full
    assert np.allclose(rgba, [alpha, 0, 0, alpha], atol=0.005)


def test_tiffs_that_are_no_pictures_are_refused(tmp_path):
    import tifffile

    for name, pixels in (("float", np.zeros((2, 2), np.float32)), ("stack", np.zeros((2, 2, 7), np.uint8))):
        tifffile.imwrite(tmp_path / f"{name}.tif", pixels, photometric="minisblack")
        if name == "float":
            with pytest.raises(UsageError, match="the pixels are float32 .*, expected grey or RGB with 8 or 16 bits"):
                load_image(tmp_path / f"{name}.tif")


@pytest.mark.parametrize("ending", ["jpg", "tif"])
def test_a_picture_that_is_too_large_is_refused_from_its_header(tmp_path, ending):
    save_frame(frame(np.zeros((64, 64, 4), np.float32)), tmp_path / f"a.{ending}")
    with pytest.raises(UsageError, match="a picture|the picture of 64 x 64 pixels needs"):
        load_image(tmp_path / f"a.{ending}", memory_cap=1000)


@pytest.mark.parametrize("ending", ["jpg", "tif"])
@pytest.mark.parametrize("keep", [0, 3, 40, 200])
def test_a_damaged_picture_is_refused_in_one_line(tmp_path, ending, keep):
    path = tmp_path / f"a.{ending}"
    save_frame(frame(), path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UsageError) as raised:
        load_image(path)
    assert "\n" not in str(raised.value)


def test_a_jpeg_of_a_transparent_picture_is_refused(tmp_path):
    with pytest.raises(UsageError, match="a.jpg.*transparent.*expected .png or .tif"):
        save_frame(frame(display=Display(transparent=True)), tmp_path / "a.jpg")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("length", [10, 70_000])
def test_the_comment_of_a_jpeg_holds_the_scene_if_it_fits(tmp_path, length):
    save_frame(frame(scene_source="x" * length), tmp_path / "a.jpg")
    texts = picture_texts(tmp_path / "a.jpg")
    assert ("scene" in texts) == (length == 10) and json.loads(texts["made_from"])["voxels"] == "x"


@pytest.mark.parametrize("ending", ["png", "exr", "npy", "jpg", "tif"])
def test_a_stream_gets_the_bytes_of_a_file(tmp_path, ending):
    stream = io.BytesIO()
    write_frame(frame(), stream, f".{ending}")
    (tmp_path / f"b.{ending}").write_bytes(stream.getvalue())
    save_frame(frame(), tmp_path / f"a.{ending}")
    assert np.array_equal(load_image(tmp_path / f"a.{ending}")["rgba"], load_image(tmp_path / f"b.{ending}")["rgba"])


def test_a_stream_of_an_unknown_kind_stays_empty():
    stream = io.BytesIO()
    with pytest.raises(UsageError, match="unknown ending"):
        write_frame(frame(), stream, ".bmp")
    assert not stream.getvalue()


@pytest.mark.parametrize("stream", [3, None, io.StringIO(), b"bytes"])
def test_what_is_no_binary_file_is_refused(stream):
    from clvol.render.frame import Frame

    with pytest.raises(UsageError, match="frame.save: got a .*, expected a path, or a binary file"):
        Frame(light()).save(stream)
