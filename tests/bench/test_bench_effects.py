"""The scenes of every effect, and what is said of effects, shaded frames and surfaces."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from bench.effect_scenes import (
    EFFECTS,
    HEADLIGHT,
    LIGHT,
    UNUSED,
    EffectScene,
    Place,
    all_unused,
    by_name,
    together,
    with_tables,
)
from bench.effects import filter_costs, ratio_of
from bench.isosurface import MOST_APART, surface_tables
from bench.isosurface import verdict as surface_verdict
from bench.options import Options
from bench.pictures import apart
from bench.scenes import SCENES, BenchScene
from bench.shaded import OWN_GOAL, VTK_GOAL, verdict
from clvol.accuracy.timing import summary

SIDE = 9


@pytest.fixture(scope="module")
def volume():
    from clvol import Volume

    ramp = np.arange(SIDE**3, dtype=np.float64).reshape(SIDE, SIDE, SIDE)
    return Volume((ramp * 255 / ramp.max()).astype(np.uint8), spacing=(1.0, 2.0, 1.5))


@pytest.fixture(scope="module")
def place(volume, tmp_path_factory):
    return Place(volume, tmp_path_factory.mktemp("skies"))


# Scenes


@pytest.mark.parametrize("effect", (*EFFECTS, *UNUSED), ids=lambda e: e.name)
def test_every_effect_is_a_scene_that_resolves(effect, place):
    resolved = SCENES[0].scene(place.volume, 16, effect.tables(place)).resolve()
    assert resolved.volume is place.volume


@pytest.mark.parametrize("tables", (together, all_unused), ids=lambda t: t.__name__)
def test_effects_together_are_a_scene_that_resolves(tables, place):
    resolved = SCENES[0].scene(place.volume, 16, tables(place)).resolve()
    assert [field.role for field in resolved.fields] == ["label", "density", "mask"]
    assert resolved.clips and resolved.isosurfaces and resolved.lights and resolved.noise


def test_names_are_distinct_and_what_effects_are_built_on_comes_before_them():
    names = [effect.name for effect in (*EFFECTS, *UNUSED)]
    assert len(set(names)) == len(names)
    for i, effect in enumerate(EFFECTS):
        assert effect.over is None or effect.over in names[:i]


def test_no_two_effects_state_the_same(place):
    stated = [json.dumps(effect.tables(place), default=_text, sort_keys=True) for effect in EFFECTS]
    assert len(set(stated)) == len(stated)


def _text(value):
    return value.data.tobytes().hex()


def test_all_but_exclusive_effects_are_stated_together(place):
    of_effects = set().union(*(effect.tables(place) for effect in EFFECTS))
    assert of_effects - set(together(place)) <= {"integration", "gradient"}


def test_tables_replace_keys_and_join_lists():
    base = {"integration": {"step": 0.5, "filter": "linear"}, "light": [1], "volume": "v"}
    made = with_tables(base, {"integration": {"filter": "cubic"}, "light": [2], "noise": {"a": 1}})
    assert made == {
        "integration": {"step": 0.5, "filter": "cubic"}, "light": [1, 2], "volume": "v",
        "noise": {"a": 1},
    }  # fmt: skip
    assert base["integration"]["filter"] == "linear" and base["light"] == [1]


def test_scenes_take_tables_over_their_own(volume):
    scene = SCENES[0].scene(volume, 16, {"light": [LIGHT], "integration": {"filter": "nearest"}},
                            step=0.5)
    resolved = scene.resolve()
    assert resolved.integration.filter == "nearest" and resolved.integration.step == 0.5
    assert len(resolved.lights) == 1


def test_a_surface_alone_is_in_a_transparent_volume(volume):
    resolved = SCENES[0].scene(volume, 16, surface_tables(SCENES[0], 80.0)).resolve()
    assert not resolved.transfer_function.opacities.any()
    assert [surface.value for surface in resolved.isosurfaces] == [80.0]


def test_both_layouts_of_the_sky_show_the_same_sky(place):
    from clvol.image.exr import read

    latlong, cube = (
        read(place.sky(layout))[0][..., :3] for layout in ("latlong", "cube")
    )
    rows, columns, _ = latlong.shape
    row, column = np.unravel_index(latlong.sum(axis=-1).argmax(), (rows, columns))
    around = 2 * math.pi * ((column + 0.5) / columns - 0.5)
    up = math.cos(math.pi * (row + 0.5) / rows)
    flat = math.sqrt(1 - up * up)
    sun = np.array([flat * math.sin(around), up, -flat * math.cos(around)])

    n = cube.shape[1]
    row, column = np.unravel_index(cube.sum(axis=-1).argmax(), cube.shape[:2])
    s, t = 2 * (column + 0.5) / n - 1, 2 * (row % n + 0.5) / n - 1
    faces = [(1, -t, -s), (-1, -t, s), (s, 1, t), (s, -1, -t), (s, -t, 1), (-s, -t, -1)]
    same = np.array(faces[row // n]) / math.sqrt(1 + s * s + t * t)
    assert sun @ same > math.cos(math.radians(5))
    assert cube.min() == pytest.approx(latlong.min(), rel=0.05)


# Arithmetic


def test_a_ratio_is_of_medians_and_its_ends_hold_both_spreads():
    steady = summary([2.0] * 7)
    found = ratio_of(summary([4.0] * 7), steady)
    assert found == {"ratio": 2.0, "low": 2.0, "high": 2.0}
    wide = summary([3.0, 4.0, 5.0])
    found = ratio_of(wide, steady)
    assert found["ratio"] == 2.0 and found["high"] == pytest.approx(2.0 * (1 + wide["spread"] / 2))
    assert found["low"] * found["high"] == pytest.approx(4.0)


def test_filters_are_beside_the_linear_one_lit_beside_lit():
    rows = [
        {"name": "cubic", "plain": {"ratio": 4.0}, "over": None},
        {"name": "cubic, lit", "plain": {"ratio": 9.0}, "over": {"ratio": 3.0}},
        {"name": "Catmull-Rom", "refused": "no"},
        {"name": "noise on value", "plain": {"ratio": 2.0}, "over": None},
    ]
    assert filter_costs(rows) == {"cubic": 4.0, "cubic, lit": 3.0}


def test_a_shaded_row_that_misses_a_goal_is_named():
    row = {"scene": "a", "size": 512, "light": "headlight"}
    good = {**row, "vtk_ratio": VTK_GOAL, "own_ratio": OWN_GOAL}
    slow = {**row, "vtk_ratio": VTK_GOAL - 0.01, "own_ratio": 1.0}
    dear = {**row, "vtk_ratio": 9.0, "own_ratio": OWN_GOAL + 0.01}
    assert verdict([good]) == "both met everywhere"
    assert verdict([good, slow]) == "missed: a 512 headlight (VTK)"
    assert verdict([dear]) == "missed: a 512 headlight (unshaded)"


def test_a_fast_picture_of_another_surface_meets_no_goal():
    alike = {"best_flip": "none", "outline": 0.0}
    row = {"value": 80.0, "ratio": 6.0, "apart": alike}
    assert surface_verdict([row]) == "met"
    assert surface_verdict([row, {**row, "ratio": 4.0}]) == "NOT met"
    for other in ({"outline": 2 * MOST_APART}, {"best_flip": "both"}):
        found = surface_verdict([{**row, "ratio": 1e3, "apart": {**alike, **other}}])
        assert found.startswith("NOT the same")


def test_pictures_apart():
    picture = np.zeros((6, 8, 4))
    picture[1, 2] = picture[1, 3] = 1.0
    assert apart(picture, picture) == {"rmse": 0.0, "best_flip": "none", "outline": 0.0}
    assert apart(picture, picture[::-1])["best_flip"] == "up-down"
    assert apart(picture, picture[:, ::-1])["best_flip"] == "left-right"
    half = picture.copy()
    half[1, 3] = 0.0
    found = apart(picture, half)
    assert found["outline"] == 0.5 and found["rmse"] == pytest.approx(math.sqrt(4 / (6 * 8 * 4)))


# The peers


def _peer_scene(tables, size=48):
    from clvol.volume.procedural import Gaussian, sample

    field = Gaussian(center=(14.0, 20.0, 17.0), sigma=8.0, amplitude=250.0)
    volume = sample(field, (24, 20, 28), (1.0, 2.0, 1.5), dtype="uint8")
    scene = next(s for s in SCENES if s.name == "aneurism")
    return scene.scene(volume, size, tables).resolve(), scene


def _vtk():
    return pytest.importorskip(
        "vtkmodules", reason="vtk is not installed, so there is no peer to compare"
    )


def test_vtk_with_ambient_light_alone_is_vtk_without_shading():
    _vtk()
    from bench.vtk_peer import VtkPeer

    ambient = {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}
    pictures = []
    for tables in ({}, {"light": [LIGHT], "material": ambient}):
        resolved, _ = _peer_scene(tables)
        peer = VtkPeer(resolved, threads=1)
        try:
            peer.render(0.5)
            pictures.append(peer.ray_picture())
        finally:
            peer.close()
    assert pictures[0][..., 3].max() > 0.01
    assert np.abs(pictures[0] - pictures[1]).max() < 1e-3


def test_vtk_is_lit_from_where_the_light_is():
    """A ball lit along the view is brightest in its middle, lit from the right on its right."""
    _vtk()
    from bench.vtk_peer import VtkPeer

    def middle(light):
        """The brightness's centre, pixels from the opacity's: to the right, down."""
        material = {"ambient": 0.0, "diffuse": 1.0, "specular": 0.0}
        resolved, _ = _peer_scene({"light": [light], "material": material})
        peer = VtkPeer(resolved, threads=1)
        try:
            peer.render(0.5)
            picture = peer.ray_picture()
        finally:
            peer.close()
        lit, opaque = picture[..., :3].sum(axis=-1), picture[..., 3]
        rows, columns = np.indices(lit.shape)
        return [
            float((at * lit).sum() / lit.sum() - (at * opaque).sum() / opaque.sum())
            for at in (columns, rows)
        ]

    resolved, _ = _peer_scene({})
    forward, right, up = resolved.camera.basis()
    across, down = middle({"type": "directional", "direction": (-right + 0.2 * forward).tolist()})
    assert across > 1.0 and abs(down) < 0.5 * across
    across, down = middle({"type": "directional", "direction": (-up + 0.2 * forward).tolist()})
    assert down < -1.0 and abs(across) < -0.5 * down
    assert np.hypot(*middle(HEADLIGHT)) < 0.5


@pytest.mark.parametrize(
    "tables",
    (
        {"light": [LIGHT, HEADLIGHT]},
        {"light": [{"type": "point", "position": [9.0, 9.0, 9.0]}]},
        {"light": [{**LIGHT, "intensity": 0.5}]},
        {"light": [LIGHT], "material": {"two_sided": False}},
    ),
    ids=("two lights", "a point light", "another intensity", "one-sided"),
)
def test_a_peer_refuses_light_that_vtk_would_show_otherwise(tables):
    _vtk()
    from bench.vtk_peer import VtkPeer

    resolved, _ = _peer_scene(tables)
    with pytest.raises(ValueError, match="a peer"):
        VtkPeer(resolved, threads=1)


def test_vtk_draws_the_surface_at_its_value():
    """Of a radial field the surface is a ball, whose outline is known."""
    _vtk()
    from bench.vtk_peer import VtkIsosurface

    value, size = 120.0, 96
    _, scene = _peer_scene({})
    tables = {**surface_tables(scene, value), "material": {"ambient": 1.0, "diffuse": 0.0}}
    resolved, _ = _peer_scene(with_tables({}, tables), size)
    peer = VtkIsosurface(resolved)
    try:
        assert peer.render(0.25) > 0
        picture, opengl = peer.window_picture(), peer.opengl()
        half = peer.render(0.5)
    finally:
        peer.close()
    assert half > 0 and opengl["renderer"] != "unknown"
    radius = 8.0 * math.sqrt(2 * math.log(250.0 / value))
    camera = resolved.camera
    forward, right, up = camera.basis()
    seen = np.array([14.0, 20.0, 17.0]) - np.array(camera.position)
    distance = float(np.linalg.norm(seen))
    pixel = 2 * math.tan(math.radians(camera.fov_degrees) / 2) / size
    rows, columns = np.indices((size, size))
    rays = (forward + pixel * ((columns + 0.5 - size / 2)[..., None] * right
                               - (rows + 0.5 - size / 2)[..., None] * up))
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    apart_from_centre = np.sqrt(np.maximum(distance**2 - (rays @ seen) ** 2, 0.0))
    covered = picture[..., 3] > 0.5
    assert covered[apart_from_centre < radius - 1.5].all()
    assert not covered[apart_from_centre > radius + 1.5].any()
    assert picture[covered][:, :3].mean(axis=0) == pytest.approx([0.8, 0.8, 0.75], abs=0.01)


def test_a_surface_peer_wants_one_surface_within_the_range():
    _vtk()
    from bench.vtk_peer import VtkIsosurface

    for surfaces in ([], [{"value": 80.0}, {"value": 90.0}], [{"value": 999.0}]):
        resolved, _ = _peer_scene({"light": [LIGHT], "isosurface": surfaces})
        with pytest.raises(ValueError, match="one isosurface"):
            VtkIsosurface(resolved)


# Runs, small and of a scene of their own


@dataclasses.dataclass(frozen=True)
class _Ball(BenchScene):
    """A smooth ball instead of a volume from a file."""

    def load(self, folder=None):
        from clvol import Volume
        from clvol.volume.procedural import Gaussian, sample

        field = Gaussian(center=(12.0, 12.0, 12.0), sigma=6.0, amplitude=250.0)
        return Volume(sample(field, (25, 25, 25), dtype="uint8").data)


@pytest.fixture
def ball():
    return _Ball("ball", "none.nrrd", "a smooth ball", SCENES[0].points)


@pytest.fixture
def quick(tmp_path, monkeypatch):
    """Options of a quick run whose files go to a folder of the test's own."""
    monkeypatch.setattr("bench.options.RESULTS", tmp_path)
    return Options(quick=True)


