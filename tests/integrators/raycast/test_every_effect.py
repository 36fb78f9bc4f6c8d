"""Every effect that a scene may state, alone and with the others: it renders and shows, costs nothing where it
has no consequence, and is refused where it cannot be."""

from __future__ import annotations

import functools
import itertools
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from helpers.effect_scenes import HAZE, NOTHING, blobs, scaled
from helpers.effect_tables import (
    EFFECTS,
    UNUSED,
    EffectScene,
    Place,
    all_unused,
    by_name,
    together,
    with_tables,
)
from helpers.paths import ROOT

from clvol import Scene, Volume, load_scene
from clvol.device.prefilter import prefiltered
from clvol.errors import SceneError
from clvol.explanation import kernel_hash, scene_programs
from clvol.features import called_for
from clvol.integrators.raycast.caster import Raycaster
from clvol.integrators.registry import check_scene
from clvol.opencl.context import compile_options
from clvol.render.prepared_cache import PreparedCache

SIZE = (16, 12)
VOLUME = Volume(blobs((15, 17, 19), top=255, dtype=np.uint8))
CAMERA = {"position": [34.0, 22.0, -27.0], "target": [9.0, 8.0, 7.0], "fov_degrees": 32.0}
FUNCTION = scaled(HAZE, 255.0)
QUICK = {"table_size": 64, "classification": "post"}  # tables and programs that are soon made
SHARED = {"empty_space.cl"}  # what every scene compiles
TOGETHER = EffectScene("all together", "together", together)
ALL_UNUSED = EffectScene("all without consequence", "together", all_unused)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return Place(VOLUME, tmp_path_factory.mktemp("skies"))


def scene_of(tables=None, **integration):
    settings = {
        "volume": VOLUME, "camera": CAMERA, "image": {"width": SIZE[0], "height": SIZE[1]},
        "transfer_function": FUNCTION, "integration": QUICK | integration,
    }  # fmt: skip
    return Scene(**with_tables(settings, tables or {})).resolve()


@dataclass(frozen=True)
class Rendered:
    rgba: np.ndarray
    samples: int
    counters: dict[str, int]
    called: list[str]
    hash: str
    said: set[tuple]  # (file, options) that the scene is said to compile
    switches: dict[str, int]  # that its picture was compiled with


_rendered: dict = {}


def rendered(context, place, effect: EffectScene | None) -> Rendered:
    """The scene that ``effect`` asks for (None: the plain one); rendered once."""
    key = effect and effect.name
    if key not in _rendered:
        resolved = scene_of(effect and effect.tables(place))
        check_scene(resolved)
        caster = PreparedCache(context).prepare(resolved)
        data = caster.render(resolved.camera, *SIZE)
        said = {(file, compile_options(s)) for file, s in scene_programs(resolved).items()}
        _rendered[key] = Rendered(
            data.rgba, data.samples, data.counters, called_for(resolved), kernel_hash(resolved),
            said, caster.switches,
        )  # fmt: skip
    return _rendered[key]


def check(rgba) -> None:
    """Premultiplied colours that are numbers, and opacities."""
    assert np.isfinite(rgba).all() and rgba.min() >= 0
    assert 0.01 < rgba[..., 3].max() <= 1


def named(effect) -> str:
    return effect.name


# --- alone and together --------------------------------------------------------------------------


def test_without_effects_none_is_compiled(context, place):
    plain = rendered(context, place, None)
    check(plain.rgba)
    assert plain.called == ["emission-absorption"] and plain.counters == {}
    assert "EFFECTS" not in plain.switches


@pytest.mark.parametrize("effect", EFFECTS, ids=named)
def test_every_effect_shows(context, place, effect):
    plain, found = rendered(context, place, None), rendered(context, place, effect)
    check(found.rgba)
    assert set(found.called) - set(plain.called)
    assert np.abs(found.rgba - plain.rgba).max() > 0.01
    if effect.name != "colour cycle":  # other colours in the same tables
        assert found.hash != plain.hash


