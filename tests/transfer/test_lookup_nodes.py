"""Lookup nodes: values that maps of empty space tell apart."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.transfer import TransferFunction
from clvol.transfer.lookup_nodes import lookup_nodes, visible_cells

COLORS = [[0.9, 0.1, 0.0], [0.0, 0.8, 0.1], [0.1, 0.2, 1.0], [0.7, 0.7, 0.2], [1.0, 0.0, 1.0], [0, 1, 1]]
FUNCTIONS = {
    "ramps": ([0, 10, 25, 40, 63], [0, 0.01, 0.3, 0.05, 0.6]),
    "peaks": ([0, 20, 22, 24, 63], [0, 0, 0.95, 0, 0]),
    "opaque plateau": ([0, 20, 30, 40, 63], [0, 0, 1, 1, 0.2]),
    "touches opaque": ([0, 20, 30, 40, 63], [0, 0.2, 1, 0.2, 0]),
    "opaque everywhere": ([0, 63], [1, 1]),
    "step": ([0, 30, 30, 45, 63], [0.02, 0.1, 0.9, 0.9, 0]),
    "step to opaque": ([0, 31, 31, 45, 63], [0, 0, 1, 1, 0]),
    "nearly transparent": ([0, 30, 63], [1e-9, 3e-7, 1e-12]),
    "nearly opaque": ([0, 30, 63], [1 - 1e-7, 0.999999, 1 - 1e-12]),
    "narrower than a cell": ([0, 30.2, 30.4, 30.6, 63], [0, 0, 0.9, 0, 0]),
}


def function_of(name: str, unit: float = 1.0) -> TransferFunction:
    values, opacities = FUNCTIONS[name]
    return TransferFunction(values, opacities, COLORS[: len(values)], unit)


def test_integer_values_with_integer_points_have_them_all_as_nodes():
    nodes = lookup_nodes(function_of("ramps"), (0.0, 63.0), 256, integer=True)
    assert nodes.warp is None
    assert set(FUNCTIONS["ramps"][0]) <= set(nodes.values)
    assert nodes.values.size == 253 and nodes.position(10.5) == 42.0


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("integer", [True, False])
@pytest.mark.parametrize("range_", [(0.0, 63.0), (0.0, 65535.0), (-32768.0, 32767.0)])
def test_nodes_ascend_fill_the_range_and_lie_where_the_warp_says(name, integer, range_):
    nodes = lookup_nodes(function_of(name), range_, 256, integer=integer)
    assert np.all(np.diff(nodes.values) > 0)
    assert nodes.values[0] == range_[0] and nodes.values[-1] >= range_[1]
    assert nodes.values.size <= 256
    inside = nodes.position(nodes.values)
    np.testing.assert_allclose(inside, np.arange(nodes.values.size), atol=1e-3)
    if nodes.warp is not None:
        assert np.all(np.diff(nodes.warp) >= 0)


def kernel_position(nodes, value) -> np.float32:
    """The table coordinate as the kernels compute it, in float32."""
    p = (np.float32(value) - np.float32(nodes.first)) * np.float32(nodes.per_value)
    if nodes.warp is None:
        return p
    b = int(min(p, nodes.warp.size - 2))
    return nodes.warp[b] + (p - np.float32(b)) * (nodes.warp[b + 1] - nodes.warp[b])


@pytest.mark.parametrize("name", [name for name in FUNCTIONS if name != "narrower than a cell"])
@pytest.mark.parametrize("may_warp, count", [(True, 256), (False, 4096)])
@pytest.mark.parametrize("low, high", [(0.0, 63.0), (-3.3, 3070.9), (-517.0, 64.0)])
def test_a_control_points_coordinate_is_its_node(name, may_warp, count, low, high):
    function = function_of(name)
    nodes = lookup_nodes(function, (low, high), count, integer=False, may_warp=may_warp)
    steps = {v for v, w in zip(function.values, function.values[1:]) if v == w}
    for value in set(function.values) if nodes.warp is not None else ():
        if not low < value < high:
            continue
        position = kernel_position(nodes, value)
        node = round(float(position))
        assert position == pytest.approx(node, abs=0.02)
        assert nodes.values[node] == value
        if value in steps:
            assert node <= position < node + 1e-3, "nothing of what is before the step is left"
            assert kernel_position(nodes, value - 2e-4 * (high - low)) <= node - 1
    assert nodes.warp is not None or not (steps and not may_warp)


def test_integer_voxels_have_a_node_each_where_steps_are_between_them():
    step = TransferFunction([-500, 100, 100, 3000], [0, 0, 0.9, 0.9], COLORS[:4])
    nodes = lookup_nodes(step, (-32768.0, 32767.0), 4096, integer=True, may_warp=False)
    assert nodes.warp is None and np.array_equal(nodes.values, np.arange(-32768.0, 32768.0))


def test_a_narrow_peak_gets_its_share_of_the_nodes():
    function = TransferFunction([0, 3000, 3010, 3020, 65535], [0, 0, 0.9, 0, 0], [[1, 1, 1]] * 5)
    nodes = lookup_nodes(function, (0.0, 65535.0), 256, integer=True)
    assert ((nodes.values >= 3000) & (nodes.values <= 3020)).sum() > 40


@pytest.mark.parametrize("name", FUNCTIONS)
def test_cells_called_invisible_hold_no_opacity(name):
    function = function_of(name)
    for nodes in (np.arange(64.0), np.linspace(0, 63, 37)):
        visible = visible_cells(function, nodes)
        between = function.opacity(np.linspace(nodes[:-1], nodes[1:], 101)) > 0
        assert not np.any(between.any(axis=0) & ~visible)
