"""Rays that start where those of the picture before first contributed (cl/coherence.h, cl/reproject.cl): bit for bit
the pictures that start at the hull, over every way in which a start could be late."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from helpers.small_scenes import axis_camera, make_scene
from reference import reprojection as reference

from clvol import Camera, TransferFunction
from clvol.device.view import ray_frame
from clvol.integrators.raycast import history as module
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.raycast.measured_gain import MeasuredGain
from clvol.integrators.raycast.reprojection import MARGIN, Move, change_of_camera, moved, plan_move
from clvol.integrators.raycast.same_starts import Facts
from clvol.scene.coherence import Coherence
from clvol.scene.isosurface import Isosurface
from clvol.schedule.animation import orbited

SHAPE = (40, 48, 56)
CENTRE = (27.5, 23.5, 19.5)
SOLID = TransferFunction([0, 100, 140, 255], [0, 0, 0.6, 1.0], [[0.9, 0.5, 0.2], [0.2, 0.5, 0.9]] * 2)
FEWER = TransferFunction([0, 120, 140, 255], [0, 0, 0.6, 1.0], [[0.1, 0.9, 0.2]] * 4)
AROUND = {"position": [80, 75, 130], "target": list(CENTRE), "fov_degrees": 30.0}
SIZE = (72, 60)


def ball(radius=16.0, centre=CENTRE, shape=SHAPE) -> np.ndarray:
    z, y, x = np.ogrid[: shape[0], : shape[1], : shape[2]]
    away = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)
    return np.clip(120 + 24 * (radius - away), 0, 255).astype(np.uint8)


def layers() -> np.ndarray:
    """A near bar, a bar half way that it may hide, and a far wall; the eye looks along -z."""
    array = np.zeros(SHAPE, np.uint8)
    array[2:6] = 255
    array[16:19, :, 24:30] = 255
    array[33:37, :, 25:31] = 255
    return array


def scene(array=None, function=SOLID, mode="reproject", camera=AROUND, splat=3, audit=64, size=SIZE, **how):
    found = make_scene(ball() if array is None else array, function, camera=camera, width=size[0], height=size[1],
                       **{"classification": "post", **how})  # fmt: skip
    return replace(found, coherence=Coherence(mode=mode, splat=splat, audit=audit))


class Pictures:
    """Pictures of scenes, one after another, each beside the same from the hull."""

    def __init__(self, context, first, **how):
        self.context, self.how = context, how
        self.scene, self.history = first, module.History()
        self.data = self.stats = None

    def show(self, camera=None, scene=None):
        """The next picture; returns its stats. Asserts that every bit is that of a picture from the hull."""
        self.scene = scene or self.scene
        camera = complete(self.scene, camera) if camera is not None else self.scene.camera
        size = self.scene.image.width, self.scene.image.height
        caster = Raycaster(self.context, self.scene, history=self.history, **self.how)
        self.data = caster.render(camera, *size)
        off = replace(self.scene, coherence=Coherence(mode="off"))
        expected = Raycaster(self.context, off, **self.how).render(camera, *size)
        np.testing.assert_array_equal(self.data.rgba.view(np.uint32), expected.rgba.view(np.uint32))
        np.testing.assert_array_equal(self.data.depth.view(np.uint32), expected.depth.view(np.uint32))
        self.stats = {**self.data.notes["coherence"], "samples": self.data.samples, "from_hull": expected.samples}
        return self.stats


def complete(resolved, camera) -> Camera:
    camera = Camera(**camera) if isinstance(camera, dict) else camera
    return camera.complete(resolved.volume.grid, resolved.image)


def assert_reused(stats):
    assert not stats["reinitialised"] and stats["reason"] is None and stats["late_starts"] == 0, stats
    assert stats["reused_starts"] > 500, stats


def turned(degrees, camera=AROUND) -> dict:
    found = orbited(Camera(**{"up": [0, 1, 0], **camera}), degrees)
    return {**camera, "position": list(found.position)}


# ---- the reprojection itself


@pytest.mark.parametrize("parallel", [False, True])
def test_starts_are_those_of_the_reference(context, parallel):
    rng = np.random.default_rng(5)
    resolved = scene()
    kind = {"projection": "orthographic", "height": 70.0} if parallel else {}
    cameras = [complete(resolved, {**AROUND, **kind}), complete(resolved, {**turned(4.0), "up": [0.1, 1, 0], **kind})]
    old, new = (ray_frame(camera, resolved.volume.grid, *SIZE) for camera in cameras)
    bounds = np.zeros(3), np.asarray(SHAPE[::-1]) - 1.0
    move = plan_move(old, new, SIZE, SIZE, bounds, 3)
    assert isinstance(move, Move)
    move = replace(move, inside=np.ones_like(move.inside))
    kept = rng.uniform(0, 60, SIZE[::-1]).astype(np.float32)
    kept[rng.random(kept.shape) < 0.2] = np.inf
    exits = (rng.random(kept.shape) < 0.2) & np.isfinite(kept)
    kept[exits] = -1 - kept[exits]
    coefficients = change_of_camera(old, new)
    x, y, depth = reference.projected(kept, coefficients, move.numbers[18], old.centre, new.centre)
    size = int(move.numbers[23])
    near_an_edge = sum(np.abs(at - size / 2 - np.round(at - size / 2)) < 1e-3 for at in (x, y)) > 0
    kept[near_an_edge] = np.inf  # where rounding decides
    x, y, depth = (np.where(near_an_edge, np.nan, each) for each in (x, y, depth))
    history = module.History()
    history.array("kept", kept.shape, lambda: context.upload(kept, writable=True))
    found = context.read(module.reproject(context, history, move, SIZE, 2.0, 7))
    expected = reference.starts(x, y, depth, SIZE, size, move.window, 2.0, move.numbers[25:27], move.numbers[27])
    assert np.isfinite(expected).mean() > 0.9
    found, expected = (np.where(each > 1e29, np.inf, each) for each in (found, expected))
    assert np.isinf(expected).sum() > 10
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-3)
    marked = (found.view(np.int32) & 1).astype(bool) & np.isfinite(found)
    assert 0.1 < marked.mean() < 0.2


def test_a_place_is_where_both_cameras_see_it(context):
    """From the pixels' own rays: a point on an old ray projects to the new ray that passes through it."""
    resolved = scene()
    cameras = [complete(resolved, AROUND), complete(resolved, {**turned(9.0), "fov_degrees": 40.0})]
    old, new = (ray_frame(camera, resolved.volume.grid, *SIZE) for camera in cameras)
    x, y, s = (np.array(each) for each in ([3.0, 40.0], [50.0, 11.0], [20.0, 33.0]))
    coefficients = change_of_camera(old, new)
    u, v = x - old.centre[0], y - old.centre[1]
    terms = np.stack([np.ones(2), u, v, s, s * u, s * v])
    depth, across, down = coefficients @ terms
    from_eye = new.distance + depth

    def place(frame, u, v, s):
        at = frame.origin[:, None] + u * frame.du[:, None] + v * frame.dv[:, None]
        return at + s * (frame.forward[:, None] + u * frame.ray_du[:, None] + v * frame.ray_dv[:, None])

    np.testing.assert_allclose(place(new, across / from_eye, down / from_eye, depth), place(old, u, v, s), atol=1e-9)