_ALONE = (
    "Catmull-Rom, lit", "refraction", "scattering", "two-value function", "mask field",
    "noise on place", "attenuated maximum",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", _ALONE)
def test_a_ray_alone_sees_what_a_packet_sees(context, place, name):
    effect = by_name(name)
    found = rendered(context, place, effect)
    resolved = prefiltered(scene_of(effect.tables(place)))
    alone = Raycaster(context, resolved, lanes=1).render(resolved.camera, *SIZE)
    np.testing.assert_allclose(alone.rgba, found.rgba, atol=1e-4)
    kept = ("gradients", "lit_samples", "field_samples", "shadow_rays")
    for counter in found.counters.keys() & set(kept):
        assert alone.counters[counter] == pytest.approx(found.counters[counter], rel=0.01)


def test_all_but_exclusive_effects_are_called_for_together(place):
    exclusive = {
        "projection", "precomputed gradients", "sobel gradients", "prefilter", "nearest filter",
        "cubic filter", "catmull-rom filter", "mitchell filter",
    }  # fmt: skip
    asked = {name for e in EFFECTS for name in called_for(scene_of(e.tables(place)))}
    assert asked - set(called_for(scene_of(together(place)))) == exclusive


@pytest.mark.slow
def test_all_effects_go_together(context, place):
    found = rendered(context, place, TOGETHER)
    check(found.rgba)
    counters = ("lit_samples", "surface_hits", "bends", "field_samples", "gradients")
    assert all(found.counters[name] > 0 for name in counters)


# --- without consequence -------------------------------------------------------------------------


@pytest.mark.parametrize("effect", (*UNUSED, ALL_UNUSED), ids=named)
def test_what_has_no_consequence_costs_nothing(context, place, effect):
    plain, found = rendered(context, place, None), rendered(context, place, effect)
    assert found.hash == plain.hash and found.switches == plain.switches
    assert found.samples == plain.samples and found.counters == {}
    assert np.array_equal(found.rgba, plain.rgba)


@pytest.mark.parametrize("name", ("directional light", "mask field", "maximum"))
def test_nor_does_it_beside_what_has(context, place, name):
    """All that changes nothing, in a scene with an effect: nothing of that changes."""
    asked = by_name(name).tables(place)
    idle = all_unused(place)
    idle = {key: table for key, table in idle.items() if key not in ("material", "gradient")}
    if name == "mask field":  # three fields are the most
        idle.pop("field")
    if name == "directional light":  # which would cast that dead light's shadow
        idle.pop("shadow")
    resolved = scene_of(with_tables(idle, asked))
    data = PreparedCache(context).prepare(resolved).render(resolved.camera, *SIZE)
    found = rendered(context, place, by_name(name))
    assert kernel_hash(resolved) == found.hash
    assert data.samples == found.samples and data.counters == found.counters
    assert np.array_equal(data.rgba, found.rgba)


# --- what is compiled ----------------------------------------------------------------------------


@pytest.mark.parametrize("effect", EFFECTS, ids=named)
def test_explain_names_what_is_compiled(context, place, effect):
    found = rendered(context, place, effect)
    picture = {options for file, options in found.said if file == "raycast.cl"}
    assert picture == {compile_options(found.switches)}
    chosen = "-DTILES_CHOSEN=1"  # of a launch, not of a scene
    built = {(file, tuple(o for o in options if o != chosen)) for file, options, *_ in context._programs}
    assert found.said <= built


CYCLING = {"time": 2.0, "cycle": 0.5}


@pytest.mark.slow
def test_explain_knows_what_converts_voxels_and_what_comes_round(device):
    """Whatever the voxels are turned into, and colours that are where they began: one fresh device
    each, on which nothing else was built."""
    from clvol.opencl.context import DeviceContext

    lit = {"light": [{"type": "headlight"}], "gradient": {"storage": "precomputed"}}
    scenes = [
        scene_of(classification="preintegrated"),
        scene_of({"animation": CYCLING}, classification="preintegrated"),
        scene_of(filter="cubic", prefilter=True, classification="preintegrated"),
        scene_of(lit), scene_of(lit | {"gradient": {**lit["gradient"], "operator": "sobel"}}),
        replace(scene_of(voxel_precision="uint8"), volume=Volume(VOLUME.data.astype(np.float32))),
    ]  # fmt: skip
    for resolved in scenes:
        context = DeviceContext(device)
        PreparedCache(context).prepare(resolved).render(resolved.camera, *SIZE)
        said = {(file, compile_options(s)) for file, s in scene_programs(resolved).items()}
        assert {key[:2] for key in context._programs if key[0] not in SHARED} == said
        context.release()
    hashes = list(map(kernel_hash, scenes))
    assert len(set(hashes)) == len(hashes)


def test_colours_of_nothing_that_shows_never_come_round():
    still, cycling = ({}, {"animation": CYCLING})
    for function in (NOTHING, FUNCTION):
        told = [
            kernel_hash(replace(scene_of(tables, classification="preintegrated"),
                                transfer_function=function))
            for tables in (still, cycling)
        ]  # fmt: skip
        assert (told[0] == told[1]) == (function is NOTHING)


# --- what does not go together -------------------------------------------------------------------

_NOISES = {"noise on value", "noise, 4 octaves", "noise on place"}
_PLAIN_FILTERS = {"nearest", "cubic"}
# (settings of [integration], the effects that they do not go together with)
REFUSED = (
    ({"method": "reference"}, {e.name for e in EFFECTS} - _PLAIN_FILTERS),
    ({"quadrature": "cells"}, {e.name for e in EFFECTS}),
    ({"classification": "pre"}, _NOISES),
)


def _refusal(tables, **integration) -> str | None:
    try:
        check_scene(scene_of(tables, **integration))
    except SceneError as error:
        return str(error)
    return None


@pytest.mark.parametrize("asked, effects", REFUSED, ids=["reference", "cells", "pre"])
def test_what_does_not_go_together_is_refused_in_one_line(place, asked, effects):
    (key,) = asked
    refused = set()
    for effect in EFFECTS:
        tables = dict(effect.tables(place))
        if key in tables.get("integration", {}):  # it asks for another itself
            tables["integration"] = {**tables["integration"], **asked}
        line = _refusal(tables, **asked)
        if line is not None:
            assert "\n" not in line and len(line) < 300
            assert line.startswith("scene: integration.") and "expected" in line
            refused.add(effect.name)
    assert refused == effects


@pytest.mark.parametrize("filter", ["nearest", "linear", "catmull-rom"])
def test_only_the_cubic_filter_has_a_prefilter(filter):
    line = _refusal({}, filter=filter, prefilter=True)
    assert line is not None and line.startswith("scene: integration.prefilter: got true")


_MODES = [e for e in EFFECTS if e.group == "compositing"]
_OTHERS = [e for e in EFFECTS if e.group in ("light", "surface", "shadow", "opacity")]


def test_projections_take_scenes_with_effects_that_they_do_not_show(place):
    """What a projection does not show has no consequence in it: the kernel is the projection's."""
    for mode, effect in itertools.product(_MODES, _OTHERS):
        asked, more = mode.tables(place), effect.tables(place)
        assert _refusal(with_tables(more, asked)) is None
        told = kernel_hash(scene_of(with_tables(more, asked)))
        assert told == kernel_hash(scene_of(asked)), (mode.name, effect.name)


# --- scenes of the repository --------------------------------------------------------------------

_SHIPPED = sorted([*(ROOT / "data").glob("*.toml"), *(ROOT / "bench" / "gallery").glob("*.toml")])
_SHIPPED.remove(ROOT / "data" / "scene-reference.toml")  # has every key, to be read and not to be rendered
_LONGEST = 40  # voxels along an edge


def _coarse(volume: Volume) -> Volume:
    """Every so many voxels of it, over the same place."""
    every = -(-max(volume.grid.size) // _LONGEST)
    grid = volume.grid
    return Volume(
        np.ascontiguousarray(volume.data[::every, ::every, ::every]),
        spacing=tuple(every * s for s in grid.spacing), origin=grid.origin,
        direction=grid.direction, name=volume.name,
    )  # fmt: skip


@functools.cache
def _shipped(path: Path):
    """The scene, small, of coarse volumes."""
    resolved = load_scene(path).resolve()
    image = resolved.image.model_copy(update={"width": SIZE[0], "height": SIZE[1]})
    integration = resolved.integration.model_copy(update={"table_size": 64})
    shadow = resolved.shadow and resolved.shadow.model_copy(update={"resolution": 12})
    fields = tuple(replace(field, volume=_coarse(field.volume)) for field in resolved.fields)
    return replace(
        resolved, volume=_coarse(resolved.volume), image=image, integration=integration,
        shadow=shadow, fields=fields,
    )  # fmt: skip


@pytest.mark.parametrize("path", _SHIPPED, ids=lambda path: path.stem)
def test_every_scene_of_the_repository_renders(context, path, shared_volume):
    if path.parent.name == "gallery":
        for name in re.findall(r'/shared/volumes/([^"/]+)"', path.read_text(encoding="utf-8")):
            shared_volume(name)
    resolved = _shipped(path)
    check_scene(resolved)
    data = PreparedCache(context).prepare(resolved).render(resolved.camera, *SIZE)
    check(data.rgba)
    assert data.rgba[..., 3].mean() > 0.05
    names = called_for(resolved)
    assert names != ["emission-absorption"] or path.stem == "demo"
