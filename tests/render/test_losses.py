"""Devices that fail, stall or lack memory, at every point of a frame: the picture is complete and the same, and what
was lost is not counted."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable
from contextlib import contextmanager

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, waves

from clvol import Renderer, Scene, Volume
from clvol.errors import ClvolWarning, DeviceError, RenderError
from clvol.integrators.multiresolution.engine import MultiresolutionEngine
from clvol.integrators.raycast import caster
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.picture import PictureParts
from clvol.opencl.context import DeviceContext
from clvol.opencl.failures import LaunchMemoryError
from clvol.render import device_group, picture_stage
from clvol.render import renderer as renderer_module
from clvol.schedule import dispatch

KINDS = {
    "plain": {},
    "fewer rays": {"image": {"ray_spacing": 4, "ray_tolerance": 0.02}},
    "surfaces": {"isosurface": [{"value": 120.0, "color": [1, 0.5, 0.2]}], "light": [{"type": "headlight"}]},
}
ERRORS = {
    "device": RenderError("device", "failed (clFinish failed: OUT_OF_RESOURCES)"),
    "buffer": DeviceError("device", "no memory for 99 bytes"),
    "host": MemoryError(),
}
ERRORS["launch"] = LaunchMemoryError("device", "failed (MEM_OBJECT_ALLOCATION_FAILURE)")


def scene(kind: str = "plain"):
    tables = dict(KINDS[kind])
    image = {**tables.pop("image", {}), "width": 150, "height": 100}
    return Scene(volume=Volume(waves((19, 17, 23))), transfer_function=SMOOTH, image=image, **tables)


class Devices:
    """A Renderer of several contexts on one device. The second one is the one that fails."""

    def __init__(self, contexts: list[DeviceContext], monkeypatch, kind: str) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(renderer_module, "open_contexts", lambda _: contexts)
            self.renderer = Renderer(scene(kind))
        self.victim = contexts[1]
        self.calls: list[str] = []  # of the victim
        self._leads = threading.Event()
        self._patch = monkeypatch
        self._fault: Callable[[str, int], None] = lambda name, number: None
        for name in ("begin", "render", "end"):
            self._watch(PictureParts, name, "_context")
        for name in ("parts", "warm_up_parts"):
            self._watch(Raycaster, name, "context")

    def _watch(self, owner: type, name: str, attribute: str) -> None:
        real = getattr(owner, name)

        def watched(this, *arguments):
            if getattr(this, attribute) is self.victim:
                self.calls.append(name)
                if name == "render":
                    self._leads.set()
                try:
                    self._fault(name, self.calls.count(name) - 1)
                except Exception:
                    self._leads.set()
                    raise
            elif name == "render":  # the victim is given a package before the others have done everything
                self._leads.wait(2.0)
            return real(this, *arguments)

        self._patch.setattr(owner, name, watched)

    def fail(self, where: str, number: int, error: BaseException) -> None:
        """Lets the ``number``-th call of ``where`` by the victim, and all later ones of any kind, fail."""
        failed = []

        def fault(name: str, count: int) -> None:
            if failed or (name == where and count >= number):
                failed.append(name)
                raise error

        self._begin(fault)

    def _begin(self, fault: Callable[[str, int], None]) -> None:
        self.calls.clear()
        self._leads.clear()
        self._fault = fault

    def fault(self, fault: Callable[[str, int], None]) -> None:
        """Calls ``fault(name, number of the call)`` before each call of the victim."""
        self._begin(fault)

    def seem_fast(self) -> None:
        """So that a package soon counts as stalled: on a machine with other work, the first frames say little."""
        for member in self.renderer._on_device.members:
            member.speed = 1e9

    def render(self):
        """A frame and the warnings about devices."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            frame = self.renderer.render()
        for stage in {span.stage for span in self.renderer.schedule.spans}:
            counted = [s.tiles for s in self.renderer.schedule.spans if s.stage == stage and s.counts]
            assert np.array_equal(np.sort(np.concatenate(counted)), np.arange(sum(map(len, counted))))  # each tile once
        return frame, [str(w.message) for w in caught if issubclass(w.category, ClvolWarning)]


class KeptContext(DeviceContext):
    """Stays open when a Renderer closes, so that nothing is compiled for every test."""

    def release(self) -> None:
        self.queue.finish()


@pytest.fixture(scope="module")
def pool(device):
    """Two sets of three contexts: with memory in common with the host, and without."""
    sets = [[KeptContext(device) for _ in range(3)] for _ in range(2)]
    for context in sets[1]:
        context.is_cpu = False
    yield sets
    for context in (*sets[0], *sets[1]):
        DeviceContext.release(context)


