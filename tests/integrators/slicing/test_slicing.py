"""The method "slicing" against its plain twin, the exact integral, and itself where nothing may differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.small_scenes import SMOOTH, axis_camera, exact, make_scene, rms, waves
from reference.slicing import render_slices_twin, rounded

from clvol import Slicing, TransferFunction, Volume
from clvol.errors import RenderError, SceneError
from clvol.integrators.registry import check_scene
from clvol.integrators.slicing.caster import SlicingCaster
from clvol.integrators.slicing.slices import facing_axis

GEOMETRIES = ("object-aligned", "object-aligned-interpolated", "view-aligned", "shells")
CAMERA = {"position": [40.0, 31.0, -26.0], "target": [10.0, 8.0, 9.0], "up": [0.0, 1.0, 0.0], "fov_degrees": 40.0}
FLAT = {"projection": "orthographic", "height": 30.0, **{k: v for k, v in CAMERA.items() if k != "fov_degrees"}}
CENTRE = (11.0, 8.0, 9.0)


def slicing_scene(array=None, camera=None, function=SMOOTH, *, grid=None, image=(24, 20), step=1.0,
                  classification="preintegrated", filter="linear", early_termination=0.0, **slicing):
    scene = make_scene(
        array, function, camera=camera or CAMERA, width=image[0], height=image[1], grid=grid, method="slicing",
        step=step, classification=classification, filter=filter, early_termination=early_termination,
    )  # fmt: skip
    return replace(scene, slicing=Slicing(**slicing))


def sliced(context, scene) -> np.ndarray:
    data = SlicingCaster(context, scene).render(scene.camera, scene.image.width, scene.image.height)
    return data.rgba


@pytest.mark.parametrize("classification", ("preintegrated", "post", "pre"))
@pytest.mark.parametrize("camera", (CAMERA, FLAT), ids=["perspective", "orthographic"])
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_pictures_are_those_of_the_twin(context, geometry, camera, classification):
    scene = slicing_scene(camera=camera, geometry=geometry, classification=classification)
    assert np.abs(sliced(context, scene) - render_slices_twin(scene)).max() < 2e-5


@pytest.mark.parametrize("slices", (2, 7, 40))
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_a_number_of_slices_is_spread_over_the_volume(context, geometry, slices):
    scene = slicing_scene(geometry=geometry, slices=slices, grid={"spacing": (1.0, 1.5, 0.8)})
    assert np.abs(sliced(context, scene) - render_slices_twin(scene)).max() < 5e-5


@pytest.mark.parametrize("accumulate", ("half", "uint8"))
def test_pixels_are_rounded_after_each_slice(context, accumulate):
    scene = slicing_scene(accumulate=accumulate, classification="post")
    got = sliced(context, scene).astype(np.float64)
    assert np.abs(got - rounded(got, accumulate)).max() < 1e-7
    # A value next to a tie may go either way, and what follows differs by one last place or so.
    difference = np.abs(got - render_slices_twin(scene))
    assert difference.max() <= {"half": 2.0**-10, "uint8": 2.5 / 255}[accumulate]
    assert (difference < 1e-5).mean() > 0.9


def test_half_floats_are_rounded_as_numpy_rounds_them(context):
    """Of all magnitudes: very thin media leave denormal halves."""
    for thinner in (1e3, 1e5, 1e7):
        function = TransferFunction(SMOOTH.values, SMOOTH.opacities, SMOOTH.colors, opacity_unit=thinner)
        got = sliced(context, slicing_scene(accumulate="half", function=function))
        assert np.array_equal(got, got.astype(np.float16).astype(np.float32))


def test_without_correction_a_slice_counts_the_same_from_any_angle(context):
    scene = slicing_scene(geometry="object-aligned", opacity_correction=False)
    thin = sliced(context, scene)
    assert np.abs(thin - render_slices_twin(scene)).max() < 2e-5
    corrected = sliced(context, slicing_scene(geometry="object-aligned"))
    assert (thin[..., 3] <= corrected[..., 3] + 1e-6).all() and (thin[..., 3] < corrected[..., 3] - 1e-3).any()


@pytest.mark.parametrize("geometry", GEOMETRIES[1:])  # of planes of voxels there are no more than voxels
@pytest.mark.parametrize("classification", ("preintegrated", "post"))
def test_pictures_converge_to_the_exact_integral(context, device, geometry, classification):
    """To first order: what is in front of a ray's first slice and behind its last one is missing or too much."""
    errors = []
    truth = exact(device, slicing_scene())
    for slices in (12, 48, 192):
        scene = slicing_scene(geometry=geometry, classification=classification, slices=slices)
        errors.append(rms(sliced(context, scene), truth))
    assert errors[1] < 0.35 * errors[0] and errors[2] < 0.35 * errors[1] and errors[2] < 8e-3


