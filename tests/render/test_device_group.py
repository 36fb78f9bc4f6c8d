"""A picture that devices share is that of one device, bit for bit, whatever they divide and whichever of them fails."""

from __future__ import annotations

import itertools
import threading
import time
import warnings

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, waves

from clvol import Camera, Renderer, Scene, TransferFunction, Volume
from clvol.errors import ClvolWarning, RenderError, UsageError
from clvol.integrators.raycast.picture import PictureParts
from clvol.opencl.context import DeviceContext
from clvol.render import device_group
from clvol.render import renderer as renderer_module

KINDS = {
    "plain": {},
    "orthographic": {"camera": {"projection": "orthographic"}},
    "fewer rays": {"image": {"ray_spacing": 4, "ray_tolerance": 0.02}},
    "surfaces": {"isosurface": [{"value": 120.0, "color": [1, 0.5, 0.2]}], "light": [{"type": "headlight"}]},
    "shadows": {"light": [{"type": "directional", "direction": [-1, -1, -1]}], "shadow": {"method": "rays"}},
    "noise": {"noise": [{"target": "value", "amplitude": 40.0}]},
    "projection": {"integration": {"compositing": "maximum"}},
    "pyramid": {"integration": {"method": "pyramid"}},
    "slicing": {"integration": {"method": "slicing"}, "slicing": {"geometry": "object-aligned"}},
    "reference": {"integration": {"method": "reference"}},
    "multiresolution": {"integration": {"method": "multiresolution"}},
    "codes": {"compression": {"codec": "rvq"}},
    "resident codes": {"compression": {"codec": "rvq", "decode": "resident"}},
}


def scene(kind: str = "plain", width: int = 75, height: int = 50):
    tables = dict(KINDS[kind])
    image = {**tables.pop("image", {}), "width": width, "height": height}
    return Scene(volume=Volume(waves((19, 17, 23))), transfer_function=SMOOTH, image=image, **tables)


@pytest.fixture
def shared(device, monkeypatch):
    """Renderers of several contexts on one device."""
    opened = []

    def make(made, count: int = 3) -> Renderer:
        monkeypatch.setattr(renderer_module, "open_contexts", lambda _: [DeviceContext(device) for _ in range(count)])
        opened.append(Renderer(made))
        monkeypatch.undo()
        return opened[-1]

    monkeypatch.setattr(device_group, "_LEAST_TILES", 1)
    yield make
    for each in opened:
        each.close()


def assert_same(frame, other) -> None:
    np.testing.assert_array_equal(frame.rgba, other.rgba)
    np.testing.assert_array_equal(frame.depth, other.depth)
    for key in ("samples", "rays"):
        assert frame.stats[key] == other.stats[key]
    assert frame.stats.get("counters", {}) == other.stats.get("counters", {})


@pytest.mark.parametrize("kind", KINDS)
def test_devices_make_the_picture_of_one(device, shared, kind):
    with Renderer(scene(kind), devices=[device]) as one:
        expected = one.render()
    renderer = shared(scene(kind))
    for _ in range(2):  # divided by what is expected, then by what was measured
        frame = renderer.render()
        assert_same(frame, expected)
        schedule = frame.stats["schedule"]
        assert sum(each["share"] for each in schedule["devices"]) == pytest.approx(1)
        assert 0 < schedule["efficiency"] <= 1


@pytest.mark.parametrize("size", [(1, 1), (3, 90), (16, 16), (129, 17)])
def test_pictures_of_any_size(device, shared, size):
    with Renderer(scene("plain", *size), devices=[device]) as one:
        assert_same(shared(scene("plain", *size)).render(), one.render())


def test_other_cameras_and_functions(device, shared):
    renderer = shared(scene())
    cameras = [None, Camera(position=(60.0, 20.0, 30.0)), Camera(projection="orthographic")]
    other = TransferFunction([0, 100, 255], [0, 0.8, 0], [[0, 1, 0]] * 3, opacity_unit=10.0)
    with Renderer(scene(), devices=[device]) as one:
        for camera, function in itertools.product(cameras, [SMOOTH, other]):
            for each in (renderer, one):
                each.set_transfer_function(function)
            assert_same(renderer.render(camera=camera), one.render(camera=camera))


def fail_at(monkeypatch, package: int, devices: set[int], error: type[Exception] = RenderError) -> list[int]:
    """Makes the devices (by the order of their threads) fail from their ``package``-th package on."""
    real, order, counts, failed = PictureParts.render, {}, {}, []
    lock = threading.Lock()

    def render(self, stage, tiles):
        with lock:
            number = order.setdefault(id(self._context), len(order))
            counts[number] = counts.get(number, -1) + 1
            fails = number in devices and counts[number] >= package
        if fails:
            failed.append(number)
            raise error("device", "failed (OUT_OF_RESOURCES)") if error is RenderError else error("no memory")
        return real(self, stage, tiles)

    monkeypatch.setattr(PictureParts, "render", render)
    return failed