def _result(**parts):
    return {
        "machine": {"processor": "p", "cores": 1, "commit": None}, "quick": True, "missing": [],
        "load_before": None, "load_after": None, **parts,
    }  # fmt: skip


@pytest.mark.slow
def test_effects_are_measured_shown_and_drawn(ball, quick, device, monkeypatch):
    pytest.importorskip("matplotlib", reason="matplotlib draws the chart")
    from bench import effects

    dead = ("dead light", "surfaces not to be seen")
    monkeypatch.setattr(effects, "EFFECTS", (by_name("nearest"), by_name("cubic")))
    monkeypatch.setattr(effects, "ALL", _refused())
    monkeypatch.setattr(effects, "UNUSED", tuple(map(by_name, dead)))
    monkeypatch.setattr(effects, "all_unused", lambda place: by_name(dead[0]).tables(place))
    scene = effects._Costs(ball, 24, device, quick).measure()
    nearest, cubic, refused = scene["rows"]
    assert nearest["samples"] > 0 and nearest["plain"]["ratio"] > 0
    assert not cubic["same_kernel"] and not cubic["same_picture"]
    assert "not-there.exr" in refused["refused"]
    cases = scene["unused"]["cases"]
    assert [case["name"] for case in cases] == [*dead, "all of them together"]
    assert all(case["kernel"] and case["samples"] and case["picture"] for case in cases)
    result = _result(size=24, scenes=[scene])
    text = effects.show(result)
    assert "NOT the same" not in text and "kernel the same in 3" in text and "quick run" in text
    (chart,) = effects.draw(result, quick)
    assert chart.stat().st_size > 1000 and chart.parent == quick.folder


def _refused():
    missing = {"environment": {"file": "not-there.exr"}}
    return EffectScene("all together", "together", lambda place: missing)


def test_shaded_frames_are_measured_and_shown(ball, quick, device):
    _vtk()
    from bench import shaded

    row = shaded._compare(ball, ball.load(), 48, "directional", device, 1, quick)
    assert row["is_lit"] and row["apart"]["best_flip"] == "none" and row["apart"]["outline"] < 0.05
    assert row["vtk_seconds"] > 0 and row["samples"]["shaded"] > 0
    assert "NOT lit" not in shaded.show(_result(rows=[row], vtk="9", threads=1))


def test_surfaces_are_measured_and_shown(ball, quick, device):
    _vtk()
    from bench import isosurface

    row = isosurface._compare(ball, ball.load(), 100.0, device, quick)
    assert row["apart"]["best_flip"] == "none" and row["apart"]["outline"] < 0.05
    assert row["apart"]["rmse"] < 0.05
    text = isosurface.show(_result(rows=[row], vtk="9"))
    assert row["opengl"]["renderer"] in text and "NOT the same" not in text
