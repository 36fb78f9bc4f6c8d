"""A Renderer's picture is that of its scene as it is now, whatever was rendered before and by whom."""

from __future__ import annotations

import random
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from helpers.small_scenes import make_scene, waves

from clvol import Camera, Renderer, Scene, TransferFunction, Volume
from clvol.errors import RenderError, VolumeError
from clvol.integrators.registry import integrator_of
from clvol.render.scene_key import scene_key, value_key
from clvol.store.volume_blocks import VolumeBlocks

FUNCTIONS = [
    TransferFunction([0, 100, 255], [0, first, last], [color] * 3, opacity_unit=10.0)
    for first, last, color in (
        (0.0, 0.9, [1, 0, 0]), (0.8, 0.0, [0, 1, 0]), (0.1, 0.3, [0.2, 0.4, 1]), (0, 0, [1, 1, 1])
    )
]  # fmt: skip
CAMERAS = [None, Camera(position=(60.0, 20.0, 30.0)), Camera(projection="orthographic")]
CYCLING = {"animation": {"cycle": 0.3}}
MOVING = {"noise": [{"target": "value", "amplitude": 40.0, "velocity": [0.3, 0.1, 0.0]}]}
LIT = {"light": [{"type": "headlight"}], "depth_cue": {"strength": 0.7, "color": [0.1, 0.2, 0.3]}}
SHADOWED = {"light": [{"type": "directional", "direction": [-1.0, -1.0, -1.0]}],
            "shadow": {"method": "volume", "resolution": 8}, **MOVING}  # fmt: skip
KINDS = {
    "raycast": CYCLING,
    "moving": {**CYCLING, **MOVING},
    "lit": {**CYCLING, **LIT},
    "shadowed": SHADOWED,
    "cells": {"integration": {"quadrature": "cells"}},
    "fewer bits": {**CYCLING, "integration": {"voxel_precision": "uint8"}},
    "prefiltered": {**CYCLING, "integration": {"filter": "cubic", "prefilter": True}},
    "multiresolution": {"integration": {"method": "multiresolution"},
                        "multiresolution": {"memory": "100 KiB"}},
    "pyramid": {"integration": {"method": "pyramid"}, **CYCLING},
    "slicing": {"integration": {"method": "slicing"}, "slicing": {"geometry": "shells"}, **CYCLING},
    "reference": {"integration": {"method": "reference"}},
}  # fmt: skip
VOLUME = Volume(waves((21, 34, 27), np.uint16, high=255.0))


def key_of(scene):
    return scene_key(scene, integrator_of(scene))


def scene_of(kind: str, function=FUNCTIONS[0], volume=VOLUME) -> Scene:
    return Scene(volume=volume, transfer_function=function, image={"width": 18, "height": 14}, **KINDS[kind])


def alike(frame, other) -> bool:
    return np.array_equal(frame.rgba, other.rgba) and np.array_equal(frame.depth, other.depth)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_no_picture_depends_on_what_was_rendered_before(kind, device):
    """Any order of functions, times and views gives what a Renderer gives that has rendered nothing."""
    chosen = random.Random(kind)
    expected = {}

    def fresh(function: int, time: float, camera: int):
        if (function, time, camera) not in expected:
            with Renderer(scene_of(kind, FUNCTIONS[function]), [device]) as renderer:
                expected[function, time, camera] = renderer.render(CAMERAS[camera], time=time)
        return expected[function, time, camera]

    shown = 0
    with Renderer(scene_of(kind), [device]) as renderer:
        for _ in range(16):
            if chosen.random() < 0.5:
                shown = chosen.randrange(len(FUNCTIONS))
                same = FUNCTIONS[shown]  # itself, or another of the same value
                copy = TransferFunction(same.values, same.opacities, same.colors, same.opacity_unit)
                renderer.set_transfer_function(chosen.choice([same, copy]), wait=chosen.random() < 0.7)
            time, camera = chosen.choice([0.0, 1.0, 2.5]), chosen.randrange(len(CAMERAS))
            frame = renderer.render(CAMERAS[camera], time=time)
            while frame.stats.get("blocks", {}).get("pending"):
                frame = renderer.render(CAMERAS[camera], time=time)
            assert alike(frame, fresh(shown, time, camera)), (shown, time, camera)
    differ = {frame.rgba.tobytes() for frame in expected.values()}
    assert len(differ) > 5  # the cases are no single picture


