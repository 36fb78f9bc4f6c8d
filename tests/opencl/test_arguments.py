"""Arguments of kernels: what is declared is checked before anything is enqueued."""

from __future__ import annotations

import numpy as np
import pytest

from clvol.errors import RenderError
from clvol.opencl.arguments import FLOAT4, INT4, RAW, reads, value, writes

SOURCE = """
kernel void scale(global const float *in_, int n, int4 box, float4 weight, global float *out, global const uchar *any)
{
  for (int k = 0; k < n; ++k) out[k] = in_[k] * weight.x + (float)(box.y + any[0]);
}
"""
ARGUMENTS = (
    reads("in_", np.float32, "n"),
    value("n", np.int32),
    value("box", INT4),
    value("weight", FLOAT4),
    writes("out", np.float32, "n", "columns"),
    reads("any", RAW, "box.x", 2),
)


@pytest.fixture(scope="module")
def scale(tmp_path_factory, context):
    path = tmp_path_factory.mktemp("kernels") / "scale.cl"
    path.write_text(SOURCE)
    return context.kernel(str(path), "scale", ARGUMENTS)


def call(context, scale, sizes=None, **changes):
    given = {
        "in_": context.upload(np.arange(3, dtype=np.float32)), "n": 3, "box": (2, 7, 0, 0), "weight": (2, 0, 0, 0),
        "out": context.empty(np.float32, (3,)), "any": context.upload(np.ones(4, np.uint8)),
    } | changes  # fmt: skip
    scale(context.queue, (1,), None, sizes=sizes or {"columns": 1}, **given)
    return context.read(given["out"])


def test_a_kernel_gets_what_is_declared(context, scale):
    assert call(context, scale).tolist() == [8.0, 10.0, 12.0]


def test_raw_bytes_may_be_of_any_type(context, scale):
    assert call(context, scale, any=context.upload(np.ones(2, np.int16))).tolist() == [8.0, 10.0, 12.0]


@pytest.mark.parametrize("name, array, message", [
    ("in_", np.zeros(3, np.float64), "argument in_: got float64, expected float32"),
    ("in_", np.zeros(2, np.float32), r"argument in_: got 2 elements, expected at least 3 \(n\)"),
    ("any", np.zeros(3, np.uint8), r"argument any: got 3 bytes, expected at least 4 \(box.x by 2\)"),
    ("out", np.zeros((2, 1), np.float32), r"argument out: got 2 elements, expected at least 3 \(n by columns\)"),
])  # fmt: skip
def test_a_wrong_type_or_too_small_a_buffer_is_refused(context, scale, name, array, message):
    with pytest.raises(RenderError, match=message):
        call(context, scale, **{name: context.upload(array)})


def test_sizes_of_the_call_count(context, scale):
    with pytest.raises(RenderError, match="at least 12"):
        call(context, scale, {"columns": 4})
    with pytest.raises(RenderError, match="no size 'columns'"):
        call(context, scale, {"rows": 1})


@pytest.mark.parametrize("changes, message", [
    ({"box": (1, 2, 3)}, r"argument box: got shape \(3,\), expected shape \(4,\)"),
    ({"n": "many"}, "argument n: got 'many', expected int32"),
    ({"n": 2**40}, "argument n: got 1099511627776, expected int32"),
    ({"in_": np.zeros(3, np.float32)}, "argument in_: got ndarray, expected a DeviceArray"),
    ({"more": 1}, "kernel scale: got .*more"),
])  # fmt: skip
def test_wrong_values_are_refused(context, scale, changes, message):
    with pytest.raises(RenderError, match=message):
        call(context, scale, **changes)


def test_as_many_arguments_as_the_kernel_takes_must_be_declared(context, tmp_path):
    path = tmp_path / "scale.cl"
    path.write_text(SOURCE)
    with pytest.raises(RenderError, match="takes 6 arguments, expected the 5 that are declared"):
        context.kernel(str(path), "scale", ARGUMENTS[:-1])


def test_an_intent_is_one_of_three():
    with pytest.raises(ValueError, match="intent 'inout'"):
        type(ARGUMENTS[0])("a", np.dtype("i4"), "inout")