def test_the_stack_that_faces_the_view_is_drawn(context):
    volume = Volume(waves((9, 12, 15)))
    for axis in range(3):
        for sign in (-1, 1):
            scene = slicing_scene(volume, axis_camera((7.0, 5.5, 4.0), axis, 12.0, sign=sign))
            assert facing_axis(scene, scene.camera) == axis


def test_a_stack_pops_at_45_degrees_and_planes_across_the_view_do_not(context):
    def step_over(geometry):
        pictures = []
        for degrees in (44.99, 45.01):
            a = np.radians(degrees)
            position = [CENTRE[0] + 40 * np.sin(a), CENTRE[1], CENTRE[2] - 40 * np.cos(a)]
            camera = {**FLAT, "position": position, "target": list(CENTRE)}
            pictures.append(sliced(context, slicing_scene(camera=camera, geometry=geometry, classification="post")))
        return rms(*pictures)

    assert step_over("object-aligned") > 20 * step_over("view-aligned")


def test_shells_of_an_orthographic_view_are_planes(context):
    pictures = [sliced(context, slicing_scene(camera=FLAT, geometry=g)) for g in ("shells", "view-aligned")]
    assert np.array_equal(*pictures)


def test_shells_are_evenly_spaced_on_every_ray_of_a_wide_view(context):
    """A constant volume: planes are as far apart as the ray is slanted, which correction makes up for."""
    camera = {**CAMERA, "position": [10.0, 8.0, -4.0], "target": [10.0, 8.0, 9.0], "fov_degrees": 120.0}
    for geometry in ("shells", "view-aligned"):
        scene = slicing_scene(camera=camera, geometry=geometry)
        assert np.abs(sliced(context, scene) - render_slices_twin(scene)).max() < 2e-5


def test_slices_are_not_more_than_can_be_counted(context):
    scene = slicing_scene(step=1e-5)
    with pytest.raises(RenderError, match="slices by the method 'slicing', expected at most 1048576"):
        sliced(context, scene)


@pytest.mark.parametrize("filter", ("nearest", "cubic", "catmull-rom"))
def test_filters(context, filter):
    scene = slicing_scene(filter=filter, classification="post")
    assert np.abs(sliced(context, scene) - render_slices_twin(scene)).max() < 5e-5


@pytest.mark.parametrize("shape", ((1, 1, 1), (1, 12, 9), (2, 2, 30)))
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_thin_volumes(context, geometry, shape):
    array = np.full(shape, 120.0, np.float32)
    centre = 0.5 * (np.array(shape[::-1]) - 1)
    away = np.array([0.6, 0.5, -0.7]) * 2.0 * max(shape)
    camera = {**CAMERA, "position": (centre + away).tolist(), "target": centre.tolist()}
    scene = slicing_scene(array, camera, geometry=geometry, step=0.5)
    got = sliced(context, scene)
    assert np.isfinite(got).all() and np.abs(got - render_slices_twin(scene)).max() < 2e-5


def test_voxels_that_are_not_finite_are_transparent(context):
    array = waves((19, 17, 23))
    array[5:9, 4:8, 6:14] = np.nan
    for classification in ("preintegrated", "post"):
        scene = slicing_scene(array, classification=classification, geometry="object-aligned")
        difference = np.abs(sliced(context, scene) - render_slices_twin(scene)).max(axis=-1)
        assert (difference > 2e-5).sum() <= 1  # a ray that passes exactly between such a voxel and another


def test_an_eye_in_the_volume_sees_what_is_before_it(context):
    camera = {**CAMERA, "position": [10.0, 8.0, 6.0], "target": [11.0, 8.5, 12.0], "fov_degrees": 70.0}
    for geometry in ("view-aligned", "shells"):
        scene = slicing_scene(camera=camera, geometry=geometry)
        assert np.abs(sliced(context, scene) - render_slices_twin(scene)).max() < 2e-5


def test_what_slices_cannot_show_is_refused():
    with pytest.raises(SceneError, match="'slicing'"):
        check_scene(make_scene(method="slicing", quadrature="cells"))
    with pytest.raises(SceneError, match="'slicing'"):
        check_scene(make_scene(method="slicing", compositing="maximum"))


def test_both_ends_of_a_slab_sampled_anew_change_no_bit(context):
    """What the bench measures as the work of textures."""
    frames = []
    for samples in (1, 2):
        scene = slicing_scene()
        caster = SlicingCaster(context, scene)
        caster.switches["SLAB_SAMPLES"] = samples
        frames.append(caster.render(scene.camera, 24, 20))
    assert np.array_equal(frames[0].rgba, frames[1].rgba)
    assert 1.7 * frames[0].samples < frames[1].samples < 2 * frames[0].samples


def test_early_termination_takes_fewer_samples(context):
    counts = []
    for stop in (0.0, 0.2):
        scene = slicing_scene(early_termination=stop)
        counts.append(SlicingCaster(context, scene).render(scene.camera, 24, 20).samples)
    assert counts[1] < counts[0]
