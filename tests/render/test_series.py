"""A picture of a step is that of its volume alone, under what was chosen for all times; only voxels change between."""

from __future__ import annotations

import gc
import threading
import weakref

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, waves

from clvol import Renderer, Scene, Volume, VolumeSeries
from clvol.batch.frames import Frames
from clvol.device.volume import DeviceVolume
from clvol.errors import ClvolWarning, VolumeError
from clvol.integrators.raycast.caster import Raycaster
from clvol.opencl.context import DeviceContext

SHAPE = (14, 17, 15)
COUNT = 5


def step_array(k: int, dtype=np.uint8) -> np.ndarray:
    """Waves that move, and are brighter in every step."""
    whole = waves((SHAPE[0] + COUNT, *SHAPE[1:]), np.float64)
    return np.ascontiguousarray(whole[k : k + SHAPE[0]] * (0.4 + 0.15 * k)).astype(dtype)


def scene_of(volume, **tables) -> Scene:
    tables.setdefault("integration", {"step_error": 0.0})
    return Scene(volume=volume, image={"width": 20, "height": 16}, transfer_function=SMOOTH, **tables)


def times(*steps: int) -> list[float]:
    return [k / 25.0 for k in steps]


KINDS = {
    "plain": {},
    "cubic": {"integration": {"filter": "cubic", "step_error": 0.0}},
    "lit": {"light": [{"type": "headlight"}]},
    "shadows": {"light": [{"type": "directional", "direction": [-1.0, -1.0, -1.0]}],
                "shadow": {"method": "volume", "resolution": 8}},
    "surfaces": {"isosurface": [{"value": 100.0}], "light": [{"type": "headlight"}]},
    "maximum": {"integration": {"compositing": "maximum", "step_error": 0.0}},
    "fewer bits": {"integration": {"voxel_precision": "uint8", "step_error": 0.0}},
    "multiresolution": {"integration": {"method": "multiresolution", "step_error": 0.0}},
    "pyramid": {"integration": {"method": "pyramid"}},
    "slicing": {"integration": {"method": "slicing"}},
    "codes": {"compression": {"codec": "vq", "psnr": 40.0}},
}  # fmt: skip
FAST = ["plain"]


@pytest.mark.parametrize("kind", [
    pytest.param(kind, marks=() if kind in FAST else pytest.mark.slow) for kind in KINDS
])  # fmt: skip
@pytest.mark.every_case
def test_a_step_is_the_picture_of_its_volume(device, kind):
    """Whatever was shown before."""
    dtype = np.float32 if kind == "lit" else np.uint8
    steps = [Volume(step_array(k, dtype)) for k in range(COUNT)]
    reach = (float(min(s.data.min() for s in steps)), float(max(s.data.max() for s in steps)))
    with Renderer(scene_of(VolumeSeries(steps), **KINDS[kind]), devices=[device]) as renderer:
        assert renderer.resolved.data_range == reach
        shown = {k: renderer.render(time=t) for k, t in zip((0, 1, 3, 2, 4), times(0, 1, 3, 2, 4))}
        again = renderer.render(time=times(1)[0])
    np.testing.assert_array_equal(again.rgba, shown[1].rgba)
    with Renderer(scene_of(steps[0], **KINDS[kind]), devices=[device]) as one:
        for k, frame in shown.items():
            one.set_scene(scene_of(steps[k], **KINDS[kind]))
            alone = one.render()
            if kind in ("fewer bits", "codes"):  # codes are those of the range of all times
                assert np.abs(frame.rgba - alone.rgba).max() < 0.05
            else:
                np.testing.assert_array_equal(frame.rgba, alone.rgba, err_msg=f"step {k}")
                np.testing.assert_array_equal(frame.depth, alone.depth)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.every_case
def test_only_voxels_change_between_steps(device, dtype, monkeypatch):
    made = {"volumes": 0, "tables": 0}
    volume_init, build_table = DeviceVolume.__init__, Raycaster._build_table

    def counted(what, function):
        def call(*given):
            made[what] += 1
            return function(*given)

        return call

    monkeypatch.setattr(DeviceVolume, "__init__", counted("volumes", volume_init))
    monkeypatch.setattr(Raycaster, "_build_table", counted("tables", build_table))
    series = VolumeSeries([step_array(k, dtype) for k in range(COUNT)])
    with Renderer(scene_of(series), devices=[device]) as renderer:
        renderer.render(time=0.0)
        (member,) = renderer._on_device.members
        context: DeviceContext = member.context
        first, programs, kernels = member.prepared, dict(context._programs), dict(context._kernels)
        assert made == {"volumes": 1, "tables": 1}
        for time in times(1, 2, 3, 4, 0):
            renderer.render(time=time)
            now = member.prepared
            assert now.table is first.table and now.volume is first.volume
            if dtype == np.uint8:  # pairs of voxels; other voxels are used where they lie on the host
                assert now.volume.voxels is first.volume.voxels
            assert len(member.cache._kept) == 1
        assert made == {"volumes": 1, "tables": 1}
        assert context._programs == programs and context._kernels == kernels


