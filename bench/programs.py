"""Kernels of bench/kernels, built against cl/ and called like any other of clvol's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clvol.opencl.arguments import Argument
    from clvol.opencl.context import DeviceContext, Kernel

_FOLDER = Path(__file__).resolve().parent / "kernels"


def bench_kernels(
    context: DeviceContext, file: str, declarations: Mapping[str, Sequence[Argument]], switches: Mapping[str, int]
) -> list[Kernel]:
    """The kernels named in ``declarations`` (name -> arguments) of bench/kernels/``file``."""
    from clvol.opencl.build import build_file
    from clvol.opencl.context import Kernel, compile_options

    program = build_file(context.context, _FOLDER / file, compile_options(switches))
    return [Kernel(program, name, arguments) for name, arguments in declarations.items()]
