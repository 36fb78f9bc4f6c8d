"""Devices in processes of their own make the same picture."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.effect_tables import EFFECTS, Place, by_name, with_tables
from helpers.isolation import KINDS, assert_same, is_gone, scene, states, workers
from helpers.meshes import box_mesh, write_obj
from helpers.small_scenes import SMOOTH, waves
from PIL import Image

from clvol import Camera, Renderer, Scene, TransferFunction, Volume
from clvol.cli import main
from clvol.integrators.registry import integrator_of
from clvol.opencl.devices import device_name
from clvol.render.isolation.scene_message import decoded, encoded
from clvol.render.isolation.shared_volumes import _mapped_file
from clvol.render.scene_key import scene_key, value_key


@pytest.mark.parametrize("kind", KINDS)
def test_one_device_in_a_process_makes_the_same_picture(device, isolated, kind):
    made = scene(kind)
    with Renderer(made, devices=[device]) as here:
        expected = here.render()
    renderer = isolated(made, [device])
    for _ in range(2):
        frame = renderer.render()
        assert_same(frame, expected)
        assert frame.stats["devices"] == expected.stats["devices"] and "schedule" not in frame.stats
    (worker,) = workers(renderer)
    renderer.close()
    assert is_gone(worker.pid)


@pytest.mark.parametrize("kind", KINDS)
def test_two_processes_share_a_picture(device, isolated, halves, kind):
    made = scene(kind)
    with Renderer(made, devices=[device]) as here:
        expected = here.render()
    renderer = isolated(made, halves)
    for _ in range(2):
        frame = renderer.render()
        assert_same(frame, expected)
        assert frame.stats["devices"] == halves and len(states(frame)) == 2
    kept = frame.rgba.copy()
    renderer.render(camera=Camera(position=(60.0, 20.0, 30.0)))
    np.testing.assert_array_equal(frame.rgba, kept)  # frames do not share memory with later ones


def test_other_cameras_functions_and_times(device, isolated, halves):
    made = scene(noise=[{"target": "value", "amplitude": 40.0, "velocity": [1.0, 0.0, 0.0]}])
    other = TransferFunction([0, 100, 255], [0, 0.8, 0], [[0, 1, 0]] * 3, opacity_unit=10.0)
    renderer = isolated(made, halves)
    with Renderer(made, devices=[device]) as here:
        for function in (SMOOTH, other):
            for each in (renderer, here):
                each.set_transfer_function(function)
            for camera in (None, Camera(projection="orthographic")):
                for seconds in (0.0, 0.5):
                    expected = here.render(camera=camera, time=seconds)
                    assert_same(renderer.render(camera=camera, time=seconds), expected)


def test_this_process_loads_no_driver(device, tmp_path):
    """Not even while it renders, and not for the stats."""
    code = f"""
import numpy as np, clvol
volume = clvol.Volume(np.arange(64, dtype=np.uint8).reshape(4, 4, 4))
scene = clvol.Scene(volume=volume, image={{"width": 8, "height": 8}})
with clvol.Renderer(scene, devices=[{device_name(device)!r}], isolate=True) as renderer:
    frame = renderer.render()
    print(frame.rgba.any())
    loaded = open("/proc/self/maps").read()
    print([name for name in ("libOpenCL", "libpocl", "libintelocl", "libnvidia-opencl") if name in loaded])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert done.stdout.split() == ["True", "[]"], done


# ---- volumes


def test_a_mapped_file_is_mapped_there_too(device, isolated, tmp_path):
    voxels = waves((19, 17, 23))
    np.save(tmp_path / "v.npy", voxels)
    made = scene(volume=str(tmp_path / "v.npy"))
    with Renderer(scene(), devices=[device]) as here:
        expected = here.render()
    renderer = isolated(made, [device])
    assert_same(renderer.render(), expected)
    assert "v.npy" in Path(f"/proc/{workers(renderer)[0].pid}/maps").read_text()
    os.replace(tmp_path / "v.npy", tmp_path / "old.npy")  # as programs that write files anew do
    np.save(tmp_path / "v.npy", 255 - voxels)
    volume = renderer.resolved.volume
    assert _mapped_file(volume.data) is None  # another file has its name: voxels are copied


@pytest.mark.parametrize("method", ["raycast", "multiresolution"])
@pytest.mark.parametrize("codec", ["zstd", "rvq"])
def test_stores_are_opened_there(device, isolated, tmp_path, method, codec):
    np.save(tmp_path / "v.npy", waves((19, 17, 23)))
    words = [] if codec == "zstd" else ["--codec", codec]
    assert main(["store", str(tmp_path / "v.npy"), "-o", str(tmp_path / "s"), *words]) == 0
    made = scene(volume=str(tmp_path / "s"), integration={"method": method})
    with Renderer(made, devices=[device]) as here:
        expected = here.render()
    assert_same(isolated(made, [device]).render(), expected)


def _told(place):
    """(name, tables) of every effect, and of what has objects or files of its own in resolved tables."""
    for effect in EFFECTS:
        tables, names = {}, [effect.name]
        while (over := by_name(names[0]).over) is not None:
            names.insert(0, over)
        for name in names:
            tables = with_tables(tables, by_name(name).tables(place))
        yield effect.name, tables
    box = write_obj(place.folder / "box.obj", *box_mesh([4.0, 5.0, 3.0], [14.0, 11.0, 12.0]))
    Image.new("RGB", (4, 3), "red").save(place.folder / "slide.png")
    aimed = {"position": [-9.0, 0.0, 0.0], "direction": [1.0, 1.0, 1.0]}
    slide = {"type": "image", "file": str(place.folder / "slide.png"), **aimed}
    yield "clip mesh", {"clip": [{"type": "mesh", "file": box}]}
    yield "index of refraction", {"refraction": {"points": [{"value": v, "index": 1.0 + v} for v in (0.0, 1.0)]}}
    yield "aimed lights", {"light": [{"type": "spot", **aimed}, slide]}
    yield "table", {"integration": {"filter": "table", "filter_table": [1.0, 0.7, 0.2, 0.0]}}
    yield "attenuation noise", {"noise": [{"target": "attenuation", "amplitude": 0.5}]}


def test_a_scene_in_a_message_is_the_same_scene(tmp_path):
    volume = Volume(waves((19, 17, 23)), spacing=(1.0, 0.7, 1.3), slope=2.0, offset=-3.0)
    for told, tables in _told(Place(volume, tmp_path)):
        tables = with_tables({"volume": volume, "image": {"width": 9, "height": 7}}, tables)
        resolved = Scene(**tables).resolve()
        volumes: list[Volume] = []

        def number(each, volumes=volumes):
            volumes.append(each)
            return len(volumes) - 1

        message = json.loads(json.dumps(encoded(resolved, number)))
        back = decoded(message, dict(enumerate(volumes)))
        integrator = integrator_of(resolved)
        assert scene_key(back, integrator) == scene_key(resolved, integrator), told
        for name in ("camera", "image", "integration", "multiresolution", "pyramid", "animation"):
            assert value_key(getattr(back, name)) == value_key(getattr(resolved, name)), (told, name)
        assert back.source == resolved.source
    with pytest.raises(TypeError, match="no part of a scene|not part of a scene"):
        encoded(object())