def test_what_is_behind_moves_no_faster_than_is_counted():
    """Two places on an old ray: in the new picture the farther one is behind the nearer one by what is added there."""
    resolved, rng = scene(), np.random.default_rng(7)
    kinds = ({}, {"projection": "orthographic", "height": 70.0})
    bounds = np.zeros(3), np.asarray(SHAPE[::-1]) - 1.0
    for kind, to in itertools.product(kinds, (turned(3.0), turned(-1.0), turned(0.2))):
        cameras = [complete(resolved, {**AROUND, **kind}), complete(resolved, {**to, **kind})]
        old, new = (ray_frame(camera, resolved.volume.grid, *SIZE) for camera in cameras)
        move = plan_move(old, new, SIZE, SIZE, bounds, 3)
        x, y, near, far = rng.uniform(size=(4, 500)) * [[SIZE[0]], [SIZE[1]], [50], [50]]
        near, far = np.minimum(near, far), np.maximum(near, far)
        ends = [moved(change_of_camera(old, new), old, new, x, y, s) for s in (near, far)]
        across, down, depth = np.subtract(ends[1], ends[0])
        least = np.abs(across) * move.numbers[25] + np.abs(down) * move.numbers[26]
        assert (least <= depth + 1e-3).all() and least.max() > 0.2 * depth.max()


