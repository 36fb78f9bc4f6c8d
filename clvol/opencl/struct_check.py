"""Compares the layouts of structs in numpy with those of the device's compiler (cl/struct_fields.h)."""

from __future__ import annotations

from collections.abc import Mapping
from weakref import WeakKeyDictionary

import numpy as np

from clvol.errors import RenderError
from clvol.opencl.arguments import value, writes
from clvol.opencl.context import DeviceContext, Kernel

_CAPACITY = 256
_RECORD = np.dtype([("name", "S56"), ("offset", "u4"), ("bytes", "u4")])  # StructField
REPORT_ARGUMENTS = (writes("fields", _RECORD, "capacity"), value("capacity", np.int32))
"""The arguments of the kernel ``struct_fields`` that REPORT_FIELDS defines."""

Layout = dict[str, tuple[int, int]]  # offset and size in bytes of a struct and of its fields, by name
_matching: WeakKeyDictionary[Kernel, list[dict[str, np.dtype]]] = WeakKeyDictionary()  # what was found to match
_WHOLE = ""  # the name of the struct itself


def check_structs(context: DeviceContext, kernel: Kernel, expected: Mapping[str, np.dtype]) -> None:
    """RenderError unless the device has the structs of ``expected`` (by name in OpenCL C) field for field.

    ``kernel``: ``struct_fields`` of a program that reports them; it may report others. A program is asked once.
    """
    matching, wanted = _matching.setdefault(kernel, []), dict(expected)
    if wanted in matching:
        return
    found = reported_structs(context, kernel)
    for name, dtype in expected.items():
        if name not in found:
            raise RenderError(f"struct {name}", "is not reported by the device", ", ".join(sorted(found)))
        compare(name, found[name], layout_of(dtype))
    matching.append(wanted)


def reported_structs(context: DeviceContext, kernel: Kernel) -> dict[str, Layout]:
    """The layouts that the device reports, by the name of the struct."""
    records = context.upload(np.zeros(_CAPACITY, _RECORD), writable=True)
    kernel(context.queue, (1,), (1,), fields=records, capacity=_CAPACITY)
    found: dict[str, Layout] = {}
    for record in context.read(records):
        owner, _, field = record["name"].decode().partition(".")
        if owner:
            found.setdefault(owner, {})[field] = int(record["offset"]), int(record["bytes"])
    return found


def layout_of(dtype: np.dtype) -> Layout:
    """Offsets and sizes in bytes of a dtype and its fields."""
    fields = {name: (field[1], field[0].itemsize) for name, field in (dtype.fields or {}).items()}
    return {_WHOLE: (0, dtype.itemsize), **fields}


def compare(name: str, device: Layout, ours: Layout) -> None:
    """RenderError for the first field that differs."""
    for field in {**ours, **device}:
        if device.get(field) != ours.get(field):
            where = f"struct {name}" + (f", field {field}" if field else "")
            raise RenderError(where, f"{_said(device.get(field))} on the device", _said(ours.get(field)))


def _said(position: tuple[int, int] | None) -> str:
    return "no such field" if position is None else f"{position[1]} bytes at {position[0]}"