@pytest.fixture
def devices(pool, monkeypatch):
    """``devices(kind, count, copies)``: ``Devices``, of which those in ``copies`` have no memory in common with the
    host."""
    opened = []
    monkeypatch.setattr(caster, "lanes_of", lambda context, lanes=None: lanes or 16)  # so that bits are the same

    def make(kind: str = "plain", count: int = 3, copies: set[int] = frozenset()) -> Devices:
        opened.append(Devices([pool[k in copies][k] for k in range(count)], monkeypatch, kind))
        return opened[-1]

    monkeypatch.setattr(device_group, "_LEAST_TILES", 1)
    yield make
    for each in opened:
        each.renderer.close()


_alone: dict = {}


@pytest.fixture
def expected(device):
    """``expected(kind)``: the picture of one device."""

    def render(kind: str):
        if (device, kind) not in _alone:
            with Renderer(scene(kind), devices=[device]) as one:
                _alone[device, kind] = one.render()
        return _alone[device, kind]

    return render


def assert_same(frame, other) -> None:
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    np.testing.assert_array_equal(frame.depth, other.depth)
    for key in ("samples", "rays"):
        assert frame.stats[key] == other.stats[key]
    assert frame.stats.get("counters", {}) == other.stats.get("counters", {})


def states(frame) -> list[str]:
    return [each["state"] for each in frame.stats["schedule"]["devices"]]