@pytest.mark.slow
def test_a_function_that_comes_back_after_another_time_is_shown(device):
    """The case of a stale picture: f1, set f2, time 1, set f1, time 2."""
    with Renderer(scene_of("multiresolution"), [device]) as renderer:
        renderer.render()
        renderer.set_transfer_function(FUNCTIONS[1])
        renderer.render(time=1.0)
        renderer.set_transfer_function(FUNCTIONS[0])
        frame = renderer.render(time=2.0)
    with Renderer(scene_of("multiresolution"), [device]) as renderer:
        assert alike(frame, renderer.render(time=2.0))
    assert frame.rgba[..., 0].max() > 0.1 and frame.rgba[..., 1].max() == 0


@pytest.mark.parametrize("kind", ("fewer bits", "prefiltered"))
def test_another_function_leaves_converted_voxels_where_they_are(kind, device):
    with Renderer(scene_of(kind), [device]) as renderer:
        before = renderer._on_device.prepared.volume
        renderer.set_transfer_function(FUNCTIONS[1])
        assert renderer._on_device.prepared.volume is before


def test_blocks_that_could_not_be_read_are_read_again(device, monkeypatch):
    broken, read = [False], VolumeBlocks.read

    def failing(self, level, blocks):
        if broken[0]:
            raise VolumeError("store", "is damaged")
        return read(self, level, blocks)

    monkeypatch.setattr(VolumeBlocks, "read", failing)
    with Renderer(scene_of("multiresolution"), [device]) as renderer:
        broken[0] = True
        with pytest.raises(VolumeError):
            renderer.set_transfer_function(FUNCTIONS[1])
        broken[0] = False
        renderer.set_transfer_function(FUNCTIONS[1])
        frame = renderer.render()
    with Renderer(scene_of("multiresolution", FUNCTIONS[1]), [device]) as renderer:
        assert alike(frame, renderer.render())


@pytest.mark.slow
@pytest.mark.parametrize("dtype", (np.uint8, np.float32))
def test_voxels_changed_between_frames_are_no_picture_of_both(dtype, device):
    """A simulation that computes in place: an error that says what to do, never empty space of one state around
    voxels of another."""
    array = waves((21, 34, 27)).astype(dtype)
    with Renderer(Scene(volume=Volume(array), transfer_function=FUNCTIONS[1]), [device]) as renderer:
        renderer.render()
        array[...] = 255 - array
        with pytest.raises(VolumeError, match="expected another Volume and Renderer"):
            renderer.render()


# Keys


def test_every_part_of_a_scene_is_in_the_key_of_its_engine():
    """Whatever is added to a scene counts, unless an engine takes it over frame by frame."""
    scene = scene_of("lit").resolve()
    key = key_of(scene)
    assert key == key_of(scene_of("lit").resolve())
    for kind in set(KINDS) - {"lit"}:
        assert key_of(scene_of(kind).resolve()) != key
    assert key_of(scene_of("lit", FUNCTIONS[1]).resolve()) != key
    assert key_of(scene_of("lit", volume=Volume(VOLUME.data)).resolve()) != key


def test_values_are_told_apart_to_the_last_bit():
    different = [1, 1.0, True, np.nextafter(1.0, 2.0), 0.0, -0.0, "1", None, (1,), np.ones(1),
                 np.ones(1, np.float32), np.ones((1, 1)), np.array([1.0 + 1e-15])]  # fmt: skip
    assert len({value_key(value) for value in different}) == len(different)


def test_a_key_keeps_what_it_names_alive():
    """No other volume can take the place of one that is gone."""
    volume = Volume(waves((3, 4, 5)))
    gone = weakref.ref(volume)
    key = key_of(make_scene(volume))
    del volume
    assert gone() is not None
    del key
    assert gone() is None


# Threads


@pytest.mark.parametrize("kind", ("raycast", "lit", "multiresolution", "pyramid", "reference"))
def test_each_thread_gets_its_own_picture(kind, device):
    views = [Camera(position=(60.0 - 9 * k, 20.0 + 7 * k, 40.0)) for k in range(6)]
    times = [0.0, 1.0, 2.5]
    with Renderer(scene_of(kind), [device]) as renderer:
        expected = [[renderer.render(view, time=time) for time in times] for view in views]

        def work(number: int) -> bool:
            own = random.Random(number)
            for _ in range(6):
                view, time = own.randrange(len(views)), own.randrange(len(times))
                if not alike(renderer.render(views[view], time=times[time]), expected[view][time]):
                    return False
            return True

        with ThreadPoolExecutor(8) as threads:
            assert all(threads.map(work, range(8)))


