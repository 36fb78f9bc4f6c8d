"""--resume keeps a frame only where it would come out the same: by what the picture says that it was
made from, and whether its pixels are still those that were written."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading

import numpy as np
import pytest

from clvol.batch.claims import Claims
from clvol.image import load_image

COUNT = 4
ENDINGS = ["npy", "png", "exr"]


@pytest.fixture
def film(run, folder, renderer):
    """``film(ending, *more)``: the numbers of the frames that a resumed call renders."""
    text = (
        'version = 1\n[volume]\nfile = "cube.npy"\n[image]\nwidth = 8\nheight = 6\n'
        '[transfer_function]\npreset = "grayscale"\n'
        "[animation]\nframes = 4\nfps = 4\norbit_degrees = 90\n"
    )
    (folder / "film.toml").write_text(text)

    def call(ending: str, *more: str, scene: str = "film.toml") -> list[int]:
        renderer.rendered.clear()
        outcome = run("render", scene, "-o", f"a_%d.{ending}", "--resume", *more)
        assert outcome.status == 0, outcome
        return [round(4 * time) for time, _ in renderer.rendered]

    return call


@pytest.mark.parametrize("ending", ENDINGS)
def test_nothing_is_rendered_twice(film, ending):
    assert film(ending) == [0, 1, 2, 3]
    assert film(ending) == []


@pytest.mark.parametrize("ending", ENDINGS)
def test_frames_that_were_exchanged(film, folder, ending):
    film(ending)
    os.rename(f"a_1.{ending}", "x")
    os.rename(f"a_2.{ending}", f"a_1.{ending}")
    os.rename("x", f"a_2.{ending}")
    assert film(ending) == [1, 2]
    shutil.copy(f"a_0.{ending}", f"a_3.{ending}")
    assert film(ending) == [3] and film(ending) == []


@pytest.mark.parametrize("ending", ENDINGS)
def test_voxels_that_changed_in_the_same_file(film, folder, ending):
    """Also where size and time of the file are the same."""
    film(ending)
    before = os.stat("cube.npy")
    content = bytearray((folder / "cube.npy").read_bytes())
    content[-1] ^= 1
    (folder / "cube.npy").write_bytes(content)
    os.utime("cube.npy", ns=(before.st_atime_ns, before.st_mtime_ns))
    assert film(ending) == [0, 1, 2, 3] and film(ending) == []


def test_the_same_voxels_elsewhere_are_the_same(film, folder):
    film("npy")
    os.utime("cube.npy", (1, 1))
    assert film("npy") == []


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize(
    "change",
    [
        "image.background=[1.0,0.0,0.0]", "camera.fov_degrees=20.0", "animation.orbit_degrees=91.0",
        "animation.time=0.5", "integration.step=0.5", 'transfer_function.preset="hot"',
        "volume.spacing=[1,1,2]", "image.height=7",
    ],
)  # fmt: skip
def test_another_scene(film, ending, change):
    film(ending)
    assert len(film(ending, "--set", change)) == COUNT
    assert film(ending, "--set", change) == []


@pytest.mark.parametrize("ending", ENDINGS)
def test_another_version(film, ending, monkeypatch):
    import clvol

    film(ending)
    monkeypatch.setattr(clvol, "__version__", "9.9.9")
    assert film(ending) == [0, 1, 2, 3] and film(ending) == []


def _cut(content: bytearray) -> bytearray:
    return content[: len(content) // 2]


def _last_byte(content: bytearray) -> bytearray:
    content[-1] ^= 1
    return content


def _one_pixel(content: bytearray) -> bytearray:
    content[200] ^= 0x40  # within the pixels of an .npy of 8 x 6
    return content


@pytest.mark.parametrize(
    ("ending", "damage"),
    [(ending, _cut) for ending in ENDINGS] + [("npy", _last_byte), ("npy", _one_pixel)],
)
def test_a_damaged_file(film, folder, ending, damage):
    film(ending)
    file = folder / f"a_2.{ending}"
    file.write_bytes(damage(bytearray(file.read_bytes())))
    assert film(ending) == [2] and film(ending) == []


@pytest.mark.parametrize("ending", ENDINGS)
def test_any_byte_that_changes_a_pixel_counts(film, folder, ending):
    """A byte is changed at random: either the picture still reads as it did, or it is made anew."""
    film(ending)
    file = folder / f"a_1.{ending}"
    whole, before = file.read_bytes(), load_image(file)["rgba"].tobytes()
    random = np.random.default_rng(7)
    for at in random.integers(0, len(whole), 12):
        content = bytearray(whole)
        content[at] ^= 1 << int(random.integers(8))
        file.write_bytes(content)
        film(ending)
        assert load_image(file)["rgba"].tobytes() == before
        file.write_bytes(whole)


@pytest.mark.parametrize("ending", ENDINGS)
def test_pictures_that_do_not_say_what_they_are_of(film, folder, ending):
    """Of another tool, or drawn over."""
    film(ending)
    rgba = load_image(f"a_1.{ending}")["rgba"]
    if ending == "npy":
        np.save("a_1.npy", rgba)
    elif ending == "png":
        from PIL import Image

        with Image.open("a_1.png") as image:
            plain = Image.fromarray(np.asarray(image))
        plain.save("a_1.png")
    else:
        import OpenEXR

        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGBA": rgba}).write("a_1.exr")
    assert film(ending) == [1]


def test_a_picture_that_was_painted_over_keeps_its_texts(film, folder):
    from PIL import Image, PngImagePlugin

    film("png")
    with Image.open("a_1.png") as image:
        texts, pixels = image.text, np.array(image)
    pixels[0, 0, 0] ^= 1
    chunks = PngImagePlugin.PngInfo()
    for name, text in texts.items():
        chunks.add_itxt(name, text)
    Image.fromarray(pixels).save("a_1.png", pnginfo=chunks)
    assert film("png") == [1]


@pytest.mark.parametrize("ending", ENDINGS)
def test_further_fields_and_environments_count(film, folder, ending):
    import OpenEXR

    def sky(value: float) -> None:
        texels = np.full((4, 8, 3), value, np.float32)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": texels}).write("sky.exr")

    np.save("mask.npy", np.ones((3, 3, 3), np.uint8))
    sky(1.0)
    text = (folder / "film.toml").read_text()
    more = '[environment]\nfile = "sky.exr"\n[[field]]\nfile = "mask.npy"\nrole = "mask"\n'
    (folder / "more.toml").write_text(text + more)
    assert film(ending, scene="more.toml") == [0, 1, 2, 3]
    assert film(ending, scene="more.toml") == []
    np.save("mask.npy", np.zeros((3, 3, 3), np.uint8))
    assert film(ending, scene="more.toml") == [0, 1, 2, 3]
    sky(2.0)
    assert film(ending, scene="more.toml") == [0, 1, 2, 3]
    assert film(ending, scene="more.toml") == []


@pytest.mark.parametrize("method", ["multiresolution", "raycast"])
def test_stores_count(film, folder, run, method):
    """Voxels that change places within a block change none of its statistics."""
    voxels = np.random.default_rng(1).integers(0, 99, (16, 16, 16)).astype(np.uint8)
    text = (folder / "film.toml").read_text().replace("cube.npy", "v.zarr")
    (folder / "stored.toml").write_text(text + f'[integration]\nmethod = "{method}"\n')

    def stored(voxels: np.ndarray) -> None:
        np.save("v.npy", voxels)
        words = ["--codec", "none", "--overwrite"]
        assert run("store", "v.npy", "-o", "v.zarr", *words).status == 0

    stored(voxels)
    assert film("npy", scene="stored.toml") == [0, 1, 2, 3]
    assert film("npy", scene="stored.toml") == []
    other = voxels.copy()
    other[0, 0, 0], other[0, 0, 1] = voxels[0, 0, 1], voxels[0, 0, 0]
    assert (other != voxels).any()
    stored(other)
    assert film("npy", scene="stored.toml") == [0, 1, 2, 3]
    stored(other)
    assert film("npy", scene="stored.toml") == []


def test_a_large_store_is_not_read_whole(tmp_path, monkeypatch):
    from clvol.volume import digest

    (tmp_path / "0").mkdir()
    (tmp_path / "zarr.json").write_text("{}")
    (tmp_path / "0" / "samples").write_bytes(bytes(100))
    monkeypatch.setattr(digest, "LARGEST_WHOLE", 10)
    before = digest.folder_digest(tmp_path)
    assert digest.folder_digest(tmp_path) == before
    (tmp_path / "0" / "samples").write_bytes(bytes(101))
    assert digest.folder_digest(tmp_path) != before


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_picture_says_what_it_is_of(run, folder, device, ending):
    """Single pictures, by the real renderer, and another camera is another picture."""
    from clvol.opencl.devices import report_of

    name = report_of(device).name
    told = []
    for more in ([], ["--set", "camera.fov_degrees=20.0"]):
        words = ["render", "scene.toml", "-o", f"x.{ending}", "--device", name, *more]
        assert run(*words).status == 0
        told.append(load_image(f"x.{ending}")["made_from"])
        assert "version = 1" in {
            key.lower(): value for key, value in load_image(f"x.{ending}")["header"].items()
        }["scene"]
    first, second = told
    assert set(first) >= {"clvol", "scene", "voxels", "camera", "time", "look", "pixels"}
    assert first["voxels"] == second["voxels"] and first["camera"] != second["camera"]


def test_frames_from_python_say_what_they_show(folder, device):
    """Another camera, time or transfer function than the scene's own; and a frame that outlives its
    renderer does not keep the volume alive."""
    import gc
    import weakref

    import clvol
    from clvol.transfer import TransferFunction

    volume = clvol.Volume(np.arange(64, dtype=np.uint8).reshape(4, 4, 4))
    scene = clvol.Scene(volume=volume, image={"width": 8, "height": 6})
    with clvol.Renderer(scene, devices=[device]) as renderer:
        camera = renderer.resolved.camera.model_copy(update={"fov_degrees": 20.0})
        frames = [renderer.render(), renderer.render(camera=camera), renderer.render(time=1.0)]
        white = TransferFunction([0, 63], [0, 0.5], [[1, 1, 1]] * 2, 1.0)
        renderer.set_transfer_function(white)
        frames += [renderer.render(), renderer.render()]
    told = [frame.made_from() for frame in frames]
    assert told[3] == told[4]
    for i in range(4):
        assert told[i] not in told[:i]
    held = weakref.ref(volume)
    del volume, scene, renderer
    gc.collect()
    assert held() is None
    frames[0].save("x.npy")
    assert load_image("x.npy")["made_from"]["voxels"]


@pytest.mark.parametrize("ending", ["gif", "webp", "apng"])
def test_videos_say_what_they_are_of(run, folder, film, ending):
    from PIL import Image

    run("render", "film.toml", "-o", f"v.{ending}")
    with Image.open(f"v.{ending}") as video:
        texts = [video.info.get(key) for key in ("comment", "xmp", "made_from")]
    told = next(text for text in texts if text is not None)
    told = json.loads(told if isinstance(told, str) else told.decode())
    assert set(told) >= {"clvol", "scene", "voxels", "camera"} and told["frames"] == COUNT


@pytest.mark.parametrize(
    "text, expected",
    [("1:3", [1, 2]), ("2:", [2, 3]), (":1", [0]), ("3", [3]), (":", [0, 1, 2, 3]), ("0:4", [0, 1, 2, 3])]
)
def test_a_part_of_the_frames(film, folder, text, expected):
    assert film("npy", "--frames", text) == expected
    assert sorted(folder.glob("a_*.npy")) == [folder / f"a_{k}.npy" for k in expected]
    assert film("npy") == [k for k in range(COUNT) if k not in expected]


def test_frames_of_a_part_are_those_of_the_whole(film, folder):
    film("npy", "--frames", "2:")
    part = np.load("a_2.npy")
    os.remove("a_2.npy")
    film("npy")
    np.testing.assert_array_equal(np.load("a_2.npy"), part)


@pytest.mark.parametrize("text", ["4", "2:2", "3:1", ":5", "-1:", "a:b", "1:2:1", "", " 1", "1.0", "٣"])
def test_frames_that_do_not_exist(run, film, folder, text):
    film("npy")
    outcome = run("render", "film.toml", "-o", "b_%d.npy", "--frames", text)
    assert outcome.status == 2 and outcome.err.startswith("clvol: error: --frames: got ")
    assert not list(folder.glob("b_*"))


def test_frames_of_a_single_picture(run, folder):
    outcome = run("render", "cube.npy", "-o", "x.npy", "--frames", "0")
    assert outcome.status == 2 and "--frames: given for a single picture" in outcome.err


def test_a_video_of_a_part(run, film, folder, renderer):
    film("npy")
    renderer.rendered.clear()
    outcome = run("render", "film.toml", "-o", "part.gif", "--frames", "1:3")
    assert outcome.status == 0 and len(renderer.rendered) == 2


def test_frames_that_others_render_are_left_to_them(run, film, folder, renderer):
    """And waited for, since the command ends when all of them are there."""
    film("npy")
    for number in (1, 2):
        os.rename(f"a_{number}.npy", f"kept_{number}.npy")
    with Claims() as others:
        for number in (1, 2):
            assert others.claim(f"a_{number}.npy")

        def make() -> None:
            for number in (1, 2):
                os.rename(f"kept_{number}.npy", f"a_{number}.npy")
                others.release(f"a_{number}.npy")

        timer = threading.Timer(0.7, make)
        timer.start()
        renderer.rendered.clear()
        outcome = run("render", "film.toml", "-o", "a_%d.npy", "--resume")
        timer.join()
    assert outcome.status == 0 and not renderer.rendered
    assert "2 of 4 frames existed already" in outcome.err
    assert "2 of 4 frames were made by other processes" in outcome.err
    assert not list(folder.glob(".*.claim"))


def test_frames_that_another_process_gave_up_are_rendered(film, folder):
    with Claims() as others:
        assert others.claim("a_1.npy")
        timer = threading.Timer(0.7, others.release, ["a_1.npy"])
        timer.start()
        assert film("npy") == [0, 2, 3, 1]  # the others first
        timer.join()


@pytest.mark.slow  # three processes that start, each of which compiles a little
def test_processes_in_one_folder_render_each_frame_once(film, folder):
    film("npy", "--frames", "0")  # so that kernels are compiled
    os.remove("a_0.npy")
    command = [
        sys.executable, "-m", "clvol", "render", "film.toml", "-o", "a_%02d.npy", "--resume", "--stats", "{}",
        "--set", "animation.frames=12",
    ]  # fmt: skip
    made = [[part.format(f"stats{k}.json") for part in command] for k in range(3)]
    processes = [subprocess.Popen(each, stderr=subprocess.PIPE, stdout=subprocess.PIPE) for each in made]
    for process in processes:
        _, told = process.communicate(timeout=300)
        assert process.returncode == 0, told
    stats = [json.loads((folder / f"stats{k}.json").read_text()) for k in range(3)]
    assert sum(each["frames"] for each in stats) == 12
    assert all(each["frames_kept"] + each["frames"] == 12 for each in stats)
    assert len(list(folder.glob("a_*.npy"))) == 12 and not list(folder.glob(".*"))
