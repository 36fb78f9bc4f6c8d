"""Pictures that devices share, whose rays start where those of the shared picture before first contributed: bit for bit
those of one device from the hull, whichever device has rendered what."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from clvol import Camera, Renderer, Scene, TransferFunction, Volume
from clvol.errors import ClvolWarning, RenderError
from clvol.integrators.raycast import coherent_parts, history
from clvol.integrators.raycast.picture import PictureParts
from clvol.opencl.context import DeviceContext
from clvol.render import device_group
from clvol.render import renderer as renderer_module
from clvol.schedule.animation import orbited

SOLID = TransferFunction([0, 100, 140, 255], [0, 0, 0.6, 1.0], [[0.9, 0.5, 0.2], [0.2, 0.5, 0.9]] * 2)
AROUND = Camera(position=(80, 75, 130), target=(27.5, 23.5, 19.5), up=(0, 1, 0), fov_degrees=30.0)


def scene(mode="reproject", width=96, **tables):
    z, y, x = np.ogrid[:40, :48, :56]
    away = np.sqrt((x - 27.5) ** 2 + (y - 23.5) ** 2 + (z - 19.5) ** 2)
    volume = Volume(np.clip(120 + 24 * (16 - away), 0, 255).astype(np.uint8))
    tables = {"integration": {"classification": "post"}, **tables}
    return Scene(volume=volume, transfer_function=SOLID, image={"width": width, "height": 80}, camera=AROUND,
                 coherence={"mode": mode, "audit": 16}, **tables)  # fmt: skip


@pytest.fixture
def shared(device, monkeypatch):
    """Renderers of three contexts on one device."""
    opened = []

    def make(made) -> Renderer:
        monkeypatch.setattr(renderer_module, "open_contexts", lambda _: [DeviceContext(device) for _ in range(3)])
        opened.append(Renderer(made))
        monkeypatch.undo()
        monkeypatch.setattr(device_group, "_LEAST_TILES", 1)
        return opened[-1]

    yield make
    for each in opened:
        each.close()


@pytest.fixture(scope="module")
def expected(device):
    """Pictures from the hull on one device, by degrees."""
    found = {}
    with Renderer(scene("off"), devices=[device]) as one:
        yield lambda degrees: found.setdefault(degrees, one.render(camera=orbited(AROUND, degrees)))


def show(renderer, expected, degrees):
    """The next picture's stats. Asserts that every bit is that of a picture from the hull."""
    frame, hull = renderer.render(camera=orbited(AROUND, degrees)), expected(degrees)
    np.testing.assert_array_equal(frame.rgba.view(np.uint32), hull.rgba.view(np.uint32))
    np.testing.assert_array_equal(frame.depth.view(np.uint32), hull.depth.view(np.uint32))
    assert frame.stats["rays"] == hull.stats["rays"]
    assert not [name for name in frame.stats.get("counters", {}) if name.startswith("coherence")]
    return {**frame.stats["coherence"], "samples": frame.stats["samples"], "from_hull": hull.stats["samples"]}


def assert_reused(stats):
    assert not stats["reinitialised"] and stats["reason"] is None and stats["late_starts"] == 0, stats
    assert stats["reused_starts"] > 500 and stats["samples"] < 0.9 * stats["from_hull"], stats
    assert stats["samples_saved"] > 0


def test_an_orbit_on_several_devices(shared, expected):
    renderer = shared(scene())
    assert show(renderer, expected, 0.0)["reason"] == "the first picture"
    for step in range(1, 4):
        assert_reused(show(renderer, expected, 1.0 * step))
    assert show(renderer, expected, 100.0)["reason"] == "motion"
    assert_reused(show(renderer, expected, 101.0))


def test_a_device_that_fails_takes_no_starts_with_it(shared, expected, monkeypatch):
    """Those that are left start after what all devices have met."""
    renderer, real, lost = shared(scene()), PictureParts.render, []
    show(renderer, expected, 0.0)

    def render(self, stage, tiles):
        if not lost:
            lost.append(self)
        if self._context is lost[0]._context:
            raise RenderError("device", "failed on purpose")
        return real(self, stage, tiles)

    monkeypatch.setattr(PictureParts, "render", render)
    with pytest.warns(ClvolWarning, match="failed on purpose"):
        assert_reused(show(renderer, expected, 1.0))
    assert_reused(show(renderer, expected, 2.0))


def test_a_device_that_had_no_part_in_the_picture_before_starts_at_the_hull(shared, expected, monkeypatch):
    renderer = shared(scene())
    numbers, begin = itertools.count(), coherent_parts.CoherentParts.begin
    first = []

    def forgets(self, stage, arrays):
        first.append(self._context)
        begin(self, stage, arrays)
        if self._context is first[0]:
            self._history.number = -1 - next(numbers)

    monkeypatch.setattr(coherent_parts.CoherentParts, "begin", forgets)
    show(renderer, expected, 0.0)
    shares = []
    for step in (1, 2):
        stats = show(renderer, expected, 1.0 * step)
        shares.append(stats["reused_starts"])
    assert 0 < max(shares) < 96 * 80


def test_late_starts_are_found_and_the_picture_is_repaired(shared, expected, monkeypatch):
    renderer = shared(scene())
    show(renderer, expected, 0.0)
    monkeypatch.setattr(coherent_parts, "step_back", lambda caster: -12.0)
    stats = show(renderer, expected, 1.0)
    assert stats["late_starts"] > 5 and stats["samples"] > stats["from_hull"]
    for step in range(2, 2 + history._PAUSE):
        assert show(renderer, expected, 1.0 * step)["reason"] == "starts were late"
    assert show(renderer, expected, 2.0 + history._PAUSE)["late_starts"] > 5


def test_what_takes_no_starts_says_so(shared):
    pyramid = shared(scene(integration={"method": "pyramid"}))
    assert pyramid.render().stats["coherence"] == {"mode": "off", "reason": "the pyramid"}


def test_a_picture_that_is_not_completed_leaves_no_starts(shared, expected):
    """Devices have seen its camera, but what is kept belongs to the picture before."""
    renderer = shared(scene())
    show(renderer, expected, 0.0)

    def stops(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        renderer.render(camera=orbited(AROUND, 3.0), progress=stops)
    assert show(renderer, expected, 4.0)["reused_starts"] == 0
    assert_reused(show(renderer, expected, 5.0))


@pytest.mark.slow  # starts processes
def test_devices_in_processes_of_their_own(halves, expected):
    with Renderer(scene(), devices=halves, isolate=True) as renderer:
        assert show(renderer, expected, 0.0)["reason"] == "the first picture"
        for step in (1, 2, 3):
            assert_reused(show(renderer, expected, 1.0 * step))
