"""One vocabulary in Python and in OpenCL C; what is called for, and what identifies a kernel."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
from helpers.feature_scenes import (
    ARRAY,
    CALLED,
    CLEAR,
    DARK,
    FADING,
    IDLE,
    IDLE_LABEL,
    LABELS,
    ONES,
    POINTS,
    SUN,
    WHITE,
    scene_with,
)  # fmt: skip
from helpers.paths import ROOT
from helpers.small_scenes import SMOOTH, make_scene, waves
from hypothesis import given, settings
from hypothesis import strategies as st

from clvol import Camera, TransferFunction, Volume
from clvol.device import noise, projection
from clvol.device.effect_state import COUNTERS, OPAQUE_DEPTH
from clvol.errors import SceneError
from clvol.explanation import explain, kernel_hash
from clvol.features import (
    CLASSIFICATIONS,
    COMPOSITINGS,
    FILTERS,
    GRADIENTS,
    NAMES,
    NEUTRAL,
    ORACLES,
    QUADRATURES,
    SLICES,
    STEPPINGS,
    called_for,
    effects,
    emits,
    is_lit,
    reduced,
    vocabulary,
)
from clvol.integrators.registry import check_scene
from clvol.opencl.kernels_path import kernel_folder
from clvol.opencl.structs import MOST_FIELDS, MOST_FILTER_TERMS, MOST_HALVES, MOST_NOISE_TERMS
from clvol.scene.pyramid import MOST_LEVELS
from clvol.volume.level_layout import MOST_VOLUME_LEVELS

COUNTED = {
    "effects.h": vocabulary.EFFECT_COUNTERS,
    "block_parameters.h": vocabulary.BLOCK_COUNTERS,
    "pyramid.h": vocabulary.PYRAMID_COUNTERS,
    "volume_levels.h": vocabulary.LEVEL_COUNTERS,
}
# Prefix of the names in cl/features.h: the table in Python.
VOCABULARY = {
    "FILTER": FILTERS, "CLASSIFICATION": CLASSIFICATIONS, "GRADIENT": GRADIENTS, "COMPOSITING": COMPOSITINGS,
    "QUADRATURE": QUADRATURES, "STEPPING": STEPPINGS, "SLICES": SLICES,
    "ACCUMULATE": vocabulary.ACCUMULATE, "ORACLE": ORACLES, "SHADOWS": vocabulary.SHADOW_METHODS,
    "DARKENS": vocabulary.DARKENS,
    "OPACITY_FACTOR": vocabulary.OPACITY_FACTORS, "FIELD": vocabulary.FIELD_ROLES,
    "LAYERS": vocabulary.TRANSFER_LAYERS, "NOISE_TARGET": vocabulary.NOISE_TARGETS,
    "LIGHT": vocabulary.LIGHTS, "CLIP": vocabulary.CLIPS,
    "CODEC": vocabulary.BLOCK_CODECS, "CELL": vocabulary.CELLS, "CODE": {"dropped": vocabulary.CODE_DROPPED},
    "MOST": {"fields": MOST_FIELDS, "noise-terms": MOST_NOISE_TERMS, "halves": MOST_HALVES, "levels": MOST_LEVELS,
             "filter-terms": MOST_FILTER_TERMS, "volume-levels": MOST_VOLUME_LEVELS},
}  # fmt: skip


def defined(header: str) -> dict[str, float]:
    """Numbers that a header of cl/ defines, by name."""
    text = (kernel_folder() / header).read_text()
    found = re.finditer(r"^#define (\w+) \(?(-?[\d.]+(?:e-?\d+)?)f?\)?(?= *(?:/\*|$))", text, re.MULTILINE)
    return {m[1]: float(m[2]) for m in found}


def spoken(name: str) -> str:
    return name.lower().replace("_", "-")


@pytest.mark.parametrize("prefix", VOCABULARY)
def test_the_vocabulary_is_one(prefix):
    found = {name: n for name, n in defined("features.h").items() if name.startswith(f"{prefix}_")}
    assert {spoken(name.removeprefix(f"{prefix}_")): n for name, n in found.items()} == VOCABULARY[prefix]


def test_every_name_of_the_header_is_in_the_vocabulary():
    known = {f"{prefix}_{word.upper().replace('-', '_')}" for prefix, table in VOCABULARY.items() for word in table}
    assert set(defined("features.h")) == known


@pytest.mark.parametrize("header", COUNTED)
def test_counters_are_in_one_order(header):
    found = {name: n for name, n in defined(header).items() if name.startswith("COUNT_")}
    expected = {f"COUNT_{name.upper()}": k for k, name in enumerate(COUNTED[header])}
    assert found == expected


def test_counters_of_effects_are_as_many_as_the_header_says():
    assert defined("effects.h")["EFFECT_COUNTERS"] == len(vocabulary.EFFECT_COUNTERS) == len(COUNTERS)
    assert defined("block_parameters.h")["BLOCK_COUNTERS"] == len(vocabulary.BLOCK_COUNTERS)
    assert defined("volume_levels.h")["LEVEL_COUNTERS"] == len(vocabulary.LEVEL_COUNTERS)


@pytest.mark.parametrize("header, name, here", [
    ("noise.h", "NOISE_TILE", noise.TILE),
    ("project.h", "BOUND_LEVELS", projection.LEVELS),
    ("project.h", "BOUND_SHIFT", projection.LEVEL_SHIFT),
    ("project.h", "NO_SCORE", projection.NO_SCORE),
    ("stretch.h", "OPAQUE_DEPTH", OPAQUE_DEPTH),
])  # fmt: skip
def test_constants_of_both_sides_are_the_same(header, name, here):
    assert np.float32(defined(header)[name]) == np.float32(here)


def reasons(resolved) -> dict[str, str]:
    return {effect.name: effect.reason for effect in effects(resolved)}


def parts(resolved) -> dict:
    """The parts of a resolved scene, to be compared with another's."""
    return {field.name: getattr(resolved, field.name) for field in fields(resolved)}


