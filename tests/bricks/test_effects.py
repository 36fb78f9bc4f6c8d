"""Effects in bricks are those of the whole volume to within 1e-6, and so are depths; what cannot be is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, make_scene, picture, waves

from clvol import Scene, TransferFunction, Volume
from clvol.bricks.render import bricks_of, render_in_bricks
from clvol.errors import SceneError

SIZE = (29, 26, 35)
RISING = TransferFunction([0, 255], [0.4, 1.0], [[0.2, 0.3, 1.0], [1.0, 0.5, 0.0]])
NOTHING = TransferFunction([0, 255], [0, 0], np.ones((2, 3)))
LIGHT = [
    {"type": "directional", "direction": [-1.0, -1.0, -0.5]},
    {"type": "point", "position": [40.0, 30.0, -20.0], "intensity": 0.6},
]
CLIP = [{"point": [17.3, 0.0, 0.0], "normal": [0.8, 0.2, 0.1]}]
CUE = {"color": [0.2, 0.3, 0.4], "start": 20.0, "end": 120.0}
SURFACES = [
    {"value": 120.0, "opacity": 0.6, "color": [1.0, 0.8, 0.3]},
    {"value": 180.0, "opacity": 1.0, "color": [0.3, 0.8, 1.0]},
]
# Along an axis, where surfaces of voxels, steps and faces of bricks lie in the same planes.
AXIS = {
    "projection": "orthographic", "position": [-40.0, 13.0, 14.0], "target": [17.0, 13.0, 14.0], "up": [0.0, 0.0, 1.0],
    "height": 20.0,
}  # fmt: skip
POINTS = [
    {"value": 0.0, "opacity": 0.0, "color": [1.0, 0.0, 0.0]}, {"value": 200.0, "opacity": 0.5, "color": [0.0, 1.0, 0.0]}
]  # fmt: skip


def noisy(dtype) -> np.ndarray:
    values = np.clip(waves(SIZE) + np.random.default_rng(3).normal(0, 6, SIZE), 0, 255)
    return np.round(values).astype(dtype) if np.dtype(dtype).kind in "iu" else values.astype(dtype)


def coarse() -> np.ndarray:
    """Voxels of a field on a grid of its own."""
    values = np.zeros((15, 13, 18), np.float32)
    values[5:12, 4:9, 6:14], values[2:6, 8:12, 2:9] = 1.0, 2.0
    return values


def scene_of(dtype, integration=None, function=None, gradient=None, associated=None, **tables):
    even = {"early_termination": 0.0, "step_error": 0.0, "classification": "preintegrated", **(integration or {})}
    resolved = Scene(
        volume=Volume(noisy(dtype)), transfer_function=associated or SMOOTH, image={"width": 24, "height": 20},
        integration=even, gradient={"storage": "on-the-fly", **(gradient or {})}, **tables,
    ).resolve()  # fmt: skip
    return resolved if function is None else replace(resolved, transfer_function=function)


def field_of(**keys):
    return [{"file": Volume(coarse(), spacing=(2.0, 2.0, 2.0)), **keys}]


SCENES = {
    "lights, a clip, a depth cue": lambda: scene_of(
        np.uint8, {"step": 0.7}, light=LIGHT, clip=CLIP, depth_cue=CUE
    ),
    "nothing else": lambda: scene_of(np.uint8),
    "post-classified": lambda: scene_of(np.float32, {"classification": "post", "step": 1.3}),
    "opacity by gradients": lambda: scene_of(
        np.float32, {"classification": "post"}, light=LIGHT,
        gradient_opacity={"points": [{"magnitude": 0.0, "opacity": 0.1}, {"magnitude": 20.0, "opacity": 1.0}]},
    ),
    "two-dimensional": lambda: scene_of(np.uint8, transfer_layer=[{"magnitude": 5.0, "points": POINTS}]),
    "cubic": lambda: scene_of(np.int16, {"classification": "post", "filter": "cubic"}, light=LIGHT),
    "sobel": lambda: scene_of(np.uint8, {"classification": "pre"}, gradient={"operator": "sobel"}, light=LIGHT),
    "a mask": lambda: scene_of(np.uint8, {"classification": "post"}, field=field_of(role="mask")),
    "a density": lambda: scene_of(np.uint8, field=field_of(role="density", points=POINTS)),
    "a maximum": lambda: scene_of(np.float32, {"compositing": "maximum"}, function=RISING, clip=CLIP),
    "a minimum": lambda: scene_of(np.uint8, {"compositing": "minimum", "filter": "cubic"}, function=RISING),
    "associated colours": lambda: scene_of(
        np.uint8, {"classification": "post"}, associated={"points": POINTS, "associated": True}
    ),
    "surfaces in a volume": lambda: scene_of(np.uint8, {"step": 0.8}, light=LIGHT, isosurface=SURFACES),
    "surfaces alone": lambda: scene_of(np.float32, light=LIGHT, isosurface=SURFACES, function=NOTHING),
    "clipped surfaces": lambda: scene_of(np.int16, {"classification": "post"}, isosurface=SURFACES, clip=CLIP),
    "surfaces between voxels": lambda: scene_of(
        np.uint8, {"classification": "post", "filter": "nearest", "step": 0.5}, isosurface=SURFACES, camera=AXIS
    ),
    "surfaces of cubics": lambda: scene_of(
        np.uint8, {"filter": "cubic"}, light=LIGHT, isosurface=SURFACES, function=NOTHING
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_effects_and_depths_in_bricks_are_those_of_the_whole(context, name):
    resolved = SCENES[name]()
    whole = picture(context, resolved)
    meets = np.isfinite(whole.depth)
    assert whole.rgba[..., 3].max() > 0.5 and 0 < meets.sum()
    for count in (2, 5, 12):
        rgba, depth, _ = render_in_bricks(context, resolved, count, depth=True)
        np.testing.assert_allclose(rgba, whole.rgba, rtol=1e-6, atol=1e-6)  # associated colours exceed 1
        np.testing.assert_array_equal(np.isfinite(depth), meets)
        np.testing.assert_allclose(depth[meets], whole.depth[meets], rtol=1e-6)


@pytest.mark.parametrize(
    ("tables", "told"),
    [
        ({"light": LIGHT, "shadow": {}}, "shadow: got it for bricks, and light comes to a brick through all others"),
        ({"isosurface": [{**SURFACES[0], "refraction": 1.3}]}, "isosurface.refraction: got it for bricks"),
        ({"noise": [{"target": "value", "amplitude": 5.0}]}, "noise: got it for bricks"),
    ],
)
def test_what_depends_on_other_bricks_is_refused_with_its_reason(tables, told):
    with pytest.raises(SceneError, match=told):
        bricks_of(scene_of(np.uint8, **tables), 2)


def test_gradients_are_taken_where_they_are_needed(context):
    """Stored ones would need all voxels; a scene that requests nothing is rendered as with gradients on the fly."""
    stored = scene_of(np.float32, light=LIGHT, gradient={"storage": "auto"})
    fly = replace(stored, gradient=stored.gradient.model_copy(update={"storage": "on-the-fly"}))
    one, other = (bricks_of(each, 2).resolved.gradient for each in (stored, fly))
    assert one == other == fly.gradient


def test_sizes_and_types_are_refused():
    with pytest.raises(SceneError, match="float64"):
        bricks_of(make_scene(waves(SIZE, np.float64)), 2)
    with pytest.raises(SceneError, match="9 bricks of so small a volume, expected at most"):
        bricks_of(make_scene(waves((4, 4, 4), np.uint8)), 9)