def test_coarse_splats_leave_holes_and_larger_ones_none(context):
    pictures = {splat: Pictures(context, scene(splat=splat)) for splat in (1, 2)}
    roll = math.radians(20.0)
    away = np.subtract(AROUND["position"], AROUND["target"])
    away = away / np.linalg.norm(away)
    right = np.cross([0, 1, 0], away)
    right /= np.linalg.norm(right)
    up = math.cos(roll) * np.cross(away, right) + math.sin(roll) * right
    holes = {}
    for splat, each in pictures.items():
        each.show()
        holes[splat] = each.show({**AROUND, "up": up.tolist()})["holes"]
    assert holes[1] > 50 and holes[2] == 0


# ---- what could be late


def test_an_orbit(context):
    pictures = Pictures(context, scene())
    assert pictures.show()["reason"] == "the first picture"
    for step in range(1, 5):
        stats = pictures.show(turned(1.5 * step))
        assert_reused(stats)
    assert stats["samples"] < 0.95 * stats["from_hull"] and stats["samples_saved"] > 0


def test_far_places_do_not_show_through_near_ones_when_zooming_in(context):
    pictures = Pictures(context, scene(layers()))
    view = {"position": [27.5, 23.5, 200.0], "target": list(CENTRE), "fov_degrees": 20.0}
    pictures.show(view)
    assert_reused(pictures.show({**view, "fov_degrees": 12.0}))
    assert_reused(pictures.show({**view, "fov_degrees": 12.0, "position": [27.5, 23.5, 170.0]}))


def test_what_was_hidden_and_what_it_hides_behind(context):
    """The near bar moves off the far wall, and the bar half way comes out from behind it, in front of the wall."""
    pictures = Pictures(context, scene(layers()))
    view = {"position": [27.5, 23.5, 120.0], "target": list(CENTRE), "fov_degrees": 34.0}
    pictures.show(view)
    reused = 0
    for step in (1, 2, 3, 5, 8, 12, 8, 3):
        stats = pictures.show({**view, "position": [27.5 + 2.5 * step, 23.5 + step, 120.0]})
        reused += not stats["reinitialised"]
        assert stats["late_starts"] == 0
    assert reused > 4


def test_what_enters_where_nothing_was_seen(context):
    """A ball far off the axis comes into the picture, and in front of pixels that saw the background."""
    array = np.maximum(ball(6.0, (10, 24, 34)), ball(7.0, (44, 24, 5)))
    pictures = Pictures(context, scene(array))
    view = {"position": [27.5, 23.5, 110.0], "target": [40.0, 23.5, 19.5], "fov_degrees": 18.0}
    pictures.show(view)
    for step in range(1, 6):
        stats = pictures.show({**view, "target": [40.0 - 4.0 * step, 23.5, 19.5]})
        assert stats["late_starts"] == 0
    pictures.show({**view, "fov_degrees": 30.0})  # pixels whose rays were outside


def test_large_motion_and_another_size_start_afresh(context):
    pictures = Pictures(context, scene(size=(160, 140)))
    pictures.show()
    assert pictures.show(turned(1.0))["reason"] is None
    assert pictures.show(turned(100.0))["reason"] == "motion"
    assert pictures.show(turned(280.0))["reason"] == "motion"
    assert pictures.show(turned(280.0), scene(size=(70, 61)))["reason"] == "another size"


def test_parallel_rays_and_eyes_inside(context):
    pictures = Pictures(context, scene())
    flat = axis_camera(CENTRE, axis=2, height=60.0)
    pictures.show(flat)
    assert_reused(pictures.show({**flat, "height": 55.0}))
    assert_reused(pictures.show({**flat, "height": 55.0, "position": [29.0, 24.0, -20.5]}))
    assert pictures.show()["reason"] == "another projection"
    within = {"position": [27.5, 23.5, 38.0], "target": [27.0, 22.0, 0.0], "fov_degrees": 60.0}
    assert pictures.show(within)["reason"] == "the eye is inside"
    assert pictures.show({**within, "position": [27.5, 23.5, 37.9]})["reason"] == "the eye is inside"
    assert pictures.show()["reason"] == "the eye is inside"


def test_transfer_functions_that_show_less_and_more(context):
    first = scene()
    pictures = Pictures(context, first)
    pictures.show()
    assert_reused(pictures.show(scene=replace(first, transfer_function=FEWER)))
    recoloured = TransferFunction(FEWER.values, FEWER.opacities * 0.5, FEWER.colors[:, ::-1])
    assert_reused(pictures.show(scene=replace(first, transfer_function=recoloured, background=np.ones(3))))
    assert pictures.show(scene=first)["reason"] == "the transfer function shows more"