@pytest.fixture(scope="module")
def environment(tmp_path_factory) -> dict:
    path = tmp_path_factory.mktemp("environment") / "sky.exr"
    path.write_bytes(b"not read here")
    return {"file": str(path)}


# --- what is called for -------------------------------------------------------------------------

@pytest.mark.parametrize("tables, names", CALLED, ids=[" ".join(names) for _, names in CALLED])
def test_what_has_a_consequence_is_called_for_and_stays(tables, names):
    resolved = scene_with(**tables)
    expected = [name for name in NAMES if name in names]
    assert called_for(resolved) == ["emission-absorption", *expected]
    kept = reduced(resolved)
    for table in ("integration", "clips", "isosurfaces", "fields", "noise", "depth_cue",
                  "gradient_opacity", "directional_opacity", "transfer_layers", "lights",
                  "shadow", "ambient_occlusion", "animation", "gradient"):  # fmt: skip
        assert getattr(kept, table) == getattr(resolved, table)


def test_an_environment_lights_or_shows_or_both(environment):
    def called(**keys):
        return called_for(scene_with(environment=environment | keys))

    lit = ["lighting", "specular", "environment", "gradients"]
    assert called() == ["emission-absorption", *lit]
    assert called(visible=True) == [
        "emission-absorption", *lit[:3], "environment background", "gradients"
    ]  # fmt: skip
    assert called(intensity=0.0, visible=True) == ["emission-absorption"]
    behind = scene_with(function=CLEAR, environment=environment | {"visible": True})
    assert called_for(behind) == ["environment background"]
    assert reduced(behind).environment is not None and not is_lit(reduced(behind))


@pytest.mark.parametrize("mode", ["maximum", "minimum", "average", "attenuated-maximum"])
def test_a_projection_shows_values_alone(mode, environment):
    resolved = scene_with(
        integration={"compositing": mode}, light=[SUN], shadow={}, environment=environment,
        isosurface=[{"value": 100.0}], gradient_opacity=FADING, depth_cue={},
        transfer_layer=[{"magnitude": 3.0, "points": POINTS}],
        field=[{"file": LABELS, "role": "label", "labels": [{"label": 1, "color": WHITE}]}],
        clip=[{"point": (3.0, 0, 0), "normal": (1.0, 0, 0)}],
    )  # fmt: skip
    assert called_for(resolved) == ["projection", "clipping"]
    told = reasons(resolved)
    if mode == "maximum":
        assert told["lighting"] == told["specular"] == "maximum intensity projection is not lit"
    plain = scene_with(integration={"compositing": mode}, clip=resolved.clips)
    for classification in CLASSIFICATIONS:
        one = scene_with(integration={"compositing": mode, "classification": classification})
        assert reduced(one).integration == reduced(scene_with(
            integration={"compositing": mode, "classification": "post"})).integration  # fmt: skip
    assert switches(resolved) == switches(plain)


