"""Filters of any separable kernel: weights, values, derivatives and bounds, against numpy's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.field_points import lattice_points, rough
from helpers.small_scenes import make_scene, picture, waves
from helpers.twin_scenes import scene
from reference import render_twin
from reference.field import Field, axis_taps, mitchell

from clvol import TransferFunction, Volume
from clvol.device.arguments import EFFECT_ARGUMENTS, scene_arguments
from clvol.errors import SceneError
from clvol.explanation import explain
from clvol.features import overshoot
from clvol.features.kernels import COEFFICIENTS, KERNELS, kernel_error, polynomials
from clvol.features.vocabulary import FILTER_REACH, SLOPES, WEIGHTS
from clvol.integrators.raycast.caster import Raycaster
from clvol.opencl.arguments import reads, writes
from clvol.scene import Integration

PLACES = np.linspace(0.0, 1.0, 4001)
LIT = {"light": [{"type": "directional", "direction": [0.3, 0.4, 1.0]}], "material": {"ambient": 0.3}}
SMALL = {"width": 16, "height": 16}
GREY = [[0.3, 0.5, 0.7]]
# A kernel of the scene's own: that of Mitchell and Netravali, at 64 distances per voxel.
TABLE = {"filter": "table", "filter_table": mitchell(np.arange(129) / 64).tolist(), "filter_reach": 2.0}
BY_NAME = {name: {"filter": name} for name in KERNELS} | {"table": TABLE}


def exact(name, derivative=False):
    """[taps, n] at PLACES, of the voxels from reach - 1 before the first one on."""
    _, found = axis_taps(32.0 + PLACES[:-1], 64, name, derivative)
    return found.T


def of_polynomials(name, derivative=False):
    reach = FILTER_REACH[name] + 1
    terms = polynomials(KERNELS[name], reach)
    if derivative:
        terms = terms[:, 1:] * np.arange(1, COEFFICIENTS)
    powers = np.vander(PLACES, terms.shape[1], increasing=True)
    before = terms @ powers.T
    behind = before[::-1, ::-1] * (-1 if derivative else 1)
    return np.concatenate([before, behind])[:, :-1]


@pytest.mark.parametrize("name", KERNELS)
def test_polynomials_are_the_weights(name):
    assert np.abs(of_polynomials(name) - exact(name)).max() < 1e-7
    inside = slice(1, -1)  # differences over a voxel have no derivative
    assert np.abs(of_polynomials(name, True) - exact(name, True))[:, inside].max() < 4e-6
    assert kernel_error(Integration(filter=name)) < 1e-7
    np.testing.assert_allclose(of_polynomials(name).sum(axis=0), 1.0, atol=1e-8)


@pytest.mark.parametrize("name", KERNELS)
def test_bounds_are_those_of_the_weights(name):
    """Above what occurs, by less than a hundredth."""
    for bound, found in ((WEIGHTS[name], exact(name)), (SLOPES[name], exact(name, True))):
        largest = np.abs(found).sum(axis=0).max()
        assert largest <= bound < 1.01 * largest
    assert overshoot(name) == (WEIGHTS[name] ** 3 - 1) / 2


def fields(context, array, name, at, lanes=16):
    """Values and gradients of the device and of numpy at index places [n, 3]: (found, expected)."""
    resolved = scene(array, integration=BY_NAME[name], **LIT, image=SMALL)
    caster = Raycaster(context, resolved, lanes=lanes)
    declared = scene_arguments(caster.switches["VOXEL_BITS"]) + EFFECT_ARGUMENTS
    source = str(Path(__file__).parents[2] / "helpers" / "field_at.cl")
    kernel = context.kernel(
        source, "field_at", declared + (reads("places", np.float32, 3, "n"), writes("found", np.float32, 4, "n")),
        {**caster.switches, "WITH_DEPTH": 0},
    )  # fmt: skip
    n = len(at)
    found = context.empty(np.float32, (4, n))
    kernel(context.queue, (n // lanes,), (1,), sizes={"n": n}, view=context.upload(caster.volume_view()),
           places=context.upload(np.ascontiguousarray(at.T, np.float32)), found=found,
           **caster._scene_arrays(), **caster.effects.arrays)  # fmt: skip
    got = context.read(found).T.astype(np.float64)
    twin = Field(Volume(array), "mitchell" if name == "table" else name)
    places = at.astype(np.float64)
    wanted = np.column_stack([twin.value(places), twin.gradient(places)])
    gain, bias = caster.volume.values.gain, caster.volume.values.bias
    return got / gain + np.array([bias, 0, 0, 0]), wanted


@pytest.mark.parametrize("name", BY_NAME)
def test_values_and_derivatives_are_numpys(context, name):
    array = rough((9, 8, 11), np.float32)
    at = lattice_points(array.shape, 1024)
    found, wanted = fields(context, array, name, at)
    inside = (np.abs(at - np.round(at)) > 1e-3).all(axis=1)  # where the derivative is continuous, too
    assert np.abs(found[:, 0] - wanted[:, 0]).max() < 3e-4  # of 255
    assert np.abs(found[inside, 1:] - wanted[inside, 1:]).max() < 2e-3


@pytest.mark.parametrize("name", ["mitchell", "lanczos3"])
def test_thin_volumes_hold_their_outermost_voxels(context, name):
    for shape in ((1, 3, 8), (2, 2, 2), (3, 1, 4)):
        array = rough(shape, np.float32)
        found, wanted = fields(context, array, name, lattice_points(shape, 128))
        assert np.abs(found[:, 0] - wanted[:, 0]).max() < 3e-4


def test_a_constant_field_is_constant(context):
    array = np.full((6, 7, 16), 37.7, np.float32)
    array[0, 0, 15] = 99.0  # farther away than the filter reaches
    found, _ = fields(context, array, "lanczos3", lattice_points((6, 7, 8), 256))
    assert np.ptp(found[:, 0]) == 0.0 and (found[:, 1:] == 0).all()


def test_what_is_not_finite_spoils_what_uses_it_alone(context):
    array = rough((9, 9, 9), np.float32)
    array[4, 4, 4] = np.nan
    at = lattice_points(array.shape, 2048)
    found, _ = fields(context, array, "lanczos2", at)
    _, wanted = fields(context, np.where(np.isnan(array), 0, array).astype(np.float32), "lanczos2", at)
    one = np.zeros_like(array)
    one[4, 4, 4] = 1
    spoilt = np.abs(Field(Volume(one), "lanczos2").value(at.astype(np.float64))) > 1e-12
    assert spoilt.any() and not np.isfinite(found[spoilt, 0]).any()
    assert np.abs(found[~spoilt, 0] - wanted[~spoilt, 0]).max() < 1e-3


# --- pictures ----------------------------------------------------------------------------------------


CASES = {
    "mitchell": {**LIT, "integration": {"filter": "mitchell"}},
    "lanczos3": {**LIT, "integration": {"filter": "lanczos3", "classification": "preintegrated"}},
    "surfaces": {**LIT, "isosurface": [{"value": 140.0}], "integration": {"filter": "lanczos2"}},
    "voxels": {"integration": {"filter": "mitchell", "classification": "pre"}},
    "maximum": {"integration": {"filter": "windowed-sinc", "compositing": "maximum"}},
}
_FAST = ("mitchell",)


@pytest.mark.parametrize("case", [c if c in _FAST else pytest.param(c, marks=pytest.mark.slow) for c in CASES])
def test_pictures_are_the_twins(context, case):
    function = TransferFunction([0, 100, 255], [0, 0.02, 0.3], [[0.2, 0.4, 0.9], [1, 0.6, 0.3], [1, 1, 1]])
    resolved = scene(waves((12, 13, 14)).astype(np.float32), function, image=SMALL, **CASES[case])
    found = Raycaster(context, resolved).render(resolved.camera, 16, 16).rgba
    assert np.abs(found - render_twin(resolved)).max() < (2e-2 if case == "surfaces" else 1e-3)
    linear = scene(resolved.volume, function, image=SMALL,
                   **{**CASES[case], "integration": {**CASES[case]["integration"], "filter": "linear"}})  # fmt: skip
    assert np.abs(found - render_twin(linear)).max() > 5e-3


@pytest.mark.parametrize("filter", ["lanczos3", "mitchell"])
def test_leaping_changes_no_bit(context, filter):
    array = np.zeros((40, 36, 33), np.float32)
    array[9, 17, 23] = 255  # inside a cell; its lobes are seen in cells around
    array[30, 30, 8] = 255
    beyond = TransferFunction([-90, -30, -20, 30, 180, 300], [0.9, 0.5, 0, 0, 0.5, 0.9], GREY * 6)
    resolved = make_scene(array, beyond, filter=filter, width=48, height=48, classification="post", step=0.6)
    leaping, walking = (picture(context, resolved, skip=skip) for skip in (True, False))
    assert np.array_equal(leaping.rgba, walking.rgba) and leaping.rgba.max() > 0.02
    assert leaping.samples < 0.7 * walking.samples


def test_a_table_is_the_kernel_that_it_holds(context):
    array = rough((8, 8, 8), np.float32)
    at = lattice_points(array.shape, 512)
    found, named = (fields(context, array, name, at)[0] for name in ("table", "mitchell"))
    assert np.abs(found - named)[:, 0].max() < 2e-3  # of 255; a spline through 64 places per voxel
    assert np.abs(found - named)[:, 1:].max() < 0.1  # of 80


# --- what is refused, and what is said ------------------------------------------------------------------


@pytest.mark.parametrize("integration, key, words", [
    ({"filter": "table"}, "filter_table", "4 to 4096 numbers"),
    ({"filter": "linear", "filter_table": [1.0, 0.5, 0.1, 0.0]}, "filter_table", "no filter_table"),
    ({"filter": "table", "filter_table": [1.0, 0.5, 0.1]}, "filter_table", "4 to 4096 numbers"),
    ({"filter": "table", "filter_table": [1.0, 0.5, 0.2, 0.1]}, "filter_table", "the last is 0"),
    ({"filter": "table", "filter_table": [1.0, -1.0, 1.0, -1.0, 0.0]}, "filter_table", "add up to"),
    ({"filter": "lanczos"}, "filter", "'lanczos2'"),
])  # fmt: skip
def test_what_is_no_kernel_is_refused(integration, key, words):
    with pytest.raises(SceneError) as refused:
        explain(scene(waves((6, 6, 6)), integration=integration))
    text = str(refused.value)
    assert f"integration.{key}" in text and words in text and "\n" not in text


@pytest.mark.parametrize("method", ["pyramid", "multiresolution", "reference", "slicing"])
def test_methods_without_them_say_so(method):
    integration = {"filter": "mitchell", "method": method, "classification": "preintegrated"}
    with pytest.raises(SceneError, match="mitchell"):
        explain(scene(waves((6, 6, 6)), integration=integration))


def test_explain_says_how_exact_it_is():
    explained = explain(scene(waves((6, 6, 6)), integration=BY_NAME["lanczos3"]))["effects"]
    told = {effect["name"]: effect["reason"] for effect in explained}
    assert told["lanczos3 filter"] == "the filter is 'lanczos3', of 6 by 6 by 6 voxels, weights to within 1e-07"
