"""What another picture costs beside its frame, counted: programs, launches, decisions, flushes, imported modules."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
from helpers.small_scenes import make_scene, waves

from clvol import Renderer, TransferFunction, Volume
from clvol.image import atomic_paths, save_picture
from clvol.integrators.raycast import step_map
from clvol.opencl import build
from clvol.opencl.context import Kernel

VOLUME = Volume(waves((21, 34, 27), np.uint8, high=255.0))
FUNCTIONS = [TransferFunction([0, 100, 255], [0, 0.2, share], [[1, 1, 1]] * 3, 10.0) for share in (0.9, 0.8, 0.7)]


def scene_of(function: TransferFunction):
    return make_scene(VOLUME, function, classification="preintegrated")


def test_another_transfer_function_compiles_nothing_and_launches_its_frame_alone(device, monkeypatch):
    launched: list[str] = []
    call = Kernel.__call__
    monkeypatch.setattr(Kernel, "__call__", lambda self, *a, **k: launched.append(self.name) or call(self, *a, **k))
    built = []
    of_file = build.build_file
    monkeypatch.setattr("clvol.opencl.context.build_file", lambda *a: built.append(a[1]) or of_file(*a))
    with Renderer(scene_of(FUNCTIONS[0]), devices=[device]) as renderer:
        renderer.render(depth=False)
        assert launched.count("struct_fields") == 1 and built
        for function in FUNCTIONS[1:]:
            launched.clear(), built.clear()
            renderer.set_scene(scene_of(function))
            frame = renderer.render(depth=False)
            assert launched.count("raycast") == 1 and "struct_fields" not in launched and not built
    with Renderer(scene_of(FUNCTIONS[-1]), devices=[device]) as renderer:
        assert renderer.render(depth=False).rgba.tobytes() == frame.rgba.tobytes()


def test_whether_steps_follow_the_data_is_decided_once_per_function(monkeypatch):
    decided = []
    most_steps = step_map.most_steps
    monkeypatch.setattr(step_map, "most_steps", lambda *a, **k: decided.append(1) or most_steps(*a, **k))
    volume = Volume(waves((21, 34, 27), np.uint8, high=250.0))
    for function in FUNCTIONS[:2]:
        for camera in ("front", "left"):
            step_map.is_smooth(make_scene(volume, function, camera={"view": camera}, classification="preintegrated"))
    assert len(decided) == 2


def test_a_picture_is_flushed_once(tmp_path, device, monkeypatch):
    with Renderer(scene_of(FUNCTIONS[0]), devices=[device]) as renderer:
        frame = renderer.render(depth=False)
    flushed = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: flushed.append(os.fstat(descriptor).st_ino))
    paths = [str(tmp_path / "a.png"), str(tmp_path / "b.npy")]
    with atomic_paths(paths) as temporaries:
        for path, temporary in zip(paths, temporaries):
            save_picture(frame, temporary, path)
    assert sorted(flushed) == sorted(os.stat(path).st_ino for path in [*paths, tmp_path])


def test_a_plain_picture_imports_no_more_than_it_needs(tmp_path, device):
    """What makes a small render quick, on machines of any speed."""
    unneeded = {
        "PIL", "skimage", "OpenEXR", "tifffile", "rich", "clvol.encoding.trainer", "clvol.render.isolation.member",
        "clvol.choice.first_picture", "clvol.volume.procedural", "clvol.batch.run", "clvol.cluster", "clvol.accuracy",
        "clvol.integrators.pyramid", "clvol.integrators.multiresolution.integrator", "clvol.store.build",
    }  # fmt: skip
    scene = tmp_path / "scene.toml"
    (tmp_path / "v.raw").write_bytes(VOLUME.data.tobytes())
    scene.write_text(
        'version = 1\n[volume]\nfile = "v.raw"\ndims = [27, 34, 21]\ndtype = "uint8"\n[image]\nwidth = 24\n'
        "height = 16\n[transfer_function]\npoints = [{ value = 0.0, opacity = 0.0, color = [0.0, 0.0, 0.0] }, "
        "{ value = 255.0, opacity = 0.5, color = [1.0, 1.0, 1.0] }]\n"
        "[integration]\nclassification = 'preintegrated'\n"
    )
    words = ["render", str(scene), "-o", str(tmp_path / "a.png")]
    code = (
        f"import sys; from clvol.cli import main; status = main({words}); "
        f"sys.exit(status or ', '.join(sorted({unneeded} & set(sys.modules))) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "a.png").stat().st_size > 100