def test_nothing_attenuated_is_the_plain_maximum():
    asked = {"compositing": "attenuated-maximum", "attenuation": 0.0}
    assert reduced(scene_with(integration=asked)).integration.compositing == "maximum"
    asked = asked | {"attenuation": 0.1}
    kept = reduced(scene_with(integration=asked)).integration
    assert kept.compositing == "attenuated-maximum" and kept.attenuation == 0.1


def test_a_transparent_transfer_function_calls_for_nothing():
    hidden = scene_with(
        function=CLEAR, light=[SUN], shadow={}, depth_cue={}, gradient_opacity=FADING,
        clip=[{"point": (3.0, 0, 0), "normal": (1.0, 0, 0)}],
        noise=[{"target": "coordinate", "amplitude": 1.0}],
        field=[{"file": LABELS, "role": "mask"}],
    )  # fmt: skip
    assert called_for(hidden) == []
    told = reasons(hidden)
    assert told["emission-absorption"] == (
        "the transfer function is transparent over the data's range 0 to 255"
    )
    assert told["lighting"] == told["clipping"] == "nothing of the volume is visible"
    layered = scene_with(
        function=CLEAR, transfer_layer=[{"magnitude": 3.0, "points": POINTS}], light=[SUN]
    )
    assert emits(layered) and "lighting" in called_for(layered) and not emits(hidden)
    noisy = scene_with(function=CLEAR, noise=[{"target": "value", "amplitude": 1.0}])
    assert called_for(noisy) == ["emission-absorption", "noise"]  # values beyond 255


def test_a_volume_without_a_finite_voxel_calls_for_nothing():
    holes = Volume(np.full((3, 3, 3), np.nan, np.float32))
    empty = scene_with(holes, light=[SUN], isosurface=[{"value": 0.0}])
    assert called_for(empty) == []
    told = reasons(empty)
    assert told["emission-absorption"] == told["isosurfaces"] == "no voxel is finite"


def test_automatic_storage_of_gradients_says_what_it_is():
    few, many = (reduced(scene_with(Volume(ARRAY.astype(dtype)), light=[SUN]))
                 for dtype in (np.uint8, np.int16))  # fmt: skip
    assert "precomputed gradients" not in called_for(few)
    assert "which is on-the-fly for this volume" in reasons(few)["precomputed gradients"]
    assert "precomputed gradients" in called_for(many)
    assert "where the device has the memory" in reasons(many)["precomputed gradients"]


# --- reasons -----------------------------------------------------------------------------------

@pytest.mark.parametrize("tables, name, reason", IDLE, ids=[f"{i[1]}: {i[2]}" for i in IDLE])
def test_what_is_not_called_for_has_its_reason(tables, name, reason):
    resolved = scene_with(**tables)
    effect = next(e for e in effects(resolved) if e.name == name)
    assert not effect.called_for and reason in effect.reason


def test_environments_that_do_nothing_have_their_reasons(environment):
    dark = scene_with(environment=environment | {"intensity": 0.0, "visible": True})
    assert reasons(dark)["environment"] == "the environment's intensity is 0"
    assert reduced(dark).environment is None
    mirrorless = {"ambient": 0.5, "diffuse": 0.0, "specular": 0.0}
    dull = scene_with(light=[SUN], material=mirrorless, environment=environment)
    assert reasons(dull)["environment"] == "diffuse and specular are 0"
    assert reasons(dull)["environment background"] == "the environment is not visible"
    assert reduced(dull).environment is None


