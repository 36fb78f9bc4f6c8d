"""Names, keys and numbers at the limits of the system: one line, and nothing is left."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from clvol.image import load_image

LONG = "x" * 300
DEEP = ".".join(["a"] * 1000)


@pytest.mark.parametrize(
    "words",
    [
        ["render", f"{LONG}.toml", "-o", "b.png"],
        ["render", f"{LONG}.npy", "-o", "b.png"],
        ["render", LONG, "-o", "b.png"],
        ["render", "scene.toml", "-o", f"{LONG}.png"],
        ["render", "scene.toml", "-o", f"{LONG}/b.png"],
        ["render", "scene.toml", "-o", "b.png", "--stats", LONG],
        ["render", "scene.toml", "-o", "b.png", "--set", f'volume.file="{LONG}.npy"'],
        ["render", "scene.toml", "-o", "b.png", "--set", f'environment.file="{LONG}.exr"'],
        ["render", "scene.toml", "-o", "b.png", "--set", f'field=[{{file="{LONG}.npy",role="mask"}}]'],
        # a name that only the last frame makes too long
        ["render", "scene.toml", "-o", "x" * 249 + "_%d.npy", "--set", "animation.frames=12"],
        ["info", f"{LONG}.nrrd"],
        ["info", f"{LONG}.zarr"],
        ["info", LONG],
        ["info", f"{LONG}/{LONG}/x.npy"],
        ["explain", f"{LONG}.toml"],
        ["compare", f"{LONG}.png", "a.npy"],
        ["compare", "a.npy", f"{LONG}.npy"],
        ["compare", "a.npy", "a.npy", "-o", f"{LONG}.png"],
        ["store", "cube.npy", "-o", LONG],
        ["store", "cube.npy", "-o", "x" * 250],  # for .partial there is no room
        ["store", f"{LONG}.npy", "-o", "s"],
        ["tradeoff", "scene.toml", "-o", LONG],
        ["tradeoff", f"{LONG}.toml", "-o", "out"],
    ],
    ids=lambda words: " ".join(words)[:40],
)
def test_names_that_are_too_long(refused, folder, renderer, words):
    np.save("a.npy", np.zeros((2, 3, 4), np.float32))
    before = sorted(os.listdir())
    line = refused(2, *words)
    assert "internal" not in line and len(line) < 5000
    assert sorted(os.listdir()) == before and renderer.rendered == []


@pytest.mark.parametrize(
    "text",
    [
        f"{DEEP} = 1\n", f"[{DEEP}]\nx = 1\n", f"[image.{DEEP}]\n", f"[[{DEEP}]]\n",
        "x = " + "[" * 1000 + "]" * 1000 + "\n", "x = " + "{a=" * 1000 + "1" + "}" * 1000 + "\n",
        "x" * 10**6 + " = 1\n", f'x = "{"y" * 10**6}"\n', "x = 1" + "0" * 10**5 + "\n",
        "".join(f"k{i} = 1\n" for i in range(20_000)),
    ],
    ids=lambda text: text[:20],
)
def test_keys_and_values_that_are_too_deep_or_too_long(refused, folder, renderer, text):
    (folder / "deep.toml").write_text(text + (folder / "scene.toml").read_text())
    before = sorted(os.listdir())
    for words in (["render", "deep.toml", "-o", "b.png"], ["info", "deep.toml"]):
        line = refused(2, *words)
        assert line.startswith("deep.toml") and len(line) < 5000
    assert sorted(os.listdir()) == before


@pytest.mark.parametrize("key", [DEEP, f"image.{DEEP}", "image.width." + DEEP, "light." + "0." * 999 + "x"])
def test_overrides_that_are_too_deep(refused, folder, renderer, key):
    assert len(refused(2, "render", "scene.toml", "-o", "b.png", "--set", f"{key}=1")) < 5000


@pytest.mark.parametrize("value", ["1e-305", "1e-320", "1e-11", "0", "-1", "nan", "inf", "-inf", "x", ""])
@pytest.mark.parametrize("option", ["--time-budget", "--max-error"])
def test_aims_that_cannot_be(refused, nothing_left, option, value):
    assert option in refused(2, "render", "scene.toml", "-o", "b.png", f"{option}={value}")


@pytest.mark.slow
def test_the_search_for_a_time_takes_any_number(device):
    """What overflowed: the ratio of a time to the budget, squared."""
    import clvol
    from clvol.accuracy.time_target import render_in_time
    from clvol.errors import UsageError

    volume = clvol.Volume(np.arange(64, dtype=np.uint8).reshape(4, 4, 4))
    scene = clvol.Scene(volume=volume, image={"width": 8, "height": 6})
    with pytest.raises(UsageError, match="time_budget: got 1e-09 s, expected at least"):
        render_in_time(scene, 1e-9, devices=[device])
    with pytest.raises(UsageError, match="time_budget: got 1e-305, expected seconds, at least"):
        render_in_time(scene, 1e-305, devices=[device])


# --- pipes


def command(*words: str, **how) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "clvol", *words], capture_output=True, text=True, timeout=300, **how
    )


@pytest.mark.parametrize(
    "words",
    [
        ["render", "pipe.toml", "-o", "x.png"], ["explain", "pipe.toml"], ["info", "pipe.npy"],
        ["info", "pipe.nrrd"], ["compare", "pipe.png", "pipe.png"], ["compare", "a.npy", "pipe.exr"],
        ["store", "pipe.npy", "-o", "s"], ["tradeoff", "pipe.toml", "-o", "out"],
        ["info", "slices"], ["info", "v.zarr"], ["render", "sky.toml", "-o", "x.png"],
        ["info", "head.nhdr"], ["render", "scene.toml", "-o", "pipe.png"],
    ],
    ids=lambda words: " ".join(words[:2]),
)  # fmt: skip
def test_a_pipe_is_not_waited_for(folder, words):
    np.save("a.npy", np.zeros((2, 3, 4), np.float32))
    for place in ("slices", "v.zarr"):
        os.mkdir(place)
    pipes = ["pipe.toml", "pipe.npy", "pipe.nrrd", "pipe.png", "pipe.exr", "slices/pipe"]
    for name in [*pipes, "v.zarr/zarr.json"]:
        os.mkfifo(name)
    text = (folder / "scene.toml").read_text()
    (folder / "sky.toml").write_text(text + '[environment]\nfile = "pipe.exr"\n')
    head = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nencoding: raw\ndata file: pipe.npy\n"
    (folder / "head.nhdr").write_text(head)
    done = command(*words)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("clvol: error: ") and done.stderr.count("\n") == 1


# --- names that are not UTF-8


def raw(name: str) -> str:
    """A name with a byte that is no UTF-8, as Python has it."""
    return name.replace("*", "\udcff")


@pytest.fixture
def bytes_in_names(folder):
    try:
        os.mkdir(raw("f*"))
    except OSError:
        pytest.skip("the file system takes UTF-8 names alone")
    for name in ("cube.npy", "scene.toml"):
        os.link(name, raw(f"f*/{name}"))
    os.link("cube.npy", raw("v*.npy"))
    return folder


@pytest.mark.parametrize("scene", ["scene.toml", "f*/scene.toml", "v*.npy"])
def test_files_of_every_kind_with_names_that_are_not_utf_8(run, bytes_in_names, renderer, scene):
    names = [raw(f"{place}o*.{kind}") for place in ("", "f*/") for kind in ("exr", "png", "npy")]
    outputs = [word for name in names for word in ("-o", name)]
    more = ["--set", "image.width=8", "--set", "image.height=6"]
    outcome = run("render", raw(scene), *outputs, "--stats", raw("s*.json"), *more)
    assert (outcome.status, outcome.err) == (0, "")
    assert outcome.out.splitlines() == [n.replace("\udcff", "\\xff") for n in [*names, raw("s*.json")]]
    for name in names:
        picture = load_image(name)
        assert picture["rgba"].shape == (6, 8, 4)
    json.loads(open(raw("s*.json"), encoding="utf-8").read())
    assert run("compare", names[0], names[1], "-o", raw("d*.exr"), "-o", raw("d*.png")).status == 0
    assert run("info", raw(scene)).status == 0 and run("info", raw(scene), "--json").status == 0


def test_animations_with_names_that_are_not_utf_8(run, bytes_in_names, renderer):
    files = ["-o", raw("a*_%d.exr"), "-o", raw("a*_%d.npy")]
    words = ["render", "scene.toml", *files, "--set", "animation.frames=3"]
    assert run(*words, "-o", raw("v*.gif")).status == 0
    renderer.rendered.clear()
    assert run(*words, "--resume").status == 0 and renderer.rendered == []


def test_a_store_has_a_name_in_utf_8(refused, run, bytes_in_names):
    """tensorstore takes no other."""
    for place in (raw("s*"), raw("f*/s")):
        assert "UTF-8" in refused(2, "store", "cube.npy", "-o", place)
    assert run("store", raw("v*.npy"), "-o", "s").status == 0
    os.rename("s", raw("s*"))
    assert "UTF-8" in refused(2, "info", raw("s*"))


# --- no room


@pytest.mark.parametrize("room", ["full", "missing", "a file"])
def test_a_temporary_folder_that_takes_nothing(folder, room, device, monkeypatch):
    """Whatever a picture needs of it is had elsewhere, or one line says what is wrong."""
    from clvol.opencl.devices import report_of

    place = folder / "tmp"
    if room == "a file":
        place.write_text("")
    elif room == "full":
        place.mkdir()
        place.chmod(0o500)
    environment = os.environ | {"TMPDIR": str(place)}
    done = command(
        "render", "scene.toml", "-o", "x.npy", "--device", report_of(device).name, env=environment
    )
    if done.returncode == 0:
        assert np.load("x.npy").shape == (6, 8, 4) and done.stderr == ""
    else:
        assert done.stderr.startswith("clvol: error: ") and done.stderr.count("\n") == 1
        assert not os.path.exists("x.npy")


def test_no_temporary_folder_at_all(refused, folder, renderer, monkeypatch):
    from clvol.render import Renderer

    def nowhere(*_, **__):
        raise FileNotFoundError(2, "No usable temporary directory found in ['/tmp']")

    monkeypatch.setattr(Renderer, "render", nowhere)
    line = refused(4, "render", "scene.toml", "-o", "x.npy")
    assert "No usable temporary directory" in line and "internal" not in line
    assert not os.path.exists("x.npy")


@pytest.mark.parametrize("closed", [[0], [1], [2], [0, 1, 2]])
def test_standard_streams_that_are_closed(folder, closed):
    """The numbers that are free then are not those of files that are written."""
    np.save("a.npy", np.zeros((12, 12, 4), np.float32))
    code = (
        f"import os, sys\nfor n in {closed}: os.close(n)\n"
        f"os.execv({sys.executable!r}, [{sys.executable!r}, '-m', 'clvol', *sys.argv[1:]])"
    )
    words = ["compare", "a.npy", "a.npy", "-o", "d.npy", "-o", "d.exr"]
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, timeout=300)
    assert done.returncode == 0
    for name in ("d.npy", "d.exr"):
        assert not load_image(name)["rgba"].any()