def test_frames_are_of_one_function_while_others_set_it(device):
    """Each frame is whole under one of the functions that threads set, never a mixture."""
    with Renderer(scene_of("multiresolution"), [device]) as renderer:
        allowed = []
        for function in FUNCTIONS:
            renderer.set_transfer_function(function)
            allowed.append(renderer.render().rgba)

        def work(number: int) -> bool:
            right = True
            for turn in range(5):
                if number % 2:
                    renderer.set_transfer_function(FUNCTIONS[(number + turn) % len(FUNCTIONS)])
                else:
                    rgba = renderer.render().rgba
                    right &= any(np.array_equal(rgba, one) for one in allowed)
            return right

        with ThreadPoolExecutor(6) as threads:
            assert all(threads.map(work, range(6)))


def test_blocks_read_in_the_background_end_in_the_right_picture_whoever_looks(device):
    """Threads that set functions without waiting, and threads that render meanwhile."""
    with Renderer(scene_of("multiresolution"), [device]) as renderer:

        def work(number: int) -> None:
            for turn in range(5):
                if number % 2:
                    function = FUNCTIONS[(number + turn) % len(FUNCTIONS)]
                    renderer.set_transfer_function(function, wait=False)
                else:
                    assert np.isfinite(renderer.render().rgba).all()

        with ThreadPoolExecutor(6) as threads:
            list(threads.map(work, range(6)))
        renderer.set_transfer_function(FUNCTIONS[1], wait=False)
        while (frame := renderer.render()).stats["blocks"]["pending"]:
            pass
    with Renderer(scene_of("multiresolution", FUNCTIONS[1]), [device]) as renderer:
        assert alike(frame, renderer.render())


@pytest.mark.slow
def test_renderers_in_threads_of_their_own_do_not_meet(device):
    """Two and more of one scene and volume: compiled, rendered and closed at the same time."""
    scenes = {kind: scene_of(kind) for kind in ("raycast", "lit", "multiresolution", "reference")}
    expected = {}
    for kind, scene in scenes.items():
        with Renderer(scene, [device]) as renderer:
            expected[kind] = renderer.render()

    def work(kind: str) -> bool:
        with Renderer(scenes[kind], [device]) as renderer:
            return all(alike(renderer.render(), expected[kind]) for _ in range(3))

    with ThreadPoolExecutor(8) as threads:
        assert all(threads.map(work, list(scenes) * 3))


def test_a_renderer_closed_by_another_thread_ends_in_an_error_or_a_whole_picture(device):
    renderer = Renderer(scene_of("multiresolution"), [device])
    expected, results = renderer.render(), []
    begun = threading.Barrier(5)

    def work() -> None:
        begun.wait()
        try:
            while True:
                results.append(alike(renderer.render(), expected))
        except RenderError as error:
            results.append(error.what)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    begun.wait()
    renderer.close()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    assert set(results) <= {True, "is closed"} and results.count("is closed") == 4
    renderer.close()


@pytest.mark.parametrize("call", ("render", "close", "set_transfer_function"))
def test_a_call_from_its_own_progress_is_refused_and_does_not_hang(call, device):
    with Renderer(scene_of("raycast"), [device]) as renderer:
        expected = renderer.render()
        arguments = [FUNCTIONS[1]] if call == "set_transfer_function" else []

        def inside(done: int, total: int) -> None:
            getattr(renderer, call)(*arguments)

        with pytest.raises(RenderError, match="progress"):
            renderer.render(progress=inside)
        assert alike(renderer.render(), expected)


@pytest.mark.parametrize("method", ["raycast", "multiresolution"])
def test_colours_of_another_function_are_associated_as_those_before(method, device):
    """Its light goes with it, whatever the number of its points is."""

    def glowing(function):
        rows = zip(*(column.tolist() for column in (function.values, function.opacities, function.colors)))
        points = [{"value": value, "opacity": opacity, "color": color} for value, opacity, color in rows]
        table = {"points": points, "associated": True, "emission": 2.5, "opacity_unit": 10.0, "color_space": "linear"}
        size = {"width": 18, "height": 14}
        return Scene(volume=VOLUME, transfer_function=table, image=size, integration={"method": method})

    other = TransferFunction([0, 60, 90, 255], [0, 0, 0.2, 0], [[0, 0, 0], [0, 0, 1], [0, 0.5, 1], [0, 0, 0]], 10.0)
    with Renderer(glowing(FUNCTIONS[0]), [device]) as renderer:
        before = renderer.render()
        for function in (other, FUNCTIONS[1], FUNCTIONS[0]):
            renderer.set_transfer_function(function)
            found = renderer.render()
            with Renderer(glowing(function), [device]) as fresh:
                assert alike(found, fresh.render())
        assert alike(found, before)
