"""What a frame counts of its effects: each no more often than it is needed."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.effect_scenes import NOTHING, ball

from clvol import Scene, TransferFunction, Volume
from clvol.integrators.raycast.caster import Raycaster
from clvol.render.prepared_cache import PreparedCache
from clvol.volume.voxel_layout import CELL_SHIFT

GREY = [0.5, 0.5, 0.5]
SIDE, PIXELS = 33, (12, 10)
DEPTH = SIDE - 1  # world length along every ray, and so segments of step 1
SUN = {"type": "directional", "direction": [1.0, -2.0, 1.5]}
HEAD = {"type": "headlight"}
# Straight along z, rays inside the volume everywhere.
CAMERA = {"projection": "orthographic", "position": [16.0, 16.0, -40.0],
          "target": [16.0, 16.0, 16.0], "up": [0.0, 1.0, 0.0], "height": 24.0}  # fmt: skip
# Values are 0 ... 32, from face to face along x; the lower half of them shows nothing.
RAMP = np.broadcast_to(np.arange(SIDE, dtype=np.float32), (SIDE,) * 3)
HALF = TransferFunction([0.0, 16.0, 16.0, 32.0], [0.0, 0.0, 0.01, 0.02], [GREY] * 4)
HAZE = TransferFunction([0.0, 32.0], [0.004, 0.01], [GREY] * 2)
# A small ball in a corner of a volume that shows everywhere.
CORNER = ball((SIDE,) * 3, (4.0, 4.0, 4.0))
NAMES = {"gradients", "lit_samples"}


def scene_of(array=RAMP, function=HALF, size=PIXELS, camera=CAMERA, **tables):
    volume = array if isinstance(array, Volume) else Volume(np.ascontiguousarray(array))
    integration = {"step": 1.0, "classification": "post", "table_size": 64,
                   "early_termination": 0.0, **tables.pop("integration", {})}  # fmt: skip
    return Scene(
        volume=volume, transfer_function=function, camera=camera, integration=integration,
        image={"width": size[0], "height": size[1]}, **tables,
    ).resolve()  # fmt: skip


def counted(context, resolved):
    """FrameData of a picture."""
    image = resolved.image
    return PreparedCache(context).prepare(resolved).render(resolved.camera, image.width, image.height)


def rays_at(resolved) -> np.ndarray:
    """float64 [pixels, 2]: x and y of the rays of CAMERA."""
    image = resolved.image
    origins, _ = resolved.camera.world_rays(image.width, image.height)
    return origins.reshape(-1, 3)[:, :2]


def showing(resolved) -> int:
    """Rays along which HALF shows RAMP."""
    return int((rays_at(resolved)[:, 0] > 16).sum())


# --- gradients and light -------------------------------------------------------------------------


def test_just_what_has_opacity_is_lit(context):
    resolved = scene_of(light=[SUN])
    data = counted(context, resolved)
    assert 0 < showing(resolved) < PIXELS[0] * PIXELS[1]
    assert data.counters == dict.fromkeys(NAMES, showing(resolved) * DEPTH)
    assert data.counters["lit_samples"] <= data.samples


def test_more_lights_take_no_more_gradients(context):
    one, three = (counted(context, scene_of(light=[SUN, HEAD, SUN][:n])) for n in (1, 3))
    assert one.counters == three.counters


def test_what_has_no_gradient_is_not_lit(context):
    flat = RAMP.copy()
    flat[:, :, 20:] = 20.0  # 16 to 20 rises, beyond is constant
    resolved = scene_of(flat, light=[SUN])
    data = counted(context, resolved)
    x = rays_at(resolved)[:, 0]
    constant = -(-21 >> CELL_SHIFT) << CELL_SHIFT  # the first cell in which all is constant: no gradient is taken there
    # Where packets are not packed (march_effects.h) all that shows has a gradient.
    assert data.counters["gradients"] in {((x > 16) & (x < end)).sum() * DEPTH for end in (constant, SIDE)}
    assert data.counters["lit_samples"] == ((x > 16) & (x < 21)).sum() * DEPTH


def test_gradients_that_decide_light_nothing(context):
    points = [{"magnitude": 0.0, "opacity": 0.2}, {"magnitude": 5.0, "opacity": 1.0}]
    data = counted(context, scene_of(gradient_opacity={"points": points}))
    assert data.counters == {"gradients": showing(scene_of()) * DEPTH}


def test_what_a_factor_takes_away_is_not_lit(context):
    points = [{"magnitude": 0.9, "opacity": 1.0}, {"magnitude": 1.1, "opacity": 0.0}]
    flat = RAMP.copy()
    flat[:, :, 20:] = 20.0
    flat[:, :, 25:] = 20.0 + 4.0 * (np.arange(25, SIDE) - 24)  # steep: taken away
    resolved = scene_of(flat, light=[HEAD], gradient_opacity={"points": points})
    steep = rays_at(resolved)[:, 0] >= 25
    data = counted(context, resolved)
    assert steep.any()
    assert data.counters["gradients"] == showing(resolved) * DEPTH
    assert data.counters["lit_samples"] < (showing(resolved) - steep.sum()) * DEPTH


# --- shadows -------------------------------------------------------------------------------------


def shadowed(context, lights=(SUN,), **shadow):
    return counted(context, scene_of(light=list(lights), shadow={"method": "rays", **shadow}))


def test_a_shadow_ray_at_most_for_each_lit_sample_and_light(context):
    point = {"type": "point", "position": [40.0, 50.0, -20.0]}
    for lights in ([SUN], [SUN, point], [SUN, {**SUN, "casts_shadow": False}], [SUN, HEAD]):
        casting = sum(a["type"] != "headlight" and a.get("casts_shadow", True) for a in lights)
        counters = shadowed(context, lights, bound=0.0).counters
        assert 0 < counters["shadow_rays"] <= casting * counters["lit_samples"]
        assert counters["shadow_samples"] >= counters["shadow_rays"]


def test_no_shadow_ray_below_the_bound(context):
    rays = [shadowed(context, bound=bound).counters["shadow_rays"] for bound in (0, 0.01, 0.015)]
    assert rays[0] > rays[1] > rays[2] > 0
    none = shadowed(context, bound=0.1)  # no sample is as opaque
    assert none.counters["shadow_rays"] == none.counters["shadow_samples"] == 0
    unshadowed = counted(context, scene_of(light=[SUN]))
    np.testing.assert_allclose(none.rgba, unshadowed.rgba, atol=1e-6)


@pytest.mark.slow
def test_a_light_volume_takes_no_shadow_rays(context):
    data = shadowed(context, method="volume", resolution=5)
    assert data.counters == dict.fromkeys(NAMES, showing(scene_of()) * DEPTH)


# --- surfaces ------------------------------------------------------------------------------------

RADIUS = 3.0
BALL = {"value": RADIUS, "opacity": 0.5, "color": [0.9, 0.4, 0.2]}


@pytest.mark.slow
@pytest.mark.parametrize("skip", [False, True])
def test_surfaces_are_looked_for_only_in_cells_near_them(context, skip):
    resolved = scene_of(CORNER, HAZE, isosurface=[BALL])
    caster = Raycaster(context, resolved, skip=skip)
    data = caster.render(resolved.camera, *PIXELS)
    cells = caster.surface_cells
    # The surface is in the first cell along each axis, whose cells rays along z cross one by one.
    assert cells[0, 0, 0] and cells.sum() == 1
    x, y = (rays_at(resolved) // (1 << CELL_SHIFT)).astype(int).T
    near = cells[0, y, x].sum() * (1 << CELL_SHIFT)
    # Behind a surface its cell is looked at once more.
    assert data.counters["surface_tests"] == near + data.counters["surface_hits"] > 0
    hit = np.linalg.norm(rays_at(resolved) - 4.0, axis=1)
    inside, touching = (hit < RADIUS - 0.2).sum(), (hit < RADIUS + 0.2).sum()
    assert 2 * inside <= data.counters["surface_hits"] <= 2 * touching


@pytest.mark.slow
def test_tiles_that_see_no_surface_test_none(context):
    size = (96, 80)
    resolved = scene_of(CORNER, HAZE, size, isosurface=[BALL])
    data = counted(context, resolved)
    tiles = data.counters["tiles_with_surfaces"], data.counters["tiles_without_surfaces"]
    assert min(tiles) > 0
    whole = Raycaster(context, resolved)
    whole.without_surfaces = None  # all of it by the kernel that knows of surfaces
    other = whole.render(resolved.camera, *size)
    assert data.counters["surface_tests"] == other.counters["surface_tests"]
    assert data.counters["surface_hits"] == other.counters["surface_hits"]
    assert np.array_equal(data.rgba, other.rgba)
    assert not {"tiles_with_surfaces", "tiles_without_surfaces"} & set(other.counters)


def test_a_surface_alone_is_all_that_is_sampled(context):
    """Nothing else shows: samples are where surfaces are looked for."""
    alone = counted(context, scene_of(CORNER, NOTHING, isosurface=[BALL]))
    with_haze = counted(context, scene_of(CORNER, HAZE, isosurface=[BALL]))
    assert alone.counters["surface_hits"] == with_haze.counters["surface_hits"] > 0
    assert alone.samples < 0.5 * with_haze.samples


# --- fields --------------------------------------------------------------------------------------

POINTS = [{"value": v, "opacity": o, "color": GREY} for v, o in ((0.0, 0.0), (1.0, 0.1))]


def field_of(array, spacing=None, origin=(0.0, 0.0, 0.0)) -> Volume:
    spacing = spacing or DEPTH / (len(array) - 1)
    return Volume(np.ascontiguousarray(array), spacing=(spacing,) * 3, origin=origin)


def test_labels_are_asked_only_where_something_shows(context):
    """And of each field at most once a sample."""
    labels = field_of(np.ones((9, 9, 9), np.uint8))
    tables = {"file": labels, "role": "label", "labels": [{"label": 1, "color": [1, 0, 0]}]}
    for count in (1, 2):
        data = counted(context, scene_of(field=[tables] * count))
        assert data.counters == {"field_samples": count * showing(scene_of()) * DEPTH}


def test_labels_are_asked_only_within_their_grid(context):
    x = field_of(np.ones((5, 5, 5), np.uint8), 1.0, (24.0, 14.0, 14.0))  # to 28, 18, 18
    resolved = scene_of(
        field=[{"file": x, "role": "label", "labels": [{"label": 1, "color": [1, 0, 0]}]}]
    )
    counters = counted(context, resolved).counters
    # Half a voxel around the grid a voxel of it is still the nearest.
    inside = np.abs(rays_at(resolved) - [26.0, 16.0]).max(axis=1)
    low, high = (inside < 2.0).sum() * 4, (inside < 2.6).sum() * 6
    assert 0 < low <= counters["field_samples"] <= high


def test_a_mask_is_asked_at_both_ends_of_what_shows(context):
    mask = field_of(np.broadcast_to(np.linspace(0, 1, 9, dtype=np.float32), (9, 9, 9)))
    resolved = scene_of(field=[{"file": mask, "role": "mask", "threshold": 0.25}])
    counters = counted(context, resolved).counters
    assert counters == {"field_samples": 2 * showing(resolved) * DEPTH}


def test_a_density_is_not_looked_for_where_it_is_0(context):
    """Its cells alone are walked through where the volume shows nothing."""
    array = np.zeros((17, 17, 17), np.float32)
    array[3:5, 3:5, 3:5] = 1.0  # 4 to 10 in the world
    tables = {"field": [{"file": field_of(array), "role": "density", "points": POINTS}]}
    resolved = scene_of(RAMP, NOTHING, **tables)
    leaping, walking = (
        Raycaster(context, resolved, skip=skip).render(resolved.camera, *PIXELS)
        for skip in (True, False)
    )
    assert np.array_equal(leaping.rgba, walking.rgba) and leaping.rgba.max() > 0.01
    assert walking.counters["field_samples"] == PIXELS[0] * PIXELS[1] * DEPTH
    assert 0 < leaping.counters["field_samples"] < 0.3 * walking.counters["field_samples"]


# --- nothing else --------------------------------------------------------------------------------

COUNTED = (
    ({}, set()),
    ({"light": [SUN]}, NAMES),
    ({"light": [SUN], "shadow": {"method": "rays"}}, NAMES | {"shadow_rays", "shadow_samples"}),
    ({"light": [SUN], "shadow": {"method": "volume", "resolution": 5}}, NAMES),
    ({"isosurface": [{"value": 24.0}]},
     {"surface_tests", "surface_hits", "tiles_with_surfaces", "tiles_without_surfaces"}),
    ({"isosurface": [{"value": 24.0, "opacity": 0.5, "refraction": 1.2}]},
     {"gradients", "surface_tests", "surface_hits", "bends"}),
    ({"clip": [{"point": [16.0, 16.0, 16.0], "normal": [1.0, 0.2, 0.1]}]}, set()),
    ({"noise": [{"target": "value", "amplitude": 2.0}]}, set()),
    ({"noise": [{"target": "fur", "amplitude": 2.0, "root": 24.0, "tip": 9.0}]}, {"gradients"}),
    ({"depth_cue": {}}, set()),
    ({"animation": {"time": 0.3, "cycle": 0.5}}, set()),
    ({"integration": {"compositing": "maximum"}}, set()),
    ({"integration": {"filter": "cubic"}}, set()),
    ({"light": [{**SUN, "intensity": 0.0}], "shadow": {"method": "rays"}}, set()),
)  # fmt: skip


@pytest.mark.parametrize("tables, names", COUNTED, ids=[" ".join(t) or "none" for t, _ in COUNTED])
def test_nothing_is_counted_of_what_is_not_compiled(context, tables, names):
    assert set(counted(context, scene_of(**tables)).counters) == names


def test_stats_have_the_counters_of_a_frame(device):
    from clvol import Renderer

    with Renderer(scene_of(light=[SUN]), devices=[device]) as renderer:
        stats = renderer.render().stats
        assert stats["counters"] == dict.fromkeys(NAMES, showing(scene_of()) * DEPTH)
        assert renderer.render().stats["counters"] == stats["counters"]
    with Renderer(scene_of(), devices=[device]) as renderer:
        assert "counters" not in renderer.render().stats
