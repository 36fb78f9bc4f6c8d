"""Structs are the same on the host and on the device: each field by name, offset and size."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
import pytest

from clvol.errors import RenderError
from clvol.opencl import struct_check
from clvol.opencl.struct_check import REPORT_ARGUMENTS, check_structs, layout_of, reported_structs
from clvol.opencl.structs import (
    BLOCK_PAYLOAD,
    BLOCKS,
    EFFECTS,
    FIELD,
    NOISE_TERM,
    PYRAMID,
    struct,
    view_dtype,
)

SOURCE = """
#include "lanes.h"
#include "view.h"
#include "effects.h"
#include "block_parameters.h"
#include "pyramid.h"
#include "decode_blocks.cl"
#define REPORTED_FIELDS VIEW_FIELDS, EFFECTS_FIELDS, BLOCKS_FIELDS, PYRAMID_FIELDS, BLOCK_PAYLOAD_FIELDS
REPORT_FIELDS
"""
SHARED = {
    "Effects": EFFECTS, "Field": FIELD, "NoiseTerm": NOISE_TERM, "Blocks": BLOCKS, "Pyramid": PYRAMID,
    "BlockPayload": BLOCK_PAYLOAD,
}  # fmt: skip
SWITCHES = {
    "LANES": 1, "VOXEL_SIGNED": 0, "VOXEL_SCALED": 0, "VOXEL_PAIRS": 0, "VOXEL_HOLES": 0, "FILTER": 1, "WORKERS": 1,
    "TILE": 32, "SAMPLE_BUFFERS": 1, "STAGED_DOUBLE": 0,
}  # fmt: skip


@pytest.fixture(scope="module")
def reporter(tmp_path_factory, context):
    path = tmp_path_factory.mktemp("kernels") / "structs.cl"
    path.write_text(SOURCE)

    def kernel(bits):
        return context.kernel(str(path), "struct_fields", REPORT_ARGUMENTS, {**SWITCHES, "VOXEL_BITS": bits})

    return kernel


@pytest.mark.parametrize("bits", [8, 16, 32, 64])
def test_every_field_is_where_the_compiler_has_it(context, reporter, bits):
    expected = {**SHARED, "View": view_dtype(bits)}
    check_structs(context, reporter(bits), expected)
    assert reported_structs(context, reporter(bits)) == {name: layout_of(dtype) for name, dtype in expected.items()}


def _swapped(dtype: np.dtype, a: str, b: str) -> np.dtype:
    """``dtype`` with the places of two fields of the same type exchanged."""
    fields = {name: [field[0], field[1]] for name, field in dtype.fields.items()}
    fields[a][1], fields[b][1] = fields[b][1], fields[a][1]
    formats, offsets = zip(*fields.values())
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": dtype.itemsize})


@pytest.mark.parametrize("name, dtype, a, b", [
    ("View", view_dtype(8), "step", "stop_opacity"),
    ("View", view_dtype(8), "plane_du", "plane_dv"),
    ("Effects", EFFECTS, "ambient", "diffuse"),
    ("NoiseTerm", NOISE_TERM, "octaves", "first_texel"),
    ("Pyramid", PYRAMID, "cells", "free_cells"),
    ("Blocks", BLOCKS, "edge", "inverse_edge"),
])  # fmt: skip
def test_two_fields_that_are_swapped_are_found(context, reporter, name, dtype, a, b):
    with pytest.raises(RenderError, match=rf"struct {name}, field ({a}|{b}): .* bytes at \d+ on the device"):
        check_structs(context, reporter(8), {name: _swapped(dtype, a, b)})


def test_a_field_of_one_side_alone_is_found(context, reporter):
    more = struct(("int4", "count"), ("float", "edge inverse_edge"), ("int", "log_edge spare"))
    with pytest.raises(RenderError, match="struct Blocks"):
        check_structs(context, reporter(8), {"Blocks": more})
    renamed = struct(("int4", "count"), ("float", "edge inverse"), ("int", "log_edge"))
    with pytest.raises(RenderError, match="struct Blocks, field inverse: no such field on the device"):
        check_structs(context, reporter(8), {"Blocks": renamed})
    with pytest.raises(RenderError, match="struct Lights: is not reported"):
        check_structs(context, reporter(8), {"Lights": renamed})


def test_fields_are_aligned_as_in_opencl():
    made = struct(("int", "a"), ("float4", "b"), ("float2", "c"), ("int", "d"), (BLOCKS, "e", 2), ("double", "f"))
    assert {name: field[1] for name, field in made.fields.items()} == {
        "a": 0, "b": 16, "c": 32, "d": 40, "e": 48, "f": 48 + 2 * BLOCKS.itemsize,
    }  # fmt: skip
    assert made.itemsize % 16 == 0 and BLOCKS.itemsize == 32
    with pytest.raises(ValueError, match="type 'float3' of 'a'"):
        struct(("float3", "a"))


def test_a_program_is_asked_once(context, reporter, monkeypatch):
    asked = []
    reported = struct_check.reported_structs
    monkeypatch.setattr(struct_check, "reported_structs", lambda *given: asked.append(1) or reported(*given))
    monkeypatch.setattr(struct_check, "_matching", WeakKeyDictionary())
    for _ in range(3):
        check_structs(context, reporter(16), {"View": view_dtype(16)})
    assert len(asked) == 1
    check_structs(context, reporter(16), SHARED)  # other structs, and another program, are asked for
    check_structs(context, reporter(8), {"View": view_dtype(8)})
    assert len(asked) == 3
    for _ in range(2):
        with pytest.raises(RenderError):
            check_structs(context, reporter(8), {"View": _swapped(view_dtype(8), "step", "stop_opacity")})