def test_every_effect_has_one_name_and_a_reason():
    listed = effects(scene_with())
    assert tuple(effect.name for effect in listed) == NAMES and len(set(NAMES)) == len(NAMES)
    assert all(effect.reason for effect in listed)


# --- opacity and gradients ---------------------------------------------------------------------


def lit(array, function=SMOOTH, **tables):
    return scene_with(Volume(array), function, light=[SUN], **tables)


UNLIT = "no voxel has both opacity and a gradient"


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 6, 1), (5, 5, 5)])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_constant_volume_is_not_lit(shape, dtype):
    resolved = lit(np.full(shape, 200, dtype), shadow={})
    assert reasons(resolved)["lighting"] == UNLIT
    assert reasons(resolved)["shadows"] == "the shadowing light reaches nothing lit"
    assert called_for(resolved) == ["emission-absorption"]


def plateaus(gap) -> np.ndarray:
    """200 everywhere in one half, 0 to 60 in the other, and ``gap`` between."""
    array = np.full((6, 6, 12), 200.0, np.float32)
    array[..., 6:] = np.linspace(0.0, 60.0, 6)
    array[..., 4:7] = gap
    return array


ABOVE_100 = TransferFunction([100, 150], [0, 0.5], [WHITE] * 2)


def test_an_opaque_part_without_a_gradient_beside_a_transparent_one_with_is_not_lit():
    apart = lit(plateaus(np.nan), ABOVE_100)
    assert reasons(apart)["lighting"] == UNLIT and called_for(apart) == ["emission-absorption"]
    joined = lit(plateaus(150.0), ABOVE_100)
    assert "lighting" in called_for(joined)


@pytest.mark.parametrize(
    "tables",
    [
        {"clip": [{"point": (2.5, 0, 0), "normal": (1, 0, 0)}]},  # has a face of its own
        {"field": [{"file": Volume(np.ones((6, 6, 12))), "role": "density", "points": POINTS}]},
        {"isosurface": [{"value": 50.0}]},
        {"integration": {"step": 1000.0}},  # a segment over all of it
    ],
)
def test_what_may_bring_opacity_to_a_gradient_keeps_the_light(tables):
    assert "lighting" in called_for(lit(plateaus(np.nan), ABOVE_100, **tables))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_samples_with_opacity_and_gradient_are_never_called_absent(data):
    """Against all samples of the linear filter on a fine lattice in small random volumes."""
    from scipy.ndimage import map_coordinates

    shape = data.draw(st.tuples(*[st.integers(2, 5)] * 3))
    levels = st.lists(st.integers(0, 3), min_size=math.prod(shape), max_size=math.prod(shape))
    array = np.array(data.draw(levels), np.uint8).reshape(shape)
    low = data.draw(st.floats(0.0, 3.0))
    function = TransferFunction([low, low, low + 0.4, low + 0.4], [0, 0.5, 0.5, 0], [WHITE] * 4)
    resolved = lit(array, function, integration={"classification": "post"})
    at = np.stack(np.meshgrid(*[np.linspace(0, n - 1, 4 * n - 3) for n in shape], indexing="ij"))
    value = map_coordinates(array.astype(float), at, order=1)
    gradient = [
        map_coordinates(np.gradient(array.astype(float), axis=k), at, order=1) for k in range(3)
    ]
    slope = np.abs(gradient).max(axis=0)
    if np.any((function.opacity(value) > 0) & (slope > 1e-9)):
        assert "lighting" in called_for(resolved)


# --- the reduced scene -------------------------------------------------------------------------


def switches(resolved) -> dict:
    from clvol.integrators.raycast.switches import raycast_switches

    return raycast_switches(reduced(resolved), lanes=16)