@pytest.mark.parametrize("kind", ["plain", "fewer rays", "surfaces"])
@pytest.mark.parametrize("package", [0, 1, 2])
@pytest.mark.parametrize("error", [RenderError, MemoryError])
def test_a_device_that_fails_is_left_out(device, shared, monkeypatch, kind, package, error):
    with Renderer(scene(kind), devices=[device]) as one:
        expected = one.render()
    renderer = shared(scene(kind))
    failed = fail_at(monkeypatch, package, {1}, error)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        frames = [renderer.render() for _ in range(3)]
    for frame in frames:
        assert_same(frame, expected)
    told = [w for w in caught if issubclass(w.category, ClvolWarning)]
    assert set(failed) <= {1} and len(told) == len(set(failed))
    assert len(failed) <= (1 if error is RenderError else 5)  # less memory is tried a few times
    if failed:
        assert "left out" in str(told[0].message)
        states = [each["state"] for each in frames[-1].stats["schedule"]["devices"]]
        assert sum(state.startswith("lost") for state in states) == 1


def test_all_devices_fail(shared, monkeypatch):
    renderer = shared(scene())
    fail_at(monkeypatch, 0, {0, 1, 2})
    with pytest.raises(RenderError, match="OUT_OF_RESOURCES"):
        renderer.render()


def test_a_device_that_stalls_does_not_delay_the_frame_for_long(device, shared, monkeypatch):
    from clvol.schedule import dispatch

    with Renderer(scene(), devices=[device]) as one:
        expected = one.render()
    renderer = shared(scene(), count=2)
    renderer.render()
    monkeypatch.setattr(dispatch, "_PATIENCE", 0.05)
    real, slow = PictureParts.render, []

    def render(self, stage, tiles):
        if not slow or slow == [id(self)]:
            slow[:] = [id(self)]
            time.sleep(3.0)
        return real(self, stage, tiles)

    monkeypatch.setattr(PictureParts, "render", render)
    frame = renderer.render()
    assert_same(frame, expected)


def test_rays_of_the_reference_are_shared_and_a_device_that_fails_is_left_out(device, shared, monkeypatch):
    from clvol.integrators.reference import program

    with Renderer(scene("reference"), devices=[device]) as one:
        expected = one.render()
    renderer = shared(scene("reference"), count=2)
    frame = renderer.render()
    assert_same(frame, expected)
    for key in ("cells", "pieces", "failed_pieces", "error_estimate"):
        assert frame.stats[key] == expected.stats[key]
    assert [each["state"] for each in frame.stats["schedule"]["devices"]] == ["working"] * 2
    real, failing = program._RaysOnDevice.work, []

    def work(self, items):
        failing[:] = failing or [id(self)]
        if failing == [id(self)]:
            raise RenderError("device", "failed (OUT_OF_RESOURCES)")
        return real(self, items)

    monkeypatch.setattr(program._RaysOnDevice, "work", work)
    with pytest.warns(ClvolWarning, match="left out"):
        frame = renderer.render()
    assert_same(frame, expected)
    states = [each["state"] for each in frame.stats["schedule"]["devices"]]
    assert sum(state.startswith("lost") for state in states) == 1 and len(frame.stats["devices"]) == 1
    assert_same(renderer.render(), expected)  # by the one that is left

    def broken(self, items):
        raise RenderError("device", "failed (OUT_OF_RESOURCES)")

    renderer = shared(scene("reference"), count=2)
    monkeypatch.setattr(program._RaysOnDevice, "work", broken)
    with pytest.raises(RenderError, match="OUT_OF_RESOURCES"):
        renderer.render()


def test_progress_reaches_the_end_and_may_interrupt(shared):
    renderer = shared(scene())
    told = []
    renderer.render(progress=lambda done, total: told.append((done, total)))
    assert told == sorted(told) and told[-1][0] == told[-1][1]

    class Enough(Exception):
        pass

    def stop(done, total):
        raise Enough

    with pytest.raises(Enough):
        renderer.render(progress=stop)
    assert renderer.render().rgba.any()


def test_a_fault_of_the_program_is_no_loss_of_a_device(shared, monkeypatch):
    renderer = shared(scene())

    def broken(self, stage, tiles):
        raise TypeError("a mistake")

    monkeypatch.setattr(PictureParts, "render", broken)
    with pytest.raises(TypeError, match="a mistake"):
        renderer.render()


def test_a_device_is_requested_once(device):
    with pytest.raises(UsageError, match="twice"):
        Renderer(scene(), devices=[device, device])


def test_parts_of_a_device(device):
    from clvol.errors import DeviceError
    from clvol.opencl.devices import report_of

    name, units = report_of(device).name, int(device.max_compute_units)
    for wrong in ("0/2", "3/2", "x/2", "1/", f"1/{units + 1}"):
        with pytest.raises(DeviceError):
            Renderer(scene(), devices=[f"{name}:{wrong}"])
    if units < 2:
        pytest.skip("the device has one compute unit, which cannot be divided")
    with Renderer(scene(), devices=[device]) as one, Renderer(scene(), devices=[f"{name}:1/2", f"{name}:2/2"]) as two:
        frame = two.render()
        assert_same(frame, one.render())
        assert frame.stats["devices"] == [f"{name}:1/2", f"{name}:2/2"]
