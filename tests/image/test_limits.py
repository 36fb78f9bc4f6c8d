"""No picture takes more memory than its cap, whatever a few bytes of it promise."""

from __future__ import annotations

import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest

from clvol.errors import SceneError, UsageError
from clvol.image import load_image

MIB = 2**20


def png(path, width: int, height: int, bits: int = 8, color: int = 0) -> None:
    """Black, whole, and small for its size."""
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    channels = {0: 1, 2: 3, 4: 2, 6: 4}[color]
    row = b"\0" * (1 + -(-width * bits * channels // 8))
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    head = struct.pack(">2I5B", width, height, bits, color, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + parts)


def exr(path, width: int, height: int) -> None:
    """A small one whose header promises another size."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGBA": np.zeros((4, 5, 4), np.float32)}).write(str(path))
    content = bytearray(path.read_bytes())
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    content[at : at + 16] = struct.pack("<4i", 0, 0, width - 1, height - 1)
    path.write_bytes(content)


def npy(path, shape: tuple, kind: str = "<f4") -> None:
    """As large as its header promises, and nothing of it on the disk."""
    with open(path, "wb") as file:
        header = {"descr": kind, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        size = int(np.prod([float(n) for n in shape])) * np.dtype(kind).itemsize
        file.truncate(file.tell() + size)


def bombs(folder):
    png(folder / "one-bit.png", 12000, 12000, bits=1)
    png(folder / "grey.png", 9000, 8000)
    exr(folder / "wide.exr", 65535, 65535)
    exr(folder / "long.exr", 1, 2**30)
    npy(folder / "sparse.npy", (40000, 40000, 4))
    npy(folder / "double.npy", (9000, 9000, 3), "<f8")
    return sorted(folder.iterdir())


# Not getrusage: there the peak of the process that started this one counts, too.
_MEASURED = """
import re, sys
from clvol.cli import main
status = main(sys.argv[1:])
known = open("/proc/self/status").read()
print("peak", int(re.search("VmHWM:\\s*(\\d+)", known)[1]) // 1024, status)
"""


def test_a_bomb_is_told_before_anything_is_allocated(tmp_path):
    np.save(tmp_path / "small.npy", np.zeros((4, 4, 4), np.float32))
    for bomb in bombs(tmp_path):
        if bomb.name == "small.npy":
            continue
        words = ["small.npy", bomb.name]
        words = words if "e" in bomb.name else words[::-1]
        done = subprocess.run(
            [sys.executable, "-c", _MEASURED, "compare", *words],
            capture_output=True, text=True, cwd=tmp_path, timeout=300,
        )  # fmt: skip
        _, peak, status = done.stdout.split()
        assert status == "2" and int(peak) < 500, (bomb, done)
        assert done.stderr.startswith(f"clvol: error: {bomb.name}: ")
        assert done.stderr.count("\n") == 1
        if bomb.name != "long.exr":  # its library refuses it first
            assert "pixels needs" in done.stderr and "1 GiB" in done.stderr


@pytest.mark.parametrize("make", [
    lambda path: png(path / "a.png", 100, 50), lambda path: png(path / "a.png", 100, 50, 8, 6),
    lambda path: np.save(path / "a.npy", np.zeros((50, 100, 4), np.float32)),
    lambda path: np.save(path / "a.npy", np.zeros((50, 100, 3), np.float64)),
])  # fmt: skip
def test_the_cap_is_what_the_caller_says(tmp_path, make):
    make(tmp_path)
    file = next(tmp_path.iterdir())
    with pytest.raises(UsageError, match=r"picture of 100 x 50 pixels needs .* \(the memory cap\)"):
        load_image(file, 50 * 100 * 16)
    assert load_image(file, MIB)["rgba"].shape == (50, 100, 4)


def test_a_cap_that_is_given_may_be_larger_than_the_default(tmp_path, monkeypatch):
    from clvol.image import limits

    png(tmp_path / "a.png", 100, 50)
    monkeypatch.setattr(limits, "DEFAULT_CAP", 1000)
    with pytest.raises(UsageError, match="without --memory-cap"):
        load_image(tmp_path / "a.png")
    load_image(tmp_path / "a.png", MIB)


def test_reading_takes_what_it_was_said_to_take(tmp_path):
    """20 million pixels of 20 kB, which took gigabytes."""
    png(tmp_path / "a.png", 5000, 4000)
    code = _MEASURED.replace("main(sys.argv[1:])", "0").replace(
        "status = ", "from clvol.image import load_image; load_image('a.png'); status = "
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, timeout=300
    )
    assert int(done.stdout.split()[1]) < 20 * 24 + 250, done


def test_measures_of_large_pictures_need_little_beside_them(tmp_path):
    """By parts, and the same as all at once."""
    import tracemalloc

    from clvol.accuracy import metrics

    random = np.random.default_rng(0)
    a = random.random((600, 300, 4), dtype=np.float32)
    b = np.clip(a + random.normal(0, 0.1, a.shape).astype(np.float32), 0, 1)
    tracemalloc.start()
    told = metrics.compare(a, b)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    rows = metrics._ROWS
    try:
        metrics._ROWS = 10**6
        tracemalloc.start()
        assert metrics.compare(a, b) == pytest.approx(told, rel=1e-12)
        whole = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    finally:
        metrics._ROWS = rows
    assert peak < 0.5 * whole


# --- environments


def _scene(folder, file: str):
    import clvol

    np.save(folder / "v.npy", np.zeros((4, 4, 4), np.uint8))
    text = f'version = 1\n[volume]\nfile = "v.npy"\n[environment]\nfile = "{file}"\n'
    (folder / "s.toml").write_text(text)
    return clvol.load_scene(folder / "s.toml")


def test_environments_hold_the_cap(tmp_path):
    import OpenEXR

    exr(tmp_path / "bomb.exr", 65534, 32767)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    sky = np.ones((256, 512, 3), np.float32)
    OpenEXR.File(header, {"RGB": sky}).write(str(tmp_path / "sky.exr"))
    with pytest.raises(SceneError, match="bomb.exr: the picture of 65534 x 32767 pixels needs"):
        _scene(tmp_path, "bomb.exr").resolve()
    with pytest.raises(SceneError, match=r"sky.exr: .* at most 1 MiB \(the memory cap\)"):
        _scene(tmp_path, "sky.exr").resolve(MIB)
    _scene(tmp_path, "sky.exr").resolve(8 * MIB)


@pytest.mark.parametrize("command", ["render", "explain", "tradeoff"])
def test_every_command_holds_the_cap_for_environments(tmp_path, command, monkeypatch, capfd):
    from clvol.cli import main

    monkeypatch.chdir(tmp_path)
    exr(tmp_path / "bomb.exr", 65534, 32767)
    _scene(tmp_path, "bomb.exr")
    words = {"render": ["-o", "x.png"], "tradeoff": ["-o", "out"], "explain": []}[command]
    assert main([command, "s.toml", *words]) == 2
    assert "pixels needs" in capfd.readouterr().err
    assert not (tmp_path / "x.png").exists() and not (tmp_path / "out").exists()


def test_a_radiance_map_read_alone_holds_a_cap(tmp_path):
    from clvol.device.environment_file import load_radiance

    exr(tmp_path / "bomb.exr", 65534, 32767)
    with pytest.raises(SceneError, match="pixels needs"):
        load_radiance(tmp_path / "bomb.exr")


def test_a_png_s_texts_are_none_that_a_reader_refuses(tmp_path):
    """A scene may be larger than the texts that Pillow reads."""
    from types import SimpleNamespace

    from clvol.image import save_frame

    rgba = np.zeros((2, 2, 4), np.float32)
    save_frame(SimpleNamespace(rgba=rgba, scene_source="# x\n" * 2**19), tmp_path / "a.png")
    assert "Scene" not in load_image(tmp_path / "a.png")["header"]
