"""The command run in this process, with a scene and a renderer that needs no device."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from clvol.cli import main

# The preset "grayscale" of the cube, as points, so that tests may override them.
RAMP = """[transfer_function]
opacity_unit = 0.09375
points = [
  { value = 0.0, opacity = 0.0, color = [0.25, 0.25, 0.25] }, { value = 63.0, opacity = 0.5, color = [1.0, 1.0, 1.0] },
]
"""


@dataclass
class Outcome:
    status: int
    out: str
    err: str


@pytest.fixture
def run(capfd, monkeypatch):
    """``run("render", ...)`` -> Outcome, as the shell would see it."""
    monkeypatch.delenv("CLVOL_DEBUG", raising=False)

    def call(*arguments: object) -> Outcome:
        capfd.readouterr()
        status = main([str(argument) for argument in arguments])
        told = capfd.readouterr()
        return Outcome(status, told.out, told.err)

    return call


@pytest.fixture
def refused(run):
    """``refused(status, ...)``: the command's only line, an error that ends with ``status``."""

    def call(status: int, *arguments: object) -> str:
        outcome = run(*arguments)
        assert outcome.status == status, outcome
        assert outcome.out == ""
        assert outcome.err.startswith("clvol: error: ")
        assert outcome.err.count("\n") == 1 and outcome.err.endswith("\n")
        return outcome.err.removeprefix("clvol: error: ").rstrip("\n")

    return call


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    """An empty working folder with a scene, beside which nothing may be left by a failure."""
    np.save(tmp_path / "cube.npy", np.arange(64, dtype=np.uint8).reshape(4, 4, 4))
    text = 'version = 1\n[volume]\nfile = "cube.npy"\n[image]\nwidth = 8\nheight = 6\n' + RAMP
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def nothing_left(folder: Path):
    """Checks after the test that the folder holds just what it did before."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    yield
    after = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert after == before


@dataclass
class StubFrame:
    rgba: np.ndarray
    depth: np.ndarray
    background: np.ndarray
    scene_source: str
    stats: dict = field(default_factory=dict)


class StubRenderer:
    """The interface of clvol.render.Renderer; ``failure`` is raised in place of a frame, or of the
    one at ``fails_at`` seconds. A frame at ``time`` is brighter by ``time`` / 4."""

    failure: BaseException | None = None
    fails_at: float | None = None
    calls: list[tuple] = []
    rendered: list[tuple] = []
    schedule = None

    def __init__(self, scene, devices=None, memory_cap=None, progress=None, isolate=False):
        self.resolved = scene.resolve()
        self.devices = devices
        type(self).calls.append((self.resolved, devices))

    def __enter__(self):
        return self

    def __exit__(self, *stop):
        return None

    def render(self, camera=None, progress=None, depth=True, time=None, seconds=None):
        if self.failure is not None and self.fails_at in (None, time):
            raise self.failure
        type(self).rendered.append((time, camera))
        size = self.resolved.image.height, self.resolved.image.width
        rgba = np.full((*size, 4), 0.25 + (time or 0.0) / 4, dtype=np.float32)
        depth = np.full(size, 2.0, dtype=np.float32)
        times = {"prepare": 0.1, "compile": 0.0, "render": np.float32(0.5)}
        stats = {"seconds": times, "samples": np.int64(7), "rays": 48, "devices": ["stub"],
                 "effects": [], "method": "raycast", "worst": float("inf")}
        return StubFrame(rgba, depth, self.resolved.background, self.resolved.source, stats)


@pytest.fixture
def renderer(monkeypatch) -> type[StubRenderer]:
    """The stub in the place of the renderer."""
    import clvol.render

    module = ModuleType("clvol.render")
    module.Renderer = StubRenderer
    module.__path__ = clvol.render.__path__
    monkeypatch.setitem(sys.modules, "clvol.render", module)
    monkeypatch.setattr(StubRenderer, "failure", None)
    monkeypatch.setattr(StubRenderer, "fails_at", None)
    monkeypatch.setattr(StubRenderer, "calls", [])
    monkeypatch.setattr(StubRenderer, "rendered", [])
    return StubRenderer
