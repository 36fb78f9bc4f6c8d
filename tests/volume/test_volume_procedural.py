"""Analytic fields: the stated integrals are the integrals of the stated values."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.errors import VolumeError
from clvol.volume import procedural

FIELDS = [
    procedural.Constant(0.7),
    procedural.LinearRamp((1.0, -2.0, 0.5), 0.25),
    procedural.Step(1, 0.3, 0.2, 0.9),
    procedural.NestedBoxes(
        (0.1, 0.0, -0.1), ((0.9, 0.8, 0.7), (0.5, 0.4, 0.6)), (0.25, 1.0), outside=0.1
    ),
    procedural.Ball((0.1, -0.2, 0.3), 0.8, inside=2.0, outside=0.5),
    procedural.Smooth(),
    procedural.Gaussian((0.1, 0.2, 0.3), 0.4, 3.0),
    procedural.RadialFall((0.1, -0.2, 0.3), (0.8, 0.9, 1.4), 3.0),
    procedural.RadialFall((0.21, -0.17, 0.33), (0.5, 0.5, 0.5)),  # the line runs through its centre
    procedural.Checkerboard(0.35, 0.1, 0.8),
    procedural.MarschnerLobb(),
]
IDS = [type(field).__name__ for field in FIELDS]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("field", FIELDS, ids=IDS)
def test_line_integral_is_the_integral_of_the_values(field, axis) -> None:
    lower, upper, panels = -1.3, 0.95, 200_000
    width = (upper - lower) / panels
    line = [np.array(0.21), np.array(-0.17), np.array(0.33)]
    line[axis] = lower + width * (np.arange(panels) + 0.5)
    summed = field(*line).sum() * width
    line[axis] = np.array(123.0)
    exact = field.line_integral(axis, lower, upper, *line)
    # The midpoint rule is off by at most one panel a jump (12 jumps, values below 4), else by h^2.
    assert abs(float(exact) - summed) < 50.0 * width
    if not isinstance(field, (procedural.Step, procedural.NestedBoxes, procedural.Ball)):
        if not isinstance(field, procedural.Checkerboard):
            assert abs(float(exact) - summed) < 1e-9


@pytest.mark.parametrize("field", FIELDS, ids=IDS)
def test_integrals_add_up_and_broadcast(field) -> None:
    x, y = np.linspace(-1, 1, 5)[None, :], np.linspace(-1, 1, 4)[:, None]
    whole = field.line_integral(2, -0.9, 1.1, x, y, 0.0)
    parts = field.line_integral(2, -0.9, 0.2, x, y, 0.0) + field.line_integral(
        2, 0.2, 1.1, x, y, 0.0
    )
    assert np.shape(whole) == (4, 5)
    np.testing.assert_allclose(whole, parts, rtol=0, atol=1e-12)


@pytest.mark.parametrize("field", FIELDS, ids=IDS)
def test_samples_are_values_at_voxel_centres_in_the_world(field) -> None:
    direction = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    volume = procedural.sample(field, (3, 4, 5), (0.3, 0.2, 0.4), (0.1, -0.5, 0.4), direction)
    assert volume.shape == (3, 4, 5) and volume.dtype == np.float32
    index = np.array([3, 1, 2, 1])
    x, y, z, _ = volume.grid.index_to_world() @ [3, 1, 2, 1]
    assert volume.data[index[2], index[1], index[0]] == np.float32(field(x, y, z))


def test_integer_samples_are_rounded_and_must_fit() -> None:
    volume = procedural.sample(procedural.LinearRamp((10.4, 0, 0)), (2, 2, 3), dtype="uint8")
    assert volume.data[0, 0].tolist() == [0, 10, 21]
    with pytest.raises(VolumeError, match="uint8"):
        procedural.sample(procedural.Constant(300.0), (2, 2, 2), dtype="uint8")


def test_marschner_lobb_lies_in_the_unit_interval_on_its_box() -> None:
    spacing, origin = procedural.unit_box((41, 41, 41))
    field = procedural.MarschnerLobb()
    volume = procedural.sample(field, (41, 41, 41), spacing, origin, dtype="float64")
    lower, upper = volume.value_range
    assert 0.0 <= lower < 0.05 and 0.95 < upper <= 1.0
    np.testing.assert_allclose(volume.grid.world_corners()[7], [1.0, 1.0, 1.0], atol=1e-12)


# --- fields of scenes ------------------------------------------------------------------------------


def test_a_radial_field_falls_to_0_at_the_nearest_face() -> None:
    volume = procedural.scene_field("radial", (9, 11, 17))
    assert volume.shape == (17, 11, 9) and volume.dtype == np.uint8
    assert volume.data[8, 5, 4] == 255
    assert volume.data[8, 5].tolist() == [0, 64, 128, 191, 255, 191, 128, 64, 0]
    assert volume.data[8 - 4, 5, 4] == volume.data[8 + 4, 5, 4] == 0  # as far as the nearest face
    assert volume.data[8 - 3, 5, 4] == 64


def test_an_ellipsoid_reaches_every_face() -> None:
    volume = procedural.scene_field("ellipsoid", (9, 5, 17), (1.0, 4.0, 0.5))
    assert volume.grid.spacing == (1.0, 4.0, 0.5)
    for line in (volume.data[8, 2], volume.data[:, 2, 4], volume.data[8, :, 4]):
        assert line[0] == line[-1] == 0 and line[line.size // 2] == 255 and line[1] > 0
    assert volume.data[0, 0, 0] == 0


def test_spacing_makes_a_radial_field_round_in_the_world() -> None:
    data = procedural.scene_field("radial", (17, 9, 17), (1.0, 2.0, 1.0)).data
    assert np.array_equal(data[8, :, 8], data[8, 4, ::2])


@pytest.mark.parametrize("kind", ["radial", "ellipsoid"])
def test_a_slab_of_one_voxel_holds_the_middle(kind) -> None:
    data = procedural.scene_field(kind, (1, 1, 1)).data
    assert data.item() == 255


def test_a_constant_field_is_the_middle_of_the_bytes() -> None:
    assert (procedural.scene_field("constant", (3, 4, 5)).data == procedural.MIDDLE).all()
