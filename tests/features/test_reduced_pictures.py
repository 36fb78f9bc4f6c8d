"""A reduced scene has the picture of the whole one: by the twin, which knows nothing of reduction."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.feature_scenes import CALLED, CLEAR, FADING, FAR, IDLE, IDLE_LABEL, LABELS, ONES, POINTS, SUN
from helpers.small_scenes import SMOOTH, waves
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import render_twin

from clvol import Camera, Volume
from clvol.features import reduced
from clvol.scene import ImageSettings, Scene

VOLUME = Volume(waves((8, 9, 10), np.uint8))
SKY = np.random.default_rng(1).random((8, 16, 3)).astype(np.float32)
TILE = np.random.default_rng(2).integers(0, 256, (8, 8, 8, 4), dtype=np.uint8)
CAMERA = Camera(position=(14.0, 9.0, -15.0), target=(4.5, 4.0, 3.5), fov_degrees=40)
FLAT = Volume(np.full((8, 9, 10), 200, np.uint8))


def same_picture(tables, volume=VOLUME, function=SMOOTH) -> None:
    if "shadow" in tables:  # coarse: the twin is slow
        tables = tables | {"shadow": tables["shadow"] | {"resolution": 4, "step": 2.0}}
    if "ambient_occlusion" in tables:
        coarse = {"resolution": 4, "directions": 8, "step": 2.0}
        tables = tables | {"ambient_occlusion": {**tables["ambient_occlusion"], **coarse}}
    tables = dict(tables)
    function = tables.pop("function", function)
    scene = Scene(
        volume=volume, transfer_function=function, camera=CAMERA,
        image=ImageSettings(width=7, height=6),
        **{"integration": {"early_termination": 0.0}, **tables},
    ).resolve()  # fmt: skip
    maps = {"environment_map": SKY, "noise_tile": TILE}
    pictures = [render_twin(s, **maps) for s in (scene, reduced(scene))]
    np.testing.assert_allclose(pictures[1], pictures[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("tables", [tables for tables, _ in CALLED])
def test_a_scene_with_an_effect_keeps_its_picture(tables):
    if tables.get("integration", {}).get("filter") == "table":
        pytest.skip("the twin has no filters by tables, from which reduction takes nothing away")
    same_picture(tables)


@pytest.mark.parametrize("tables, name, reason", IDLE, ids=[f"{i[1]}: {i[2]}" for i in IDLE])
def test_a_scene_with_an_idle_effect_keeps_its_picture(tables, name, reason):
    same_picture(tables)


@pytest.fixture(scope="module")
def sky_file(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("sky") / "sky.exr"
    path.write_bytes(b"its picture is handed over")
    return str(path)


LIGHT = st.one_of(
    st.builds(
        dict, type=st.just("directional"), direction=st.just((1.0, -1.0, 0.5)),
        intensity=st.sampled_from([0.0, 1.0]), casts_shadow=st.booleans(),
    ),
    st.builds(dict, type=st.just("headlight"), color=st.sampled_from([(0, 0, 0), (1, 0.5, 0.2)])),
    st.builds(dict, type=st.just("point"), position=st.just((20.0, 3.0, -4.0))),
)  # fmt: skip
SURFACE = st.builds(
    dict, value=st.sampled_from([-1.0, 0.0, 90.0, 200.0, 255.0, 280.0]),
    opacity=st.sampled_from([0.0, 0.4, 1.0]), refraction=st.sampled_from([1.0, 1.0, 1.3]),
)  # fmt: skip
# The twin cuts segments at a clear surface that bends nothing, which moves its samples.
SURFACE = SURFACE.filter(lambda s: s["opacity"] or s["refraction"] != 1)
CLIP = st.sampled_from([
    {"point": (-1, 0, 0), "normal": (1, 0.1, 0)},
    {"point": (4, 4, 4), "normal": (1, 0.5, -1)},
    {"point": (40, 4, 4), "normal": (1, 0, 0)},
    {"type": "box", "lower": (2, 1, 1), "upper": (7, 20, 6), "keep": "outside"},
    {"type": "sphere", "center": (4, 4, 4), "radius": 30},
    {"type": "sphere", "center": (0, 0, 0), "radius": 4, "keep": "outside"},
])  # fmt: skip
FIELD = st.sampled_from([
    IDLE_LABEL,
    IDLE_LABEL | {"labels": [{"label": 1, "color": (1, 0, 0), "opacity": 0.5}]},
    IDLE_LABEL | {"file": FAR, "labels": [{"label": 0, "color": (1, 0, 0)}]},
    {"file": LABELS, "role": "density", "points": POINTS},
    {"file": FAR, "role": "density", "points": POINTS},
    {"file": ONES, "role": "mask"},
    {"file": FAR, "role": "mask"},
    {"file": LABELS, "role": "mask", "keep": "below"},
])  # fmt: skip
TABLES = st.fixed_dictionaries(
    {
        "integration": st.builds(
            dict, early_termination=st.just(0.0), attenuation=st.sampled_from([0.0, 1.0]),
            compositing=st.sampled_from(
                ["over"] * 5 + ["maximum", "average", "attenuated-maximum"]
            ),
            classification=st.sampled_from(["pre", "post", "preintegrated"]),
            filter=st.sampled_from(["nearest", "linear", "cubic", "catmull-rom"]),
        ),
        "light": st.lists(LIGHT, max_size=2),
        "isosurface": st.lists(SURFACE, max_size=2),
        "clip": st.lists(CLIP, max_size=2),
        "field": st.lists(FIELD, max_size=2),
        "material": st.builds(
            dict, ambient=st.sampled_from([0.1, 1.0]), diffuse=st.sampled_from([0.0, 0.6]),
            specular=st.sampled_from([0.0, 0.3]), fade=st.sampled_from([0.0, 20.0]),
        ),
    },
    optional={
        "shadow": st.builds(dict, scattering=st.sampled_from([0.0, 0.5])),
        "ambient_occlusion": st.builds(dict, directions=st.just(8), resolution=st.just(5), distance=st.just(4.0),
                                       intensity=st.sampled_from([0.0, 0.6])),
        "gradient_opacity": st.sampled_from(
            [FADING, {"points": [{"magnitude": m, "opacity": o} for m, o in ((800, 1), (900, 0))]}]
        ),
        "transfer_layer": st.just([{"magnitude": 30.0, "points": POINTS}]),
        "depth_cue": st.builds(dict, start=st.sampled_from([10.0, 33.0]), end=st.just(35.0)),
        "noise": st.lists(
            st.builds(dict, target=st.sampled_from(["value", "coordinate"]),
                      amplitude=st.sampled_from([0.0, 2.0])),
            max_size=2,
        ),
        "animation": st.builds(dict, time=st.sampled_from([0.0, 0.3, 2.0]), cycle=st.just(0.5)),
        "environment": st.builds(dict, visible=st.booleans(),
                                 intensity=st.sampled_from([0.0, 1.0])),
    },
)  # fmt: skip


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(tables=TABLES, varies=st.integers(0, 4), clear=st.integers(0, 4))
def test_any_scene_keeps_its_picture(sky_file, tables, varies, clear):
    if "environment" in tables:
        tables["environment"]["file"] = sky_file
    if "shadow" in tables and not tables["light"]:
        tables["light"] = [SUN]
    # An analytic derivative of a constant is 0 but for rounding, of which the twin makes a normal.
    varies = varies or tables["integration"]["filter"] in ("cubic", "catmull-rom")
    same_picture(tables, VOLUME if varies else FLAT, SMOOTH if clear else CLEAR)