ADDITIONS = st.fixed_dictionaries(
    {},
    optional={
        "light": st.lists(
            st.sampled_from([DARK, {"type": "headlight", "intensity": 0.0}]), min_size=1, max_size=3
        ),
        "isosurface": st.lists(
            st.one_of(
                st.builds(dict, value=st.floats(256, 1e6), refraction=st.floats(0.5, 2)),
                st.builds(dict, value=st.floats(0, 255), opacity=st.just(0.0)),
            ),
            max_size=3,
        ),
        "clip": st.lists(
            st.one_of(
                st.builds(lambda x: {"point": (x, 0, 0), "normal": (1, 0, 0)}, st.floats(-9, 0)),
                st.builds(
                    lambda r: {"type": "sphere", "center": (4, 4, 4), "radius": r},
                    st.floats(9, 1e9),
                ),
                st.just({"type": "box", "lower": (0, 0, 0), "upper": (9, 8, 7)}),
            ),
            max_size=3,
        ),
        "material": st.builds(dict, specular=st.floats(0, 1), fade=st.floats(0, 9)),
        "gradient": st.sampled_from([{"operator": "sobel"}, {"storage": "precomputed"}]),
        "gradient_opacity": st.just({"points": [{"magnitude": 3, "opacity": 1}]}),
        "field": st.lists(
            st.sampled_from([IDLE_LABEL, {"file": ONES, "role": "mask"}]), max_size=3
        ),
        "noise": st.lists(
            st.builds(
                dict, target=st.sampled_from(["value", "coordinate"]), amplitude=st.just(0.0)
            ),
            max_size=3,
        ),
        "animation": st.builds(dict, time=st.integers(0, 9).map(float), cycle=st.just(2.0)),
        "depth_cue": st.builds(dict, start=st.floats(99, 999), strength=st.just(0.0)),
        "transfer_layer": st.just([]),
    },
)


@settings(max_examples=150, deadline=None)
@given(tables=ADDITIONS, shadowed=st.booleans())
def test_additions_without_a_consequence_reduce_to_the_plain_scene(tables, shadowed):
    if shadowed and tables.get("light"):
        tables = tables | {"shadow": {"scattering": 0.5}}
    plain, idle = scene_with(), scene_with(**tables)
    assert called_for(idle) == called_for(plain)
    assert switches(idle) == switches(plain)
    one, other = parts(reduced(idle)), parts(reduced(plain))
    # What no picture without the effects reads, or another resolution made anew.
    for name in ("source", "background", "animation", "camera"):
        one.pop(name), other.pop(name)
    assert one == other


@pytest.mark.parametrize("tables", [tables for tables, _ in CALLED] + [i[0] for i in IDLE])
def test_a_reduced_scene_has_nothing_to_reduce(tables):
    once = reduced(scene_with(**tables))
    again = replace(once)  # of which nothing is known
    assert reduced(again) is again
    assert called_for(again) == called_for(once)
    assert reduced(once) is once


@pytest.mark.parametrize("tables, names", CALLED, ids=[" ".join(names) for _, names in CALLED])
def test_the_reduced_scene_calls_for_the_same(tables, names):
    resolved = scene_with(**tables)
    assert called_for(reduced(resolved)) == called_for(resolved)
    assert is_lit(reduced(resolved)) == ("lighting" in names)


def test_only_what_does_something_is_kept_of_many():
    resolved = scene_with(
        light=[DARK, SUN],
        isosurface=[{"value": 300.0}, {"value": 100.0}],
        clip=[{"point": (-5, 0, 0), "normal": (1, 0, 0)}, {"point": (5, 0, 0), "normal": (1, 0, 0)},
              {"point": (5, 0, 0), "normal": (1, 0, 0)}],
        field=[IDLE_LABEL, {"file": LABELS, "role": "mask"}],
        noise=[{"target": "value", "amplitude": 0.0},
               {"target": "value", "amplitude": 1e-3, "octaves": 4, "gain": 0.0}],
    )  # fmt: skip
    kept = reduced(resolved)
    assert kept.lights == resolved.lights[1:] and kept.isosurfaces == resolved.isosurfaces[1:]
    assert kept.clips == resolved.clips[1:2] and kept.fields == resolved.fields[1:]
    assert [noise.octaves for noise in kept.noise] == [1]
    assert kept.volume is resolved.volume and kept.transfer_function is resolved.transfer_function


def test_an_analysis_is_made_once_a_scene_and_goes_with_it():
    import gc
    import weakref

    resolved = scene_with(light=[SUN, DARK])
    assert reduced(resolved) is reduced(resolved)
    assert effects(resolved)[0] is effects(resolved)[0]
    gone = weakref.ref(reduced(resolved))
    del resolved
    gc.collect()
    assert gone() is None


