"""The tables of effects: every key arrives and reads back, and every mistake is one line."""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import clvol
from clvol.errors import SceneError
from clvol.scene import FieldSettings, GradientOpacity, OpacityFactor, Scene, load_scene
from clvol.transfer import srgb_to_linear

CUBE = np.arange(64, dtype=np.uint8).reshape(4, 4, 4)
FULL = """\
version = 1
[volume]
file = "cube.npy"
[camera]
position = [1.5, 1.5, -10.0]
target = [1.5, 1.5, 1.5]
[transfer_function]
opacity_unit = 2.0
points = [
  { value = 0.0,  opacity = 0.0, color = [0.0, 0.0, 0.0] },
  { value = 60.0, opacity = 0.5, color = [0.9, 0.6, 0.3] },
]
[integration]
filter = "cubic"
prefilter = true
compositing = "attenuated-maximum"
attenuation = 2.5
[gradient]
operator = "sobel"
storage = "on-the-fly"
[material]
two_sided = false
fade = 0.25
[[light]]
type = "headlight"
casts_shadow = false
[[light]]
type = "directional"
direction = [0, 0, 1]
[[isosurface]]
value = 30
back_color = [0.5, 0.25, 0.0]
refraction = 1.33
[environment]
file = "maps/sky.exr"
layout = "cube"
intensity = 2.0
rotation_degrees = 90
visible = true
[shadow]
method = "volume"
resolution = 32
step = 0.5
bound = 0.01
scattering = 0.4
scatter_color = [0.9, 0.5, 0.25]
cone_degrees = 45
[gradient_opacity]
points = [{ magnitude = 0, opacity = 0.0 }, { magnitude = 4.5, opacity = 1.0 }]
[directional_opacity]
points = [{ derivative = 1, opacity = 0.5 }, { derivative = 1, opacity = 1 }]
[[transfer_layer]]
magnitude = 2.0
points = [{ value = 0, opacity = 0.1, color = [0.5, 0.5, 0.5] }]
[[transfer_layer]]
magnitude = 4.0
points = [{ value = 1, opacity = 0.2, color = [0.25, 0.5, 0.5] }]
[[field]]
file = "cube.npy"
role = "label"
labels = [{ label = 7, color = [1, 0, 0] }, { label = 3, color = [0, 0.5, 0], opacity = 0.25 }]
[[field]]
file = "cube.npy"
role = "density"
points = [{ value = 0, opacity = 0.5, color = [0.5, 0.5, 1] }]
[[field]]
file = "other.npy"
role = "mask"
threshold = 3
keep = "below"
[[clip]]
point = [0, 0, 0]
normal = [1, 0, 0]
[[clip]]
type = "box"
lower = [0, 0, 0]
upper = [1, 2, 3]
keep = "outside"
[[clip]]
type = "sphere"
center = [1, 1, 1]
radius = 2.5
[[noise]]
target = "coordinate"
amplitude = 0.5
frequency = 2.0
octaves = 3
gain = 0.25
seed = 7
velocity = [0.5, 0, -1]
[depth_cue]
start = 9.0
strength = 0.75
color = [0.5, 0.5, 0.5]
[animation]
time = 1.5
frames = 50
fps = 24
cycle = 0.25
orbit_degrees = 360
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("scenes")
    (path / "maps").mkdir()
    (path / "maps" / "sky.exr").write_bytes(b"looked up, not read")
    np.save(path / "cube.npy", CUBE)
    np.save(path / "other.npy", CUBE.astype(np.float32))
    return path


@pytest.fixture(scope="module")
def scene_file(folder) -> Path:
    path = folder / "scene.toml"
    path.write_text(FULL, encoding="utf-8")
    return path


def test_every_key_of_every_effect_arrives(scene_file, folder):
    resolved = load_scene(scene_file).resolve()
    integration = resolved.integration
    assert (integration.compositing, integration.attenuation) == ("attenuated-maximum", 2.5)
    assert integration.filter == "cubic" and integration.prefilter
    assert (resolved.gradient.operator, resolved.gradient.storage) == ("sobel", "on-the-fly")
    assert not resolved.material.two_sided and resolved.material.fade == 0.25
    assert [light.casts_shadow for light in resolved.lights] == [False, True]
    surface = resolved.isosurfaces[0]
    np.testing.assert_array_equal(surface.back_color, srgb_to_linear([0.5, 0.25, 0.0]))
    assert surface.refraction == 1.33
    sky = resolved.environment
    assert sky.path == folder / "maps" / "sky.exr" and sky.path.is_file()
    assert (sky.layout, sky.intensity, sky.rotation_degrees, sky.visible) == ("cube", 2, 90, True)
    shadow = resolved.shadow
    assert (shadow.method, shadow.resolution) == ("volume", 32)
    assert (shadow.step, shadow.bound) == (0.5, 0.01)
    assert shadow.scatter_color == (0.9, 0.5, 0.25)  # linear light
    assert (shadow.scattering, shadow.cone_degrees) == (0.4, 45)
    np.testing.assert_array_equal(resolved.gradient_opacity.at, [0, 4.5])
    np.testing.assert_array_equal(resolved.gradient_opacity.factors, [0, 1])
    np.testing.assert_array_equal(resolved.directional_opacity.at, [1, 1])
    first, second = resolved.transfer_layers
    assert (first.magnitude, second.magnitude) == (2, 4)
    assert first.function.opacity_unit == second.function.opacity_unit == 2.0
    np.testing.assert_array_equal(first.function.colors, srgb_to_linear([[0.5] * 3]))
    assert [clip.type for clip in resolved.clips] == ["plane", "box", "sphere"]
    assert resolved.clips[1].upper == (1, 2, 3) and resolved.clips[1].keep == "outside"
    assert resolved.clips[2].radius == 2.5 and resolved.clips[2].keep == "inside"
    (noise,) = resolved.noise
    assert (noise.target, noise.amplitude, noise.frequency) == ("coordinate", 0.5, 2.0)
    assert (noise.octaves, noise.gain, noise.seed) == (3, 0.25, 7)
    assert noise.velocity == (0.5, 0, -1)
    animation = resolved.animation
    assert (animation.time, animation.frames, animation.fps) == (1.5, 50, 24)
    assert (animation.cycle, animation.orbit_degrees) == (0.25, 360)


def test_fields_arrive_with_their_volumes(scene_file):
    label, density, mask = load_scene(scene_file).resolve().fields
    assert [field.role for field in (label, density, mask)] == ["label", "density", "mask"]
    assert label.labels.tolist() == [3, 7] and label.factors.tolist() == [0.25, 1.0]
    np.testing.assert_array_equal(label.colors, srgb_to_linear([[0, 0.5, 0], [1, 0, 0]]))
    assert density.function.opacity_unit == 2.0
    np.testing.assert_array_equal(density.function.colors, srgb_to_linear([[0.5, 0.5, 1]]))
    assert (mask.threshold, mask.keep) == (3, "below")
    assert label.volume is density.volume  # read once
    assert mask.volume.dtype == np.float32


def test_a_scene_without_the_tables_has_none_of_the_effects(folder):
    resolved = load_scene(folder / "cube.npy").resolve()
    assert resolved.environment is resolved.shadow is resolved.depth_cue is None
    assert resolved.gradient_opacity is resolved.directional_opacity is None
    assert resolved.transfer_layers == resolved.fields == resolved.noise == ()
    assert resolved.integration.compositing == "over" and not resolved.integration.prefilter
    assert resolved.gradient.operator == "central" and resolved.gradient.storage == "auto"
    assert resolved.animation.time == resolved.animation.cycle == 0


def test_a_surface_without_a_back_color_has_that_of_its_front(folder):
    scene = load_scene(folder / "cube.npy", ["isosurface=[{value=3, color=[0.5, 0.25, 0]}]"])
    surface = scene.resolve().isosurfaces[0]
    assert surface.back_color == surface.color == tuple(srgb_to_linear([0.5, 0.25, 0]))


def test_a_field_may_be_a_volume_in_memory(folder):
    volume = clvol.Volume(CUBE)
    mask = FieldSettings(file=volume, role="mask", threshold=20)
    scene = Scene(volume=clvol.Volume(CUBE), field=[mask])
    assert scene.resolve().fields[0].volume is volume
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        text = scene.to_toml()
    assert "# file: 4 x 4 x 4 voxels of uint8, passed as an array" in text


def test_colors_are_linear_beside_a_linear_transfer_function(scene_file):
    resolved = load_scene(scene_file, ['transfer_function.color_space="linear"']).resolve()
    assert resolved.isosurfaces[0].back_color == (0.5, 0.25, 0.0)
    assert resolved.depth_cue.color == (0.5, 0.5, 0.5)
    assert resolved.fields[0].colors[0].tolist() == [0, 0.5, 0]
    assert resolved.fields[1].function.colors.tolist() == [[0.5, 0.5, 1]]
    assert resolved.transfer_layers[1].function.colors.tolist() == [[0.25, 0.5, 0.5]]


# --- what is left out is filled in ----------------------------------------------------------------


def cue(camera, **keys):
    return Scene(volume=clvol.Volume(CUBE), camera=camera, depth_cue=keys).resolve().depth_cue


def test_a_depth_cue_runs_from_the_nearest_corner_to_the_farthest():
    found = cue({"position": (0, 0, -10), "target": (0, 0, 1)})
    assert found.start == 10.0 and found.end == pytest.approx(math.hypot(3, 3, 13))
    flat = {"projection": "orthographic", "position": (7, 7, -10), "target": (7, 7, 1)}
    found = cue(flat)
    assert found.start == pytest.approx(10.0) and found.end == pytest.approx(13.0)
    assert cue(flat, start=2.0).start == 2.0 and cue(flat, end=99.0).end == 99.0


def test_a_depth_cue_always_has_a_length():
    camera = {"position": (0, 0, -10), "target": (0, 0, 1)}
    for asked in ({"start": 1000.0}, {"end": 1.0}, {"start": 1e20}, {"end": -1e20}):
        found = cue(camera, **asked)
        assert found.start < found.end
        assert asked.items() <= found.model_dump().items()


def test_an_opacity_factor_is_linear_between_points_and_holds_beyond():
    factor = OpacityFactor(np.array([1.0, 2.0, 2.0, 4.0]), np.array([0.2, 0.4, 1.0, 0.0]))
    at = np.array([0.0, 1.0, 1.5, 2.0 - 1e-12, 2.0, 3.0, 4.0, np.inf, np.nan])
    expected = [0.2, 0.2, 0.3, 0.4, 1.0, 0.5, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(factor(at), expected, atol=1e-9)
    single = GradientOpacity(points=[{"magnitude": 3, "opacity": 0.5}]).factor()
    assert single(0.0) == single(9.0) == 0.5


# --- text -----------------------------------------------------------------------------------------


def read_back(scene: Scene, folder: Path) -> Scene:
    path = folder / "again.toml"
    path.write_text(scene.to_toml(), encoding="utf-8")
    return load_scene(path)


def test_the_text_of_every_table_reads_back(scene_file, folder):
    first = load_scene(scene_file)
    second = read_back(first, folder)
    assert dict(second) == dict(first)
    assert second.to_toml() == first.to_toml() == first.resolve().source


UNIT = st.floats(0, 1)
COLOR = st.tuples(UNIT, UNIT, UNIT)
POINT = st.tuples(*[st.floats(-1e30, 1e30)] * 3)


def ascending(key: str, lowest: float = 0.0):
    """Points of a factor or a function, in ascending order of ``key``."""
    keys = {key: st.floats(lowest, 1e300), "opacity": UNIT}
    if key == "value":
        keys["color"] = COLOR
    points = st.lists(st.fixed_dictionaries(keys), min_size=1, max_size=4,
                      unique_by=lambda p: p[key])  # fmt: skip
    return points.map(lambda some: sorted(some, key=lambda p: p[key]))


LABEL = st.fixed_dictionaries(
    {"label": st.integers(-(2**53) + 1, 2**53 - 1), "color": COLOR}, optional={"opacity": UNIT}
)
TABLES = st.fixed_dictionaries(
    {},
    optional={
        "environment": st.fixed_dictionaries(
            {"file": st.text(min_size=1).filter(lambda t: "\0" not in t and t.isprintable())},
            optional={"visible": st.booleans(), "intensity": st.floats(0, 1e6)},
        ),
        "gradient": st.fixed_dictionaries({"operator": st.sampled_from(["central", "sobel"])}),
        "gradient_opacity": st.fixed_dictionaries({"points": ascending("magnitude")}),
        "directional_opacity": st.fixed_dictionaries({"points": ascending("derivative")}),
        "transfer_layer": st.lists(
            st.fixed_dictionaries({"magnitude": st.floats(1e-300, 1e300),
                                   "points": ascending("value", -1e300)}),
            max_size=3, unique_by=lambda layer: layer["magnitude"],
        ).map(lambda layers: sorted(layers, key=lambda layer: layer["magnitude"])),
        "field": st.lists(
            st.one_of(
                st.builds(
                    dict, file=st.just("f.npy"), role=st.just("label"),
                    labels=st.lists(LABEL, min_size=1, max_size=3, unique_by=lambda k: k["label"]),
                ),
                st.builds(dict, file=st.just("f.npy"), role=st.just("density"),
                          points=ascending("value", -1e300)),
                st.builds(dict, file=st.just("f.npy"), role=st.just("mask"),
                          threshold=st.floats(-1e300, 1e300), keep=st.just("below")),
            ),
            max_size=3,
        ),
        "clip": st.lists(
            st.one_of(
                st.builds(dict, point=POINT, normal=st.just((0.0, 1e-30, 0.0))),
                st.builds(dict, type=st.just("sphere"), center=POINT,
                          radius=st.floats(1e-300, 1e30)),
                st.builds(dict, type=st.just("box"), lower=st.just((-1.5, 0, 0)),
                          upper=st.just((0.1, 1, 1e30)), keep=st.just("outside")),
            ),
            max_size=3,
        ),
        "noise": st.lists(
            st.builds(dict, target=st.sampled_from(["value", "coordinate"]),
                      amplitude=st.floats(-1e30, 1e30), octaves=st.integers(1, 8)),
            max_size=4,
        ),
        "depth_cue": st.builds(dict, start=st.floats(-1e30, 1e30), color=COLOR),
        "animation": st.builds(dict, time=st.floats(-1e6, 1e6), frames=st.integers(1, 9)),
    },
)  # fmt: skip


@settings(max_examples=80, deadline=None)
@given(tables=TABLES)
def test_the_text_of_any_tables_reads_back(folder, tables):
    scene = Scene(volume="cube.npy", **tables)
    assert dict(read_back(scene, folder)) == dict(scene)


# --- mistakes -------------------------------------------------------------------------------------

# (override of the full scene, key that the error names, value as shown, part of what was expected)
MISTAKES = [
    ("light.1={type=\"directional\"}", "light.1.direction", "missing", "light of type 'directional'"),
    ("isosurface.0.value=nan", "isosurface.0.value", "nan", "a finite number"),
    ("isosurface.0.refraction=0", "isosurface.0.refraction", "0", "from 0.1 to 10"),
    ("isosurface.0.back_color=[2,0,0]", "isosurface.0.back_color.0", "2", "from 0 to 1"),
    ('environment.file="none.exr"', "environment.file", "'none.exr', no such file", "EXR"),
    ('environment.file="cube.npy"', "environment.file", "'cube.npy'", ".exr"),
    ('environment.file="maps"', "environment.file", "'maps'", ".exr"),
    ('environment.layout="spiral"', "environment.layout", "'spiral'", "'latlong', 'cube' or 'sphere'"),
    ("environment={}", "environment.file", "missing", "EXR file"),
    ("environment.intensity=-1", "environment.intensity", "-1", "from 0"),
    ('integration.filter="linear"', "integration.prefilter", "true", "the filter 'cubic'"),
    ('integration.filter="catmull"', "integration.filter", "'catmull'", "'catmull-rom'"),
    ('integration.compositing="mip"', "integration.compositing", "'mip'", "'maximum'"),
    ("integration.attenuation=-1", "integration.attenuation", "-1", "from 0"),
    ('gradient.operator="prewitt"', "gradient.operator", "'prewitt'", "'sobel'"),
    ('gradient.storage="always"', "gradient.storage", "'always'", "'precomputed'"),
    ("material.fade=-1", "material.fade", "-1", "0 or greater"),
    ('shadow.method="rays"', "shadow.scattering", "0.4", "0, or the method 'volume'"),
    ("shadow.resolution=3", "shadow.resolution", "3", "from 4 to 512"),
    ("shadow.cone_degrees=81", "shadow.cone_degrees", "81", "from 0 to 80"),
    ("shadow.scattering=nan", "shadow.scattering", "nan", "from 0 to 1"),
    ("shadow.step=0", "shadow.step", "0", "greater than 0"),
    ("gradient_opacity.points=[]", "gradient_opacity.points", "[]", "from 1 to"),
    ("gradient_opacity.points.1.magnitude=-1",
     "gradient_opacity.points.1.magnitude", "-1", "0 or greater"),
    ("gradient_opacity.points.2={magnitude=1,opacity=1}",
     "gradient_opacity.points.2.magnitude", "1.0", "ascending, here 4.5 or more"),
    ("directional_opacity.points.2={derivative=1,opacity=0}",
     "directional_opacity.points.2.derivative", "1.0", "at most two"),
    ("directional_opacity.points.0.opacity=2", "directional_opacity.points.0.opacity", "2", "to 1"),
    ("transfer_layer.1.magnitude=2.0", "transfer_layer.1.magnitude", "2.0", "more than 2.0"),
    ("transfer_layer.0.magnitude=0", "transfer_layer.0.magnitude", "0", "greater than 0"),
    ("transfer_layer.0.points=[]", "transfer_layer.0.points", "[]", "from 1 to"),
    ("transfer_layer.0.magnitude=inf", "transfer_layer.0.magnitude", "inf", "finite"),
    ('field.3={file="cube.npy",role="mask"}', "field", "4", "at most 3"),
    ('field.0.file="none.npy"', "field.0.file", "'none.npy', no such file", "a volume file"),
    ('field.0.role="layer"', "field.0.role", "'layer'", "'mask'"),
    ('field.1={file="cube.npy",role="label"}', "field.1.labels", "missing", "'label'"),
    ('field.1={file="cube.npy",role="density"}', "field.1.points", "missing", "'density'"),
    ("field.2.labels=[{label=1,color=[0,0,0]}]", "field.2.labels", "1", "no labels"),
    ("field.0.threshold=1", "field.0.threshold", "1.0", "no threshold"),
    ("field.0.labels.0.label=3", "field.0.labels.1.label", "3", "each label once"),
    ("field.0.labels.0.label=1.5", "field.0.labels.0.label", "1.5", "a whole number"),
    ("field.0.labels=[]", "field.0.labels", "[]", "from 1 to"),
    ("field.2.threshold=nan", "field.2.threshold", "nan", "a finite number"),
    ("clip.1.lower=[0,2,0]", "clip.1.upper.1", "2.0", "greater than lower's 2.0"),
    ("clip.1.radius=1", "clip.1.radius", "1.0", "no radius for a clip of type 'box'"),
    ('clip.2={type="sphere",center=[0,0,0]}', "clip.2.radius", "missing", "for a sphere"),
    ('clip.1={type="box",lower=[0,0,0]}', "clip.1.upper", "missing", "for a box"),
    ("clip.0={normal=[1,0,0]}", "clip.0.point", "missing", "for a plane"),
    ('clip.0.keep="inside"', "clip.0.keep", "'inside'", "its normal's side"),
    ("clip.2.radius=0", "clip.2.radius", "0", "greater than 0"),
    ('clip.0.type="cone"', "clip.0.type", "'cone'", "'sphere'"),
    ("noise=[{amplitude=1}]", "noise.0.target", "missing", "'coordinate'"),
    ('noise=[{target="value"}]', "noise.0.amplitude", "missing", "a number"),
    ("noise.0.octaves=9", "noise.0.octaves", "9", "from 1 to 8"),
    ("noise.0.frequency=0", "noise.0.frequency", "0", "greater than 0"),
    ("noise.0.seed=-1", "noise.0.seed", "-1", "from 0"),
    ("noise.0.velocity=[0,0]", "noise.0.velocity.2", "missing", "three numbers"),
    ("noise={amplitude=1}", "noise", "{'amplitude': 1}", "a list of tables"),
    ("noise=[" + 5 * '{target="value",amplitude=1},' + "]", "noise", "5", "at most 4"),
    ("depth_cue.end=9", "depth_cue.end", "9.0", "beyond the start, 9.0"),
    ("depth_cue.strength=1.5", "depth_cue.strength", "1.5", "from 0 to 1"),
    ("animation.frames=0", "animation.frames", "0", "from 1"),
    ("animation.fps=0", "animation.fps", "0", "greater than 0"),
    ("animation.time=inf", "animation.time", "inf", "seconds"),
    ("shadows={}", "shadows", "{}", "'shadow'"),
    ("noise.0.speed=1", "noise.0.speed", "1", "'seed'"),
]  # fmt: skip


@pytest.mark.parametrize(("override", "key", "value", "expected"), MISTAKES,
                         ids=[mistake[0] for mistake in MISTAKES])  # fmt: skip
def test_a_mistake_is_one_line_with_its_place(scene_file, override, key, value, expected):
    with pytest.raises(SceneError) as caught:
        load_scene(scene_file, [override]).resolve()
    error = caught.value
    assert error.where == f"{scene_file}: {key}" and error.exit_status == 2
    assert value in error.what and expected in error.expected
    assert "\n" not in str(error) and len(str(error)) < 600


def test_settings_of_a_sweep_are_no_contradictions(scene_file):
    """Another filter for a resolved scene that asks for the prefilter: it then has none."""
    from clvol.accuracy.settings import apply
    from clvol.features import called_for, reduced

    asked = {"integration.filter": "linear"}
    resolved = apply(load_scene(scene_file, ['integration.compositing="over"']).resolve(), asked)
    assert "prefilter" not in called_for(resolved) and not reduced(resolved).integration.prefilter