def test_what_else_must_not_change(context):
    pictures = Pictures(context, scene())
    pictures.show()
    assert pictures.show(scene=scene(step=0.7))["reason"] == "the volume changed"  # another array
    for name, how in (("the step", {"step": 0.5}), ("the filter", {"filter": "nearest"})):
        first = scene()
        pictures.show(scene=first)
        changed = replace(first, integration=first.integration.model_copy(update=how))
        assert pictures.show(scene=changed)["reason"] == f"{name} changed"


def test_what_makes_other_values_of_the_same_voxels():
    before = scene()
    for filter, name, values in (
        ("table", "filter_table", ((1.0, 0.7, 0.3, 0.0), (1.0, 0.5, 0.3, 0.0))),
        ("cubic", "prefilter", (False, True)),
    ):
        one, other = (
            replace(before, integration=before.integration.model_copy(update={"filter": filter, name: each}))
            for each in values
        )
        assert Facts.of(other).reason_afresh(Facts.of(one)) == "the filter changed", name
    apart = before.multiresolution.model_copy(update={"interblock": not before.multiresolution.interblock})
    changed = replace(before, multiresolution=apart)
    assert Facts.of(changed).reason_afresh(Facts.of(before)) == "the blocks changed"
    assert Facts.of(before).reason_afresh(Facts.of(before)) is None


@pytest.mark.slow  # a program of its own
def test_holes_in_the_volume(context):
    array = ball().astype(np.float32)
    array[::3, ::4, ::5] = np.nan
    pictures = Pictures(context, scene(array))
    pictures.show()
    for step in (1, 2):
        pictures.show(turned(step))


def test_late_starts_are_found_and_the_picture_is_repaired(context, monkeypatch):
    pictures = Pictures(context, scene(audit=4))
    pictures.show()
    monkeypatch.setattr(module, "step_back", lambda caster: -12.0)
    stats = pictures.show(turned(1.0))
    assert stats["late_starts"] > 20 and stats["samples"] > stats["from_hull"]
    for step in range(2, 10):
        assert pictures.show(turned(step))["reason"] == "starts were late"
    assert pictures.show(turned(10))["late_starts"] > 20


def test_where_starts_gain_nothing_pictures_are_rendered_without(context, monkeypatch):
    took = {"reused": 3.0, "plain": 2.0}
    monkeypatch.setattr(module, "LEAST_PIXELS", 1)
    real = module.MeasuredGain.took
    monkeypatch.setattr(
        module.MeasuredGain, "took",
        lambda self, seconds, reused: real(self, took["reused" if reused else "plain"], reused),
    )  # fmt: skip
    pictures = Pictures(context, scene())
    assert pictures.show()["reason"] == "the first picture"
    for step in range(1, 3):
        assert_reused(pictures.show(turned(0.5 * step)))
    for step in range(3, 7):
        assert pictures.show(turned(0.5 * step))["reason"] == "the gain is measured"
    monkeypatch.setattr(pictures.history.gain, "_rests", 4)  # of 128
    for _ in range(4):
        stats = pictures.show(turned(0.5 * step))
        assert stats["reason"] == "nothing is gained" and stats["mode"] == "cells"
    took["reused"] = 1.0
    assert pictures.show(turned(3.5))["reason"] == "the first picture"
    for step in range(8, 14):
        assert_reused(pictures.show(turned(0.5 * step)))


def turns(gain, reused, plain, pictures):
    """How many of so many pictures take starts, which take ``reused`` seconds, and ``plain`` without."""
    found = []
    for _ in range(pictures):
        found.append(gain.turn() is None)
        gain.took(reused if found[-1] else plain, found[-1])
    return sum(found)


def test_pauses_grow_while_nothing_is_gained_and_gains_are_measured_again():
    assert turns(MeasuredGain(), 1.25, 1.0, 90) == 2
    assert turns(MeasuredGain(), 1.25, 1.0, 2000) < 2000 * 0.005
    assert turns(MeasuredGain(), 0.99, 1.0, 90) == 2  # too little to be sure of
    assert turns(MeasuredGain(), 0.7, 1.0, 2000) > 2000 * 0.96
    gain = MeasuredGain()
    assert turns(gain, 0.7, 1.0, 300) > 280
    assert turns(gain, 1.4, 1.0, 600) < 150  # within the next measurement