def test_nothing_is_lit_by_a_neutral_material():
    assert reduced(scene_with(material={"fade": 3.0})).material is NEUTRAL
    assert not is_lit(reduced(scene_with(light=[SUN], material=NEUTRAL)))


@pytest.mark.parametrize("filter, beyond", [("linear", 0.0), ("cubic", 0.0), ("catmull-rom", 0.47)])
def test_a_surface_beyond_the_voxels_is_there_if_the_filter_reaches_it(filter, beyond):
    def surfaces(value):
        asked = {"isosurface": [{"value": value}], "integration": {"filter": filter}}
        return reduced(scene_with(**asked)).isosurfaces

    assert surfaces(255.0 * (1.0 + beyond)) and surfaces(-255.0 * beyond)
    assert not surfaces(255.0 * (1.01 + beyond)) and not surfaces(-255.0 * (0.01 + beyond))
    values = {"value": 256.0}
    prefiltered = {"filter": "cubic", "prefilter": True}
    assert reduced(scene_with(isosurface=[values], integration=prefiltered)).isosurfaces


def test_depth_cues_are_kept_for_every_camera_of_an_orbit_and_for_bent_rays():
    camera = Camera(position=(4, 4, 40), target=(4, 4, -60))
    cue = {"start": 45.0, "end": 50.0}
    glass = {"isosurface": [{"value": 100.0, "opacity": 0.5, "refraction": 1.4}]}
    assert reduced(scene_with(camera=camera, depth_cue=cue)).depth_cue is None
    for more in ({"animation": {"orbit_degrees": 90.0}}, glass):
        assert reduced(scene_with(camera=camera, depth_cue=cue, **more)).depth_cue is not None


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_clips_and_fields_are_judged_on_turned_grids(axis, turn):
    c, s = math.cos(turn), math.sin(turn)
    direction = np.roll([[c, -s, 0], [s, c, 0], [0, 0, 1]], axis, axis=(0, 1))
    volume = Volume(ARRAY, direction=direction)
    corners = volume.grid.world_corners()
    centre = corners.mean(axis=0)
    radius = np.linalg.norm(corners - centre, axis=1).max()

    def kept(**clip):
        return len(reduced(scene_with(volume, clip=[clip])).clips)

    sphere = {"type": "sphere", "center": centre}
    assert kept(**sphere, radius=radius * 1.001) == 0
    assert kept(**sphere, radius=radius * 0.999) == 1
    # A small one beside the middle of a face, along the axis that the grid is turned about.
    normal = direction[:, (axis + 2) % 3]
    half = 0.5 * (volume.grid.size[(axis + 2) % 3] - 1)
    beside = {"type": "sphere", "radius": 1.0, "keep": "outside"}
    assert kept(**beside, center=centre + (half + 1.001) * normal) == 0
    assert kept(**beside, center=centre + (half + 0.999) * normal) == 1
    box = {"type": "box", "lower": corners.min(axis=0), "upper": corners.max(axis=0)}
    assert kept(**box) == 0 and kept(**box, keep="outside") == 1
    # In a corner of the box around the volume there is nothing of a turned one.
    corner = {"type": "box", "lower": box["lower"], "upper": box["lower"] + 0.5, "keep": "outside"}
    assert kept(**corner) == (0 if turn else 1)


# --- kernels -------------------------------------------------------------------------------------


def test_the_kernel_hash_tells_kernels_apart_and_nothing_else():
    array = waves((8, 8, 8), np.uint8)
    chords = {"classification": "preintegrated"}  # "auto" chooses by the step and the function
    plain = kernel_hash(make_scene(array, **chords))
    assert plain == kernel_hash(make_scene(array, width=7, step=0.3, table_size=300, **chords))
    other = TransferFunction([0, 255], [0, 0.5], [[1, 0, 0]] * 2)
    assert plain == kernel_hash(make_scene(array, other, camera={"projection": "orthographic"}, **chords))
    different = [
        make_scene(array, filter="nearest", **chords),
        make_scene(array, filter="cubic", **chords),
        make_scene(array, classification="post"),
        make_scene(array.astype(np.int16), **chords),
        make_scene(array, method="reference"),
        make_scene(array, method="reference", filter="cubic"),
    ]
    assert len({plain, *map(kernel_hash, different)}) == 7


