"""Midpoints, sharpness and colour spaces beside VTK itself, where it is installed (extra "bench")."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.transfer import linear_to_srgb
from clvol.transfer.exchange.sampled import COLOR_ERROR, OPACITY_ERROR
from clvol.transfer.exchange.vtk_nodes import Nodes, color_knots, opacity_knots
from clvol.transfer.exchange.vtk_spaces import between, hsv_to_rgb, lab_to_rgb, rgb_to_hsv, rgb_to_lab

# What VTK 9.7 says of two nodes: weights at quarters (vtkPiecewiseFunction) for (midpoint, sharpness).
WEIGHTS = {
    (0.5, 0.0): [0.25, 0.5, 0.75],
    (0.25, 0.0): [0.5, 2 / 3, 5 / 6],
}


def interpolated(knots, at) -> np.ndarray:
    return np.stack([np.interp(at, knots[0], column) for column in knots[1].T], axis=1)


@pytest.mark.parametrize(("how", "weights"), WEIGHTS.items())
def test_linear_nodes_have_a_kink_at_the_midpoint(how, weights):
    nodes = Nodes(np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), np.full(2, how[0]), np.full(2, how[1]))
    assert interpolated(opacity_knots(nodes), [0.25, 0.5, 0.75])[:, 0] == pytest.approx(weights, abs=1e-12)


def test_colour_spaces_come_back():
    rng = np.random.default_rng(3)
    rgb = rng.uniform(0.0, 1.0, (200, 3))
    assert np.abs(lab_to_rgb(rgb_to_lab(rgb)) - rgb).max() < 2e-3  # the matrices have four digits
    assert np.abs([hsv_to_rgb(rgb_to_hsv(color)) - color for color in rgb]).max() < 1e-12


def test_cool_to_warm_goes_through_grey():
    """Moreland (2009), figure 11: the middle of the map is (221, 221, 221)."""
    cool, warm = np.array([59, 76, 192]) / 255, np.array([180, 4, 38]) / 255
    middle = between(cool, warm, np.array([0.25, 0.5, 0.75]), "Diverging", wrap=True) * 255
    assert np.abs(middle - [[141, 176, 254], [221, 221, 221], [244, 154, 123]]).max() < 1.5


@pytest.fixture(scope="module")
def vtk():
    return pytest.importorskip("vtkmodules.vtkRenderingCore", reason="vtk (extra bench) is not installed")


@pytest.mark.parametrize("space", ["RGB", "HSV", "Lab", "Diverging"])
def test_colours_are_those_of_vtk(vtk, space):
    rng = np.random.default_rng(1)
    at = np.linspace(0.0, 100.0, 400)
    for _ in range(20):
        values = np.sort(rng.uniform(0.0, 100.0, 4))
        # Hues that are less than half a turn apart, about which versions of VTK agree.
        table = rng.uniform(0.0, 1.0, (4, 3)) if space != "Diverging" else rng.uniform(0.6, 1.0, (4, 3)) * [1, 0.9, 0.4]
        midpoints, sharpnesses = rng.uniform(0.1, 0.9, 4), rng.choice([0.0, 0.0, 0.3, 0.8], 4)
        function = vtk.vtkColorTransferFunction()
        getattr(function, f"SetColorSpaceTo{space}")()
        for value, color, midpoint, sharpness in zip(values, table, midpoints, sharpnesses):
            function.AddRGBPoint(value, *color, midpoint, sharpness)
        knots = color_knots(Nodes(values, table, midpoints, sharpnesses), space)
        wanted = np.array([function.GetColor(value) for value in at])
        assert np.abs(linear_to_srgb(interpolated(knots, at)) - wanted).max() < COLOR_ERROR


def test_opacities_are_those_of_vtk(vtk):
    from vtkmodules.vtkCommonDataModel import vtkPiecewiseFunction

    rng = np.random.default_rng(2)
    at = np.linspace(0.0, 100.0, 400)
    for _ in range(40):
        values, table = np.sort(rng.uniform(0.0, 100.0, 5)), rng.uniform(0.0, 1.0, 5)
        midpoints, sharpnesses = rng.uniform(0.1, 0.9, 5), rng.choice([0.0, 0.005, 0.02, 0.3, 0.8, 0.98], 5)
        function = vtkPiecewiseFunction()
        for point in zip(values, table, midpoints, sharpnesses):
            function.AddPoint(*point)
        knots = opacity_knots(Nodes(values, table[:, None], midpoints, sharpnesses))
        wanted = np.array([function.GetValue(value) for value in at])
        assert np.abs(interpolated(knots, at)[:, 0] - wanted).max() < OPACITY_ERROR