def test_over_all_audits_every_packet_is_audited(context):
    resolved = scene()
    frames = [ray_frame(complete(resolved, camera), resolved.volume.grid, *SIZE) for camera in (AROUND, turned(0.5))]
    move = plan_move(*frames, SIZE, SIZE, (np.zeros(3), np.asarray(SHAPE[::-1]) - 1.0), 3)
    move = replace(move, inside=np.ones_like(move.inside))
    history, count = module.History(), np.zeros(SIZE[::-1], int)
    kept = np.full(SIZE[::-1], 3.0, np.float32)
    history.array("kept", kept.shape, lambda: context.upload(kept, writable=True))
    for _ in range(12):
        found = context.read(module.reproject(context, history, move, SIZE, 2.0, 12))
        count += np.isfinite(found) & ((found.view(np.int32) & 1) == 1)
    inside = count[MARGIN // 4 : -MARGIN // 4, MARGIN // 4 : -MARGIN // 4]
    assert (inside == 1).all()


def test_settings_that_take_no_starts_say_why(context):
    found = Raycaster(context, scene(quadrature="cells")).render(complete(scene(), AROUND), *SIZE)
    assert found.notes["coherence"] == {"mode": "cells", "reason": "quadrature by cells"}


# ---- surfaces, and other marches


def surfaces(*values, array=None, **how):
    found = scene(array, TransferFunction([0, 255], [0, 0], [[0, 0, 0]] * 2), **how)
    return replace(found, isosurfaces=tuple(Isosurface(value=v, opacity=0.6) for v in values))


def test_iso_values(context):
    array = ball()
    pictures = Pictures(context, surfaces(100.0, array=array))
    volume = pictures.scene.volume

    def now(*values):
        return replace(surfaces(*values, array=array), volume=volume)

    pictures.show(scene=now(100.0))
    assert_reused(pictures.show(turned(1.0)))
    assert_reused(pictures.show(turned(2.0), now(100.0, 200.0)))  # one more, behind
    assert_reused(pictures.show(turned(2.0), now(150.0)))
    assert pictures.show(turned(2.0), now(120.0))["reason"] == "the iso-values changed"
    inverted = 255 - array
    pictures = Pictures(context, surfaces(100.0, array=inverted))
    volume = pictures.scene.volume
    pictures.show(scene=now(100.0))
    assert pictures.show(scene=now(150.0))["reason"] == "the iso-values changed"  # rays begin above


@pytest.mark.slow  # programs of their own
@pytest.mark.parametrize(
    "how", ["preintegrated", "pre", "cubic", "lit", "clipped", "bent", "noisy", "both", "no leaps"]
)
def test_other_marches(context, how):
    from clvol.scene import Light
    from clvol.scene.clip import Clip
    from clvol.scene.noise import Noise

    start = scene(**{"preintegrated": {"classification": "preintegrated"}, "pre": {"classification": "pre"},
                     "cubic": {"filter": "cubic"}}.get(how, {}))  # fmt: skip
    light = {"lights": (Light(type="headlight"),)}
    if how in ("lit", "clipped"):
        start = replace(start, **light)
    if how == "clipped":
        start = replace(start, clips=(Clip(point=[27.5, 23.5, 19.5], normal=[-0.5, 0.2, -1.0]),))
    if how == "bent":
        start = replace(surfaces(100.0), isosurfaces=(Isosurface(value=100.0, opacity=0.0, refraction=1.4),
                                                       Isosurface(value=220.0)), **light)  # fmt: skip
    if how == "both":
        start = replace(start, isosurfaces=(Isosurface(value=90.0, opacity=0.3),), **light)
    if how == "noisy":
        start = replace(start, noise=(Noise(target="value", amplitude=20.0, frequency=2.0, velocity=[0, 1, 0]),))
    pictures = Pictures(context, start, **({"skip": False} if how == "no leaps" else {}))
    pictures.show()
    for step in (1, 2):
        stats = pictures.show(turned(0.8 * step))
        assert_reused(stats)
    if how == "no leaps":
        assert stats["samples"] < 0.6 * stats["from_hull"]
    if how == "noisy":
        later = start.animation.model_copy(update={"time": 0.5})
        assert pictures.show(scene=replace(start, animation=later))["reason"] == "the noise changed"