def test_at_most_two_steps_are_in_memory_beside_that_of_the_device(device):
    alive, most, lock = [0], [0], threading.Lock()

    def read(k: int) -> Volume:
        array = step_array(k % COUNT)
        with lock:
            alive[0] += 1
            most[0] = max(most[0], alive[0])
        weakref.finalize(array, gone)
        return Volume(array)

    def gone() -> None:
        with lock:
            alive[0] -= 1

    count = 12
    series = VolumeSeries([lambda k=k: read(k) for k in range(count)], value_range=(0, 255))
    with Renderer(scene_of(series), devices=[device]) as renderer:
        frames = [
            renderer.render(time=k / 25, next_time=(k + 1) / 25 if k + 1 < count else None) for k in range(count)
        ]  # fmt: skip
    assert most[0] <= 3 and series.reads == count
    assert series._ahead.ready >= count - 2
    series.close()
    del renderer
    gc.collect()
    assert alive[0] == 0 and len(frames) == count  # which hold no voxels


def test_the_next_step_is_expected_where_nothing_is_said(device):
    series = VolumeSeries([step_array(k) for k in range(COUNT)], value_range=(0, 255))
    with Renderer(scene_of(series), devices=[device]) as renderer:
        renderer.render(time=0.0)
        assert series._ahead._next is None  # one picture is no reason to read another step
        for k in (1, 2, 3, 4):
            renderer.render(time=k / 25)
        assert series._ahead.ready == 3 and series.reads == COUNT
        for k in (3, 2, 1):  # backwards
            renderer.render(time=k / 25)
        assert series._ahead.ready == 5


def test_a_step_that_fails_leaves_the_renderer_as_it_was(device):
    def read(k: int) -> Volume:
        if k == 2:
            raise VolumeError("t_2.nrrd", "is damaged", "an undamaged file")
        return Volume(step_array(k))

    series = VolumeSeries([lambda k=k: read(k) for k in range(COUNT)], value_range=(0, 255))
    with Renderer(scene_of(series), devices=[device]) as renderer:
        first = renderer.render(time=0.0, next_time=1 / 25)
        second = renderer.render(time=1 / 25, next_time=2 / 25)
        with pytest.raises(VolumeError, match="t_2.nrrd: is damaged"):
            renderer.render(time=2 / 25, next_time=3 / 25)
        renderer.render(time=3 / 25)
        np.testing.assert_array_equal(renderer.render(time=1 / 25).rgba, second.rgba)
        np.testing.assert_array_equal(renderer.render().rgba, first.rgba)


@pytest.mark.parametrize("tables", [{}, {"transfer_function": {"preset": "grayscale"}}], ids=["chosen", "preset"])
def test_what_is_chosen_does_not_depend_on_the_step(tables):
    """Nor on whether a step is shown as part of an animation."""
    series = VolumeSeries([step_array(k) for k in range(COUNT)])
    resolved = [Scene(volume=series, animation={"time": t}, **tables).resolve() for t in times(0, 2, 4)]
    for each in resolved[1:]:
        assert each.transfer_function == resolved[0].transfer_function
        assert each.camera == resolved[0].camera and each.integration == resolved[0].integration
        assert each.chosen == resolved[0].chosen and each.data_range == resolved[0].data_range
    assert [each.volume.number for each in resolved] == [0, 2, 4]
    alone = Scene(volume=Volume(step_array(0)), **tables).resolve()
    assert alone.transfer_function != resolved[0].transfer_function  # it would flicker


@pytest.mark.slow  # a program with lights and holes
def test_steps_of_nothing_and_of_holes(device):
    """Blank steps, and steps with NaN alone, between others."""
    steps = [step_array(k, np.float32) for k in range(4)]
    steps[1] = np.zeros(SHAPE, np.float32)
    steps[2] = np.full(SHAPE, np.nan, np.float32)
    scene = scene_of(VolumeSeries(steps), light=[{"type": "headlight"}])
    with Renderer(scene, devices=[device]) as renderer, pytest.warns(ClvolWarning, match="blank"):
        shown = [renderer.render(time=t).rgba for t in times(0, 1, 2, 3, 0)]
    assert not shown[1].any() and not shown[2].any()
    assert shown[0].any() and shown[3].any()
    np.testing.assert_array_equal(shown[4], shown[0])


