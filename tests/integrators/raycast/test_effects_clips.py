"""Clip planes, boxes and spheres: exact chords, cut faces; the kernels against the twin."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import LIGHTS, MATERIAL, blobs, oblique, picture, scene, twin
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from clvol import TransferFunction

SHAPE = (15, 17, 19)
UPPER = np.array(SHAPE[::-1]) - 1.0
CAMERA = oblique(SHAPE)
LIT = {"light": LIGHTS, "material": MATERIAL, "gradient": {"storage": "on-the-fly"}}
ROUNDING = 3e-5
TAU = 0.05  # extinction of the uniform haze, whose opacity tells the length of what is kept
HAZE = TransferFunction([0.0], [1.0 - np.exp(-TAU)], [[1.0, 0.5, 0.25]])
PLANE = {"point": [9.0, 8.0, 7.0], "normal": [1.0, 0.4, -0.3]}
BOX = {"type": "box", "lower": [3.2, 4.1, 2.2], "upper": [14.3, 12.4, 11.1]}
BALL = {"type": "sphere", "center": [9.0, 8.0, 6.5], "radius": 6.0}
HOLES = [
    {"type": "sphere", "center": [9.0, 8.0, 5.0], "radius": 5.0, "keep": "outside"},
    {"type": "box", "lower": [6.2, 4.1, 2.2], "upper": [20.3, 12.4, 11.1], "keep": "outside"},
]


def chords(resolved, clips, samples=10001) -> np.ndarray:
    """Kept lengths [height, width]: ``samples`` places of each ray, asked what they are in."""
    origins, directions = resolved.camera.world_rays(resolved.image.width, resolved.image.height)
    reach = np.linalg.norm(np.array(resolved.camera.position) - UPPER / 2) + np.linalg.norm(UPPER)
    t = (np.arange(samples) + 0.5) / samples * reach
    kept = np.zeros(origins.shape[:2])
    for pixel in np.ndindex(kept.shape):
        at = origins[pixel] + t[:, None] * directions[pixel]
        inside = np.all((at >= 0) & (at <= UPPER), axis=1)
        for clip in clips:
            inside &= keeps(clip, at)
        kept[pixel] = inside.sum() * reach / samples
    return kept


def keeps(clip, at) -> np.ndarray:
    kind = clip.get("type", "plane")
    if kind == "plane":
        return (at - np.array(clip["point"])) @ np.array(clip["normal"]) >= 0
    if kind == "sphere":
        inside = np.sum((at - np.array(clip["center"])) ** 2, axis=1) <= clip["radius"] ** 2
    else:
        inside = np.all((at >= clip["lower"]) & (at <= clip["upper"]), axis=1)
    return inside == (clip.get("keep", "inside") == "inside")


def check_chords(context, clips, camera=CAMERA, slack=5, samples=10001, **integration):
    """Opacity is 1 - exp(-TAU kept length). ``slack``: places of a ray where chords begin and end,
    each known to a place of ``chords``; one more for float32."""
    resolved = scene(np.zeros(SHAPE, np.float32), HAZE, camera=camera, clip=clips,
                     size=(13, 11), integration=integration)  # fmt: skip
    found = picture(context, resolved).rgba[..., 3]
    expected = chords(resolved, clips, samples)
    reach = np.linalg.norm(np.array(resolved.camera.position) - UPPER / 2) + np.linalg.norm(UPPER)
    np.testing.assert_allclose(-np.log1p(-found.astype(float)) / TAU, expected, rtol=0,
                               atol=slack * reach / samples + 1e-3)  # fmt: skip
    return found


CASES = {"plane": [PLANE], "box": [BOX], "sphere": [BALL], "holes": [*HOLES, PLANE]}


@pytest.mark.parametrize("clips", CASES)
def test_what_is_kept_has_the_lengths_of_its_chords(context, clips):
    found = check_chords(context, CASES[clips])
    assert 0.1 < np.mean(found > 0) < 1.0
    check_chords(context, CASES[clips], step=3.7)


HARD = {
    "holes that touch": [
        {**HOLES[1], "lower": [3.0, 3.0, 3.0], "upper": [9.0, 12.0, 12.0]},
        {**HOLES[1], "lower": [9.0, 3.0, 3.0], "upper": [14.0, 12.0, 12.0]},
    ],
    "a hole in a hole": [HOLES[0], {**HOLES[0], "radius": 2.0}],
    "a chain of holes": [
        {**HOLES[0], "center": [x, x * 0.9, 14 - 0.8 * x], "radius": 2.4} for x in range(3, 19, 3)
    ],
    "everything removed": [{**HOLES[0], "radius": 40.0}],
    "nothing left": [PLANE, {**PLANE, "normal": [-1.0, -0.4, 0.3]}],
    "a shell": [BALL, {**BALL, "radius": 4.5, "keep": "outside"}],
    "on the domain's faces": [{"type": "box", "lower": [0, 0, 0], "upper": [18.0, 8.0, 14.0]}],
    "far away": [
        {"point": [1e28, 8.0, 7.0], "normal": [-1.0, 0.0, 0.0]},
        {"point": [9.0 + 1e7, 8.0 - 1e7, 7.0], "normal": [1.0, 1.0, 0.0]},
        {"type": "box", "lower": [-1e25] * 3, "upper": [1e25, 14.0, 1e25]},
        {"type": "sphere", "center": [1e25] * 3, "radius": 1.0, "keep": "outside"},
    ],
}  # fmt: skip
INSIDE = {"position": [9.3, 8.1, 5.4], "target": [2.0, 3.0, 15.0], "up": [0, 1, 0],
          "fov_degrees": 80.0}  # fmt: skip


@pytest.mark.parametrize("camera", [CAMERA, INSIDE], ids=["outside", "inside"])
@pytest.mark.parametrize("clips", HARD)
def test_awkward_clips_have_the_lengths_of_their_chords(context, clips, camera):
    check_chords(context, HARD[clips], camera, slack=14)


@st.composite
def clip_lists(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**31)))
    clips = []
    for _ in range(draw(st.integers(1, 6))):
        kind = draw(st.sampled_from(["plane", "box", "sphere"]))
        at = rng.uniform(-2, 20, 3)
        keep = {} if kind == "plane" else {"keep": draw(st.sampled_from(["inside", "outside"]))}
        if kind == "plane":  # mostly keeps the middle
            normal = rng.normal(size=3)
            normal *= np.sign((UPPER / 2 - at) @ normal)
            numbers = {"point": at.tolist(), "normal": normal.tolist()}
        elif kind == "box":
            size = rng.uniform(3, 14, 3) * (1.0 if keep["keep"] == "outside" else 2.0)
            numbers = {"lower": (at - size / 2).tolist(), "upper": (at + size / 2).tolist()}
        else:
            radius = rng.uniform(2, 7) * (1.0 if keep["keep"] == "outside" else 2.0)
            numbers = {"center": at.tolist(), "radius": float(radius)}
        clips.append({"type": kind, **numbers, **keep})
    position = (UPPER / 2 + rng.normal(size=3) * draw(st.sampled_from([0.5, 20.0]))).tolist()
    camera = {"position": position, "target": (UPPER / 2 + rng.normal(size=3)).tolist(),
              "up": rng.normal(size=3).tolist(), "fov_degrees": 50.0}  # fmt: skip
    return clips, camera


def test_random_clips_have_the_lengths_of_their_chords(context):
    @settings(max_examples=15, deadline=None, derandomize=True, database=None,
              suppress_health_check=[HealthCheck.too_slow])  # fmt: skip
    @given(clip_lists())
    def check(case):
        found = check_chords(context, *case, slack=16, samples=6001)
        seen.append((found > 0).mean())

    seen: list = []
    check()
    assert np.mean(np.array(seen) > 0.1) > 0.4


def test_a_clip_of_the_whole_domain_changes_nothing(context):
    """Whichever side rounding puts the domain's own faces on: none of them is a cut face."""
    whole = {"type": "box", "lower": [0.0, 0.0, 0.0], "upper": UPPER.tolist()}
    for keys in ({}, LIT):
        plain = scene(blobs(SHAPE), camera=CAMERA, **keys)
        clipped = scene(blobs(SHAPE), camera=CAMERA, **keys, clip=[whole])
        one, other = picture(context, plain).rgba, picture(context, clipped).rgba
        np.testing.assert_allclose(other, one, rtol=0, atol=1e-5)


