"""Pictures of different kinds are compared in what both hold."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from clvol.accuracy.pair import comparable
from clvol.errors import UsageError
from clvol.image import load_image, save_frame
from clvol.transfer.color import linear_to_srgb, srgb_to_linear

BACKGROUND = np.array([0.1, 0.4, 0.7])
KINDS = ["exr", "png", "npy"]


def frame(seed: int = 1, **other):
    random = np.random.default_rng(seed)
    alpha = random.random((24, 30, 1), dtype=np.float32)
    color = random.random((24, 30, 3), dtype=np.float32)
    rgba = np.concatenate([color * alpha, alpha], axis=-1)
    content = {"rgba": rgba, "depth": np.full((24, 30), 2.0, np.float32), "background": BACKGROUND,
               "stats": {}, "scene_source": "version = 1\n"}
    return SimpleNamespace(**{**content, **other})


@pytest.fixture
def pictures(tmp_path, monkeypatch):
    """One frame as each kind, and another one."""
    monkeypatch.chdir(tmp_path)
    for kind in KINDS:
        save_frame(frame(), f"a.{kind}")
        save_frame(frame(2), f"b.{kind}")


def pair_of(a: str, b: str):
    return comparable(load_image(a), load_image(b), (a, b))


@pytest.mark.parametrize(("a", "b"), list(itertools.product(KINDS, KINDS)))
def test_one_frame_is_itself_in_every_kind(pictures, a, b):
    told = pair_of(f"a.{a}", f"a.{b}").measures()
    if "png" in (a, b) and a != b:
        rounding = told["rounding"]
        assert 0 < told["rmse"] == pytest.approx(rounding["rmse"], rel=0.01)
        assert told["max_abs"] == pytest.approx(rounding["max_abs"], rel=0.01)
        assert told["max_abs"] < 2.3 / 510 and rounding["bits"] == 8  # the curve's slope at white
        assert told["delta_e_max"] < 2 and told["ssim"] > 0.999
        assert told["background"] == pytest.approx(BACKGROUND)
        assert "R, G, B" in told["compared"] and any("opacity" in s for s in told["left_out"])
    else:
        assert told["rmse"] == told["max_abs"] == told["delta_e_max"] == 0
        assert told["compared"] == "R, G, B, A" and told["rounding"] is told["background"] is None


@pytest.mark.parametrize(("a", "b"), [("exr", "png"), ("png", "exr"), ("npy", "png")])
def test_two_frames_differ_by_their_colours_over_the_background(pictures, a, b):
    told = pair_of(f"a.{a}", f"b.{b}").measures()
    over = [f.rgba[..., :3] + (1 - f.rgba[..., 3:]) * BACKGROUND for f in (frame(), frame(2))]
    which = 0 if a == "png" else 1
    over[which] = srgb_to_linear(np.floor(255 * linear_to_srgb(over[which]) + 0.5) / 255)
    assert told["rmse"] == pytest.approx(np.sqrt(np.mean((over[0] - over[1]) ** 2)), rel=1e-5)
    assert told["max_abs"] == pytest.approx(np.abs(over[0] - over[1]).max(), rel=1e-5)


def test_the_difference_shows_colours_alone(pictures):
    pair = pair_of("a.exr", "b.png")
    assert (pair.first[..., 3] == 1).all() and (pair.second[..., 3] == 1).all()


def test_a_png_of_another_tool_is_over_what_the_other_picture_tells(pictures):
    from PIL import Image

    with Image.open("a.png") as image:
        Image.fromarray(np.asarray(image)).save("plain.png")
    for other in ("a.exr", "a.npy"):
        told = pair_of(other, "plain.png").measures()
        assert told["rmse"] < 0.003 and told["background"] == pytest.approx(BACKGROUND)
    np.save("plain.npy", frame().rgba)
    told = pair_of("plain.npy", "a.png").measures()
    assert told["rmse"] < 0.003
    told = pair_of("plain.npy", "plain.png").measures()
    assert told["background"] == [0, 0, 0] and any("black" in s for s in told["left_out"])


def test_another_background_is_told(pictures):
    save_frame(frame(background=np.array([1.0, 0.0, 0.0])), "c.exr")
    told = pair_of("c.exr", "a.png").measures()
    assert told["rmse"] < 0.003 and any("states another" in s for s in told["left_out"])


def test_light_that_a_screen_cannot_show_is_left_out(pictures):
    f = frame()
    f.rgba[0, 0] = [5.0, 0.0, 0.0, 1.0]
    f.rgba[0, 1] = [np.nan, 0.0, 0.0, 1.0]
    save_frame(f, "c.exr")
    save_frame(f, "c.png")
    told = pair_of("c.exr", "c.png").measures()
    assert told["rmse"] < 0.003 and told["max_abs"] < 0.005
    said = " ".join(told["left_out"])
    assert "beyond 0 to 1 in 1 pixels" in said and "1 pixels of c.exr that are not a number" in said


def test_opacity_counts_where_both_have_it(tmp_path):
    """A PNG of another tool may have one; three channels of an array have none."""
    from PIL import Image

    pixels = np.random.default_rng(3).integers(0, 256, (20, 20, 4)).astype(np.uint8)
    Image.fromarray(pixels).save(tmp_path / "a.png")
    rgba = load_image(tmp_path / "a.png")["rgba"]
    np.save(tmp_path / "a.npy", rgba)
    told = pair_of(tmp_path / "a.npy", tmp_path / "a.png").measures()
    assert told["compared"] == "R, G, B, A" and told["rmse"] == 0 and told["rounding"] == {"bits": 8}
    np.save(tmp_path / "b.npy", rgba[..., :3])
    told = pair_of(tmp_path / "a.npy", tmp_path / "b.npy").measures()
    assert "R, G, B over" in told["compared"] and told["rounding"] is None


def test_what_a_png_reader_does_not_read_is_told(tmp_path, monkeypatch):
    import struct
    import zlib

    monkeypatch.chdir(tmp_path)

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">2I5B", 12, 12, 16, 2, 0, 0, 0)
    rows = zlib.compress(b"".join(b"\0" + bytes(72) for _ in range(12)))
    parts = [chunk(b"IHDR", head), chunk(b"gAMA", struct.pack(">I", 100000)), chunk(b"IDAT", rows)]
    (tmp_path / "deep.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts) + chunk(b"IEND", b""))
    said = " ".join(pair_of("deep.png", "deep.png").left_out)
    assert "lower 8 bits" in said and "colour profile" in said


@pytest.mark.parametrize(("a", "b"), list(itertools.product(KINDS, KINDS)))
def test_other_sizes_are_an_error(pictures, a, b):
    from clvol.cli.compare import _compare

    f = frame()
    f.rgba, f.depth = f.rgba[:, 1:], f.depth[:, 1:]
    save_frame(f, f"c.{b}")
    with pytest.raises(UsageError, match="got 29 x 24 pixels, expected 30 x 24 pixels"):
        _compare(f"a.{a}", f"c.{b}", (), False, None)


def test_the_command_tells_it_in_text_and_json(pictures):
    command = [sys.executable, "-m", "clvol", "compare", "a.exr", "a.png"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "left out" in text and "opacity" in text and "rounded to 8 bits" in text
    told = json.loads(subprocess.run([*command, "--json"], capture_output=True, check=True).stdout)
    assert {"rmse", "max_abs", "psnr", "ssim", "delta_e_mean", "delta_e_max"} <= set(told)
    assert told["left_out"] and told["rounding"]["bits"] == 8
