"""The arguments of kernels, declared as objects and checked at each call.

    ARGUMENTS = (
        reads("rays", np.int32, "count"),
        value("count", np.int32),
        writes("changes", np.float32, "count"),
    )

Lists of arguments are composed by ``+``, in the order of the kernel's parameters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from clvol.errors import RenderError

INT4 = np.dtype(("i4", 4))
FLOAT4 = np.dtype(("f4", 4))
RAW = np.dtype("V1")
"""Bytes of any type: the kernel's switches say what they hold."""

Size = int | str


@dataclass(frozen=True)
class Argument:
    """One parameter of a kernel.

    intent: "in", a buffer that is read; "out", a buffer that is written; "value", a scalar or a vector.
    dtype: of a buffer's elements, or of the value. ``RAW`` stands for any, and then ``shape`` counts bytes.
    shape: the least shape of a buffer: numbers, or names of integers that are known when the kernel is called, namely
        its own integer values (for a vector "name.x" to "name.w") and the ``sizes`` of the call. The buffer must hold
        their product. Empty: one element.
    """

    name: str
    dtype: np.dtype
    intent: str
    shape: tuple[Size, ...] = ()

    def __post_init__(self) -> None:
        if self.intent not in ("in", "out", "value"):
            raise ValueError(f"intent {self.intent!r} of {self.name!r}")

    def check_buffer(self, kernel: str, array: Any, sizes: Mapping[str, int]) -> None:
        """RenderError unless ``array`` (with ``dtype`` and ``shape``) fits the declaration."""
        is_raw = self.dtype is RAW
        if not is_raw and array.dtype != self.dtype:
            raise RenderError(self._where(kernel), f"got {array.dtype}", str(self.dtype))
        held = math.prod(array.shape) * (array.dtype.itemsize if is_raw else 1)
        least = 1
        for size in self.shape:
            if isinstance(size, str) and size not in sizes:
                raise RenderError(self._where(kernel), f"no size {size!r}", f"one of {', '.join(sizes) or 'none'}")
            least *= sizes[size] if isinstance(size, str) else size
        if held < least:
            unit = "bytes" if is_raw else "elements"
            shape = " by ".join(str(size) for size in self.shape)
            raise RenderError(self._where(kernel), f"got {held} {unit}", f"at least {least} ({shape})")

    def _where(self, kernel: str) -> str:
        return f"kernel {kernel}, argument {self.name}"

    def checked_value(self, kernel: str, given: Any) -> Any:
        """``given`` converted to the declared type; RenderError where its shape differs, or an integer does not fit."""
        where = self._where(kernel)
        try:
            converted = np.asarray(given, dtype=self.dtype.base)
        except (TypeError, ValueError, OverflowError):
            raise RenderError(where, f"got {given!r}", str(self.dtype)) from None
        if converted.shape != self.dtype.shape:
            raise RenderError(where, f"got shape {converted.shape}", f"shape {self.dtype.shape}")
        return converted if converted.shape else self.dtype.type(converted)


def known_sizes(values: Mapping[str, Any]) -> dict[str, int]:
    """The sizes by name that shapes may refer to, from a call's checked ``values``: integers, and those in vectors as
    "name.x"."""
    known = {}
    for name, given in values.items():
        if isinstance(given, np.integer):
            known[name] = int(given)
        elif isinstance(given, np.ndarray) and given.dtype.kind == "i":
            known |= {f"{name}.{axis}": int(n) for axis, n in zip("xyzw", given)}
    return known


def reads(name: str, dtype: Any, *shape: Size) -> Argument:
    """A buffer that the kernel reads."""
    return Argument(name, np.dtype(dtype), "in", shape)


def writes(name: str, dtype: Any, *shape: Size) -> Argument:
    """A buffer that the kernel writes and may read."""
    return Argument(name, np.dtype(dtype), "out", shape)


def value(name: str, dtype: Any) -> Argument:
    """A scalar, or a vector: ``INT4``, ``FLOAT4``."""
    return Argument(name, np.dtype(dtype), "value")