VARIANTS = {
    "plane": {"clip": [PLANE]},
    "box": {"clip": [BOX]},
    "sphere": {"clip": [BALL]},
    "holes": {"clip": [*HOLES, PLANE]},
    "one-sided": {"clip": [BOX, HOLES[0]], "material": {**MATERIAL, "two_sided": False}},
    "fading": {"clip": [BOX, HOLES[0]], "material": {**MATERIAL, "fade": 0.1}},
    "fine steps": {"clip": [BOX, HOLES[0]], "integration": {"step": 0.23}},
    "preintegrated": {
        "clip": [BALL, {**BALL, "radius": 3.0, "keep": "outside"}],
        "integration": {"classification": "preintegrated"},
    },
    "surfaces and a cue": {
        "clip": [PLANE, HOLES[0]],
        "isosurface": [{"value": 0.5, "opacity": 0.6, "color": [0.9, 0.3, 0.2], "refraction": 1.2}],
        "depth_cue": {"strength": 0.5, "color": [0.0, 0.0, 0.5]},
    },
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_lit_and_clipped_pictures_are_the_twins(context, variant):
    resolved = scene(blobs(SHAPE), camera=CAMERA, **{**LIT, **VARIANTS[variant]})
    expected = twin(resolved)
    found = picture(context, resolved).rgba
    assert expected[..., 3].mean() > 0.03
    apart = np.abs(found - expected).max(axis=-1)
    if variant == "surfaces and a cue":  # see test_effects_surfaces.py
        assert np.mean(apart > 1e-3) < 0.004
    else:
        assert apart.max() <= ROUNDING


def test_a_cut_face_of_a_uniform_block_is_lit_by_the_clips_normal(context):
    """Within one edge of it, where there is no gradient; beyond, nothing is shaded."""
    clip = {"point": [0.0, 0.0, 4.0], "normal": [0.0, 0.0, 2.5]}
    angle = np.radians(40.0)
    light = {"type": "directional", "direction": [np.sin(angle), 0.0, np.cos(angle)]}
    material = {"ambient": 0.15, "diffuse": 0.6, "specular": 0.0}
    camera = {"projection": "orthographic", "position": [9.0, 8.0, -9.0], "target": [9.0, 8.0, 7.0],
              "up": [0.0, 1.0, 0.0], "height": 8.0}  # fmt: skip
    resolved = scene(np.zeros(SHAPE, np.float32), HAZE, camera=camera, clip=[clip], light=[light],
                     material=material, integration={"step": 0.25})  # fmt: skip
    rgba = picture(context, resolved).rgba
    share = 0.15 + 0.6 * np.cos(angle)
    lit = (1 - np.exp(-TAU)) * share + (np.exp(-TAU) - np.exp(-10 * TAU))
    np.testing.assert_allclose(rgba[..., 3], 1 - np.exp(-10 * TAU), atol=3e-6)
    np.testing.assert_allclose(rgba[..., 0], lit, atol=3e-6)