POINTS = [("warm_up_parts", 0), ("parts", 0), ("begin", 0), ("render", 0), ("render", 1), ("end", 0)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("where, number", [*POINTS, ("begin", 1), ("end", 1)])
@pytest.mark.parametrize("copies", [set(), {1}, {0, 1, 2}], ids=["in place", "copies", "all copy"])
def test_a_device_that_fails_at_any_point_costs_nothing_but_time(devices, expected, kind, where, number, copies):
    if number == 1 and where in ("begin", "end") and kind != "fewer rays":
        pytest.skip("the picture has one stage")
    all_of_them = devices(kind, copies=copies)
    if where == "warm_up_parts":
        all_of_them.fail(where, number, ERRORS["device"])
    else:
        all_of_them.render()  # so that the second frame divides as measured
        all_of_them.fail(where, number, ERRORS["device"])
    frame, told = all_of_them.render()
    assert_same(frame, expected(kind))
    failed = where in all_of_them.calls and all_of_them.calls.count(where) > number
    assert failed or number == 1  # it may get one package only, and none in the first stage
    if failed:
        assert len(told) == 1 and "left out" in told[0]
        assert states(frame)[1].startswith("lost: device: failed") and len(frame.stats["devices"]) == 2
        spans = [s for s in all_of_them.renderer.schedule.spans if s.device == 1 and s.counts]
        if 1 in copies:  # what was not fetched is lost
            assert all(span.stage < all_of_them.calls.count("begin") - 1 for span in spans)
        elif where == "end":
            assert spans
    all_of_them.calls.clear()
    frame, told = all_of_them.render()
    assert_same(frame, expected(kind))
    if failed:  # a context that has failed does not recover: it stays out, and nothing is told again
        assert not told and not all_of_them.calls and states(frame)[1].startswith("lost")


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("where", ["begin", "render", "end"])
def test_whatever_the_error_is(devices, expected, where, error):
    all_of_them = devices(copies={1})
    all_of_them.fail(where, 0, ERRORS[error])
    frame, told = all_of_them.render()
    assert_same(frame, expected("plain"))
    assert len(told) == 1 and states(frame)[1].startswith("lost")


@pytest.mark.parametrize("error", ["launch", "host"])
def test_a_device_that_lacks_memory_renders_smaller_packages(devices, expected, error):
    """Once, twice or three times: the device stays, and later packages are small at once."""
    all_of_them = devices()
    sizes: list[int] = []
    real = PictureParts.render

    def render(this, stage, tiles):
        if this._context is all_of_them.victim:
            sizes.append(len(tiles))
            if len(tiles) > 3:
                raise ERRORS[error]
        return real(this, stage, tiles)

    all_of_them._patch.setattr(PictureParts, "render", render)
    for _ in range(2):
        frame, told = all_of_them.render()
        assert_same(frame, expected("plain"))
        assert not told and states(frame) == ["working"] * 3
    too_large = [n for n in sizes if n > 3]
    assert len(too_large) < len(sizes) and len(too_large) <= 4


@pytest.mark.parametrize("count", [2, 3])
def test_all_devices_fail(devices, monkeypatch, count):
    all_of_them = devices(count=count)

    def broken(self, stage, tiles):
        raise ERRORS["device"]

    monkeypatch.setattr(PictureParts, "render", broken)
    with pytest.raises(RenderError, match=f"all {count} have failed") as caught:
        all_of_them.renderer.render()
    assert caught.value.exit_status == 4 and "\n" not in str(caught.value)


@contextmanager
def impatience(monkeypatch):
    """Stalls are soon taken for what they are. Only while one is meant to happen: on a machine with other work, those
    that compile or are not scheduled for a moment would count as stalled, too."""
    with monkeypatch.context() as patch:
        patch.setattr(dispatch, "_PATIENCE", 0.2)
        patch.setattr(picture_stage, "_FETCH_PATIENCE", 0.2)
        yield


@pytest.mark.parametrize("where", ["render", "end"])
def test_a_device_that_stalls_costs_its_package(devices, expected, monkeypatch, where):
    """The frame does not wait for it; it takes part again once it has returned."""
    all_of_them = devices(copies={1})
    all_of_them.render()
    all_of_them.seem_fast()
    goes_on = threading.Event()
    all_of_them.fault(lambda name, number: goes_on.wait(30.0) if (name, number) == (where, 0) else None)
    start = time.perf_counter()
    with impatience(monkeypatch):
        frame, told = all_of_them.render()
    assert time.perf_counter() - start < 10.0
    assert_same(frame, expected("plain"))
    assert not told and states(frame)[1].startswith("stalled")
    before = frame.rgba.copy()
    frame, _ = all_of_them.render()  # without it
    assert_same(frame, expected("plain"))
    assert states(frame)[1] == "busy"
    goes_on.set()
    member = all_of_them.renderer._on_device.members[1]
    member.busy.result(5.0)
    np.testing.assert_array_equal(frame.rgba, before)  # what came late has changed no picture
    all_of_them.calls.clear()
    frame, _ = all_of_them.render()
    assert_same(frame, expected("plain"))
    assert states(frame) == ["working"] * 3 and "render" in all_of_them.calls


def test_a_device_that_missed_a_new_scene_renders_it_when_it_returns(device, devices, monkeypatch):
    from clvol import TransferFunction

    other = TransferFunction([0, 100, 255], [0, 0.8, 0], [[0, 1, 0]] * 3, opacity_unit=10.0)
    all_of_them = devices()
    all_of_them.render()
    all_of_them.seem_fast()
    goes_on = threading.Event()
    all_of_them.fault(lambda name, number: goes_on.wait(30.0) if (name, number) == ("render", 0) else None)
    with impatience(monkeypatch):
        all_of_them.render()
    all_of_them.renderer.set_transfer_function(other)
    goes_on.set()
    all_of_them.renderer._on_device.members[1].busy.result(5.0)
    all_of_them.calls.clear()
    frame, _ = all_of_them.render()
    with Renderer(scene(), devices=[device]) as one:
        one.set_transfer_function(other)
        assert_same(frame, one.render())
    assert "render" in all_of_them.calls


def test_a_lost_device_does_not_fail_twice_when_the_renderer_closes(devices):
    all_of_them = devices()
    all_of_them.fail("render", 0, ERRORS["device"])
    all_of_them.render()
    all_of_them.renderer.close()


def test_pictures_that_one_device_makes_go_to_the_next_one(device, monkeypatch):
    made = Scene(
        volume=Volume(waves((9, 7, 11))), transfer_function=SMOOTH, image={"width": 20, "height": 10},
        integration={"method": "multiresolution"}, multiresolution={"tiles": 8},
    )  # fmt: skip
    with Renderer(made, devices=[device]) as one:
        alone = one.render()
    contexts = [DeviceContext(device) for _ in range(2)]
    with monkeypatch.context() as patch:
        patch.setattr(renderer_module, "open_contexts", lambda _: contexts)
        two = Renderer(made)

    def broken(*arguments, **named):
        raise ERRORS["buffer"]

    monkeypatch.setattr(MultiresolutionEngine, "render_on", lambda *arguments: None)  # as if nothing could be shared
    with two:
        two.render()
        two._on_device.group.alive[0].prepared.render = broken
        with pytest.warns(ClvolWarning, match="left out"):
            frame = two.render()
    np.testing.assert_array_equal(frame.rgba, alone.rgba)
    assert sum(state.startswith("lost") for state in states(frame)) == 1


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("copies", [set(), {1}, {0, 1, 2}], ids=["in place", "copies", "all copy"])
def test_without_losses(devices, expected, kind, copies):
    all_of_them = devices(kind, copies=copies)
    for _ in range(3):
        frame, told = all_of_them.render()
        assert_same(frame, expected(kind))
        assert not told and states(frame) == ["working"] * 3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("copies", [{1}, {0, 1, 2}], ids=["one", "all"])
def test_devices_that_cast_one_ray_per_work_item_share_the_same_tiles(devices, expected, monkeypatch, kind, copies):
    """As GPUs do, alone and beside others; compilers round otherwise than for sixteen rays."""
    monkeypatch.setattr(caster, "lanes_of", lambda context, lanes=None: lanes or (16 if context.is_cpu else 1))
    all_of_them, one = devices(kind, copies=copies), expected(kind)
    for _ in range(2):
        frame, _ = all_of_them.render()
        np.testing.assert_allclose(frame.rgba, one.rgba, rtol=0, atol=2e-6)
        assert abs(frame.stats["samples"] - one.stats["samples"]) <= 1e-3 * one.stats["samples"]
        if kind != "fewer rays":
            assert frame.stats["rays"] == one.stats["rays"] == 150 * 100
