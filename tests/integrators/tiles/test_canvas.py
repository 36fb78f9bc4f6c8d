"""Pictures made of tiles whose rays several devices share: the picture of one, bit for bit, whatever fails."""

from __future__ import annotations

import threading
from functools import partial

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, make_scene, waves
from reference.tile_raycaster import TileRaycaster

from clvol import Renderer, Scene, Volume
from clvol.errors import DeviceError, RenderError
from clvol.integrators.raycast import caster
from clvol.integrators.tiles import canvas as canvas_module
from clvol.integrators.tiles.canvas import SharedCanvas
from clvol.integrators.tiles.tiled import TiledRenderer
from clvol.opencl.context import DeviceContext
from clvol.render import renderer as renderer_module
from clvol.scene.multiresolution import Multiresolution
from clvol.schedule.crew import Team

SETTINGS = Multiresolution(tiles=8, tile_high=0.25)
SIZE = 150, 110


@pytest.fixture(scope="module")
def engines(device):
    """The same scene on two contexts of one device: the second one has no memory in common with the host."""
    made = []
    for copies in (False, True):
        context = DeviceContext(device)
        engine = TileRaycaster(context, make_scene(waves((30, 28, 34)), SMOOTH, classification="post"), lanes=16)
        context.is_cpu = context.is_cpu and not copies
        made.append(engine)
    return made


@pytest.fixture(scope="module")
def alone(engines):
    """``alone(rays)``: the picture of one device."""
    renderer, camera, made = TiledRenderer(engines[0], SETTINGS), engines[0].resolved.camera, {}

    def render(rays: int | None):
        if rays not in made:
            made[rays] = renderer.render(camera, *SIZE, rays=rays)
        return made[rays]

    return render


class Shared:
    """Renders with both engines. ``lost``: the devices that have failed."""

    def __init__(self, engines, ready=lambda device: None) -> None:
        self.team, self.lost = Team(["first", "second"], 1e8, 1e-4), []
        self._canvas = partial(SharedCanvas, engines, self.team, ready, lambda device, error: self.lost.append(device))
        self._engine = engines[0]

    def render(self, rays: int | None):
        try:
            renderer = TiledRenderer(self._engine, SETTINGS, canvas=self._canvas)
            return renderer.render(self._engine.resolved.camera, *SIZE, rays=rays)
        finally:
            self.team.close()


def assert_same(frame, other) -> None:
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    np.testing.assert_array_equal(frame.depth, other.depth)
    assert (frame.samples, frame.rays, frame.counters) == (other.samples, other.rays, other.counters)
    assert frame.estimated_rmse == other.estimated_rmse


@pytest.mark.parametrize("rays", [None, 4000, SIZE[0] * SIZE[1]])
def test_the_picture_is_that_of_one_device(engines, alone, rays):
    shared = Shared(engines)
    assert_same(shared.render(rays), alone(rays))
    assert not shared.lost


@pytest.mark.parametrize("number", [0, 1, 5])
@pytest.mark.parametrize("victim", [0, 1])
@pytest.mark.parametrize("where", ["ready", "cast", "after", "join"])
def test_a_device_that_fails_at_any_point_changes_nothing(engines, alone, monkeypatch, where, victim, number):
    """``after``: its rays are cast, but their pixels do not arrive."""
    if number and where == "ready":
        pytest.skip("a device becomes ready once")
    counted = []
    turn = threading.Event()  # the other one waits until it has failed, or else it might do everything

    def fail(device: int) -> None:
        if device == victim:
            counted.append(device)
            if len(counted) > number:
                turn.set()
                raise RenderError("device", "failed")

    def watched(name: str, late: bool) -> None:
        real = getattr(canvas_module._Part, name)

        def call(part, *arguments):
            device = int(part._engine is engines[1])
            if not late:
                fail(device)
            if name == "cast" and device != victim and where != "join":
                turn.wait(0.05)
            found = real(part, *arguments)
            if late:
                fail(device)
            return found

        monkeypatch.setattr(canvas_module._Part, name, call)

    if where == "join":
        watched("join", False)
    else:
        watched("cast", where == "after") if where != "ready" else None
    shared = Shared(engines, fail if where == "ready" else lambda device: None)
    assert_same(shared.render(4000), alone(4000))
    assert shared.lost in ([], [victim])
    if number == 0 and (where, victim) != ("join", 1):  # the second one joins only if the first one has failed
        assert shared.lost == [victim]


def test_the_last_device_s_error_is_raised(engines, monkeypatch):
    def fail(part, work):
        raise DeviceError("device", "failed")

    monkeypatch.setattr(canvas_module._Part, "cast", fail)
    with pytest.raises(DeviceError, match="failed"):
        Shared(engines).render(None)


def test_progress_reaches_all_rays(engines):
    shared, told = Shared(engines), []
    renderer = TiledRenderer(engines[0], SETTINGS, canvas=shared._canvas)
    renderer.render(engines[0].resolved.camera, *SIZE, lambda done, total: told.append((done, total)))
    shared.team.close()
    assert told[-1][0] == told[-1][1] and [done for done, _ in told] == sorted(done for done, _ in told)


@pytest.fixture
def two(device, monkeypatch):
    """A Renderer of two contexts on one device, of a scene of blocks in tiles."""
    monkeypatch.setattr(caster, "lanes_of", lambda context, lanes=None: lanes or 16)
    contexts = [DeviceContext(device) for _ in range(2)]
    made = Scene(
        volume=Volume(waves((40, 36, 44))), transfer_function=SMOOTH, image={"width": 90, "height": 70},
        integration={"method": "multiresolution"}, multiresolution={"tiles": 8, "tile_high": 0.5},
    )  # fmt: skip
    with monkeypatch.context() as patch:
        patch.setattr(renderer_module, "open_contexts", lambda _: contexts)
        renderer = Renderer(made)
    with Renderer(made, devices=[device]) as one, renderer:
        yield one, renderer


def test_a_renderer_s_devices_share_pictures_in_tiles(two):
    one, both = two
    frame, expected = both.render(), one.render()
    np.testing.assert_array_equal(frame.rgba, expected.rgba)
    np.testing.assert_array_equal(frame.depth, expected.depth)
    assert [each["state"] for each in frame.stats["schedule"]["devices"]] == ["working"] * 2
    assert frame.stats["tiles"] == expected.stats["tiles"] and frame.stats["samples"] == expected.stats["samples"]


def test_pictures_for_a_given_time_are_shared(two):
    one, both = two
    frame = both.render(seconds=30.0)  # enough for every ray
    np.testing.assert_array_equal(frame.rgba, one.render(seconds=30.0).rgba)
    assert frame.stats["tiles"]["share_of_pixels"] == 1.0
    assert [each["state"] for each in frame.stats["schedule"]["devices"]] == ["working"] * 2