@pytest.mark.slow  # starts a process, which compiles
def test_steps_in_a_process_of_its_own(device, isolated):
    series = VolumeSeries([step_array(k) for k in range(COUNT)])
    for tables in ({}, {"light": [{"type": "headlight"}]}):
        scene = scene_of(series, **tables)
        with Renderer(scene, devices=[device]) as here:
            expected = [here.render(time=t).rgba for t in times(0, 1, 4, 2)]
        renderer = isolated(scene, [device])
        for t, picture in zip(times(0, 1, 4, 2), expected):
            np.testing.assert_array_equal(renderer.render(time=t).rgba, picture)
        (member,) = renderer._on_device.members
        assert sum(volume is not None for volume in member._volumes._volumes) == 1  # in shared memory
        assert len(member._volumes._held) == 1


def test_two_devices_show_the_same_step(device, halves):
    series = VolumeSeries([step_array(k) for k in range(COUNT)])
    with Renderer(scene_of(series), devices=[device]) as one, Renderer(scene_of(series), devices=halves) as two:
        for t in times(0, 1, 3):
            np.testing.assert_array_equal(one.render(time=t).rgba, two.render(time=t).rgba)


@pytest.mark.parametrize("slope", [-0.5, 2.0])
def test_values_of_a_series_with_a_slope(device, slope):
    arrays = [step_array(k) for k in range(3)]
    series = VolumeSeries(arrays, slope=slope, offset=3.0)
    with Renderer(scene_of(series), devices=[device]) as renderer:
        shown = [renderer.render(time=t).rgba for t in times(0, 1, 2)]
    for array, picture in zip(arrays, shown):
        with Renderer(scene_of(Volume(array, slope=slope, offset=3.0)), devices=[device]) as alone:
            np.testing.assert_array_equal(picture, alone.render().rgba)


def test_another_transfer_function_between_steps(device):
    series = VolumeSeries([step_array(k) for k in range(3)])
    other = SMOOTH.__class__(SMOOTH.values, SMOOTH.opacities[::-1], SMOOTH.colors, SMOOTH.opacity_unit)
    with Renderer(scene_of(series), devices=[device]) as renderer:
        first = renderer.render(time=0.0).rgba
        renderer.render(time=1 / 25)
        renderer.set_transfer_function(other)
        changed = renderer.render(time=1 / 25).rgba
        renderer.render(time=2 / 25)
        renderer.set_transfer_function(SMOOTH)
        np.testing.assert_array_equal(renderer.render(time=0.0).rgba, first)
    with Renderer(scene_of(Volume(step_array(1))), devices=[device]) as alone:
        alone.set_transfer_function(other)
        np.testing.assert_array_equal(alone.render().rgba, changed)


def test_values_that_key_frames_change_beside_the_steps(device):
    """Each frame has its step and its values, and a step is read once."""
    series = VolumeSeries([step_array(k) for k in range(COUNT)], value_range=(0, 255))
    points = [{"value": 60.0, "opacity": 0.0, "color": [0, 0, 0]}, {"value": 200.0, "opacity": 0.5, "color": [1, 1, 1]}]
    units = {0: 1.0, COUNT - 1: 5.0}
    scene = Scene(
        volume=series, image={"width": 20, "height": 16}, integration={"step_error": 0.0},
        transfer_function={"points": points, "opacity_unit": 1.0},
        animation={"frames": COUNT, "keyframe": [
            {"time": k / 25, "set": {"transfer_function.opacity_unit": unit}} for k, unit in units.items()
        ]},
    )  # fmt: skip
    film = Frames(scene, scene.resolve(), [])
    with Renderer(scene, devices=[device]) as renderer:
        before = series.reads
        following = [*film.all[1:], None]
        shown = [film.render(renderer, *pair[:1], None, False, pair[1]).rgba for pair in zip(film.all, following)]
        assert series.reads - before == COUNT - 1
    for k, unit in units.items():
        alone = scene.model_copy(update={
            "volume": Volume(step_array(k)), "animation": {"frames": 1}, "camera": film.all[k][2],
            "transfer_function": {"points": points, "opacity_unit": unit},
        })  # fmt: skip
        with Renderer(alone, devices=[device]) as renderer:
            np.testing.assert_allclose(shown[k], renderer.render().rgba, atol=1e-4)