def test_effects_without_a_consequence_compile_the_same_kernel():
    idle = [scene_with(**tables) for tables in (IDLE[1][0], IDLE[12][0], IDLE[17][0])]
    assert {kernel_hash(scene) for scene in idle} == {kernel_hash(scene_with())}
    told = explain(idle[0])
    assert told["kernel_hash"] == kernel_hash(scene_with())
    assert [e["name"] for e in told["effects"]] == list(NAMES)


@pytest.mark.parametrize(
    "tables, effect",
    [
        ({"light": [SUN]}, "lighting"),
        ({"isosurface": [{"value": 100.0}]}, "isosurfaces"),
        ({"clip": [{"point": (3, 0, 0), "normal": (1, 0, 0)}]}, "clipping"),
        ({"depth_cue": {}}, "depth cueing"),
    ],
)
@pytest.mark.parametrize("key, got", [("method", "reference"), ("quadrature", "cells")])
def test_what_integrates_emission_and_absorption_alone_refuses_the_rest(tables, effect, key, got):
    resolved = scene_with(**tables, integration={key: got})
    message = f"integration.{key}: got '{got}' in a scene that calls for {effect}, expected .*alone"
    with pytest.raises(SceneError, match=message):
        check_scene(resolved)
    check_scene(scene_with(**tables))
    check_scene(scene_with(integration={key: got}, light=[DARK]))


@pytest.mark.parametrize(
    "key, got",
    [("filter", "nearest"), ("quadrature", "cells"), ("classification", "pre"),
     ("classification", "post"), ("compositing", "maximum")],
)  # fmt: skip
def test_the_pyramid_refuses_what_it_is_not_rendered_by(key, got):
    check_scene(scene_with(integration={"method": "pyramid"}))
    with pytest.raises(SceneError, match="got .*pyramid"):
        check_scene(scene_with(integration={"method": "pyramid", key: got}))


def test_the_pyramid_refuses_oracles_that_nobody_has_and_sparse_rays():
    asked = {"integration": {"method": "pyramid"}}
    with pytest.raises(SceneError, match="pyramid.oracle: got 'delphi', expected 'minimum' or"):
        check_scene(scene_with(**asked, pyramid={"oracle": "delphi"}))
    with pytest.raises(SceneError, match="image.ray_spacing: got 2 with the method 'pyramid'"):
        check_scene(scene_with(**asked, image={"ray_spacing": 2}))
    check_scene(scene_with(pyramid={"oracle": "delphi"}))  # by no method that asks it


def test_the_reference_refuses_what_it_does_not_reconstruct():
    for asked in ({"filter": "catmull-rom"}, {"filter": "cubic", "prefilter": True},
                  {"compositing": "maximum"}):  # fmt: skip
        with pytest.raises(SceneError, match="method: got 'reference' in a scene that calls for"):
            check_scene(scene_with(integration={"method": "reference"} | asked))


@pytest.mark.parametrize(
    "key, got",
    [("filter", "nearest"), ("filter", "cubic"), ("quadrature", "cells"),
     ("classification", "pre"), ("voxel_precision", "uint8")],
)  # fmt: skip
def test_blocks_refuse_what_they_are_not_rendered_by(key, got):
    check_scene(scene_with(integration={"method": "multiresolution"}))
    with pytest.raises(SceneError, match="got .*multiresolution|got .*cells"):
        check_scene(scene_with(integration={"method": "multiresolution", key: got}))


def test_nothing_here_needs_a_device():
    """Effects and reduced scenes come without pyopencl being imported."""

    code = (
        "import sys, numpy, clvol; from clvol.features import effects, reduced;"
        "s = clvol.Scene(volume=clvol.Volume(numpy.ones((3, 3, 3)))).resolve();"
        "effects(s), reduced(s); sys.exit('pyopencl' in sys.modules)"
    )
    root = ROOT
    assert subprocess.run([sys.executable, "-c", code], cwd=root, timeout=300).returncode == 0
