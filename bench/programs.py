"""Kernels of bench/kernels, built against cl/ and called like any other of clvol's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from clvol.opencl.context import DeviceContext, Kernel

_FOLDER = Path(__file__).resolve().parent / "kernels"


def bench_kernels(
    context: DeviceContext, file: str, declarations: Mapping[str, str], switches: Mapping[str, int]
) -> list[Kernel]:
    """The kernels named in ``declarations`` (name -> arguments) of bench/kernels/``file``."""
    import pyopencl as cl

    from clvol.opencl.context import Kernel, compile_options
    from clvol.opencl.kernels_path import kernel_folder

    source = (_FOLDER / file).read_text(encoding="utf-8")
    options = [*compile_options(switches), "-I", str(kernel_folder())]
    program = cl.Program(context.context, source).build(options, cache_dir=False)
    return [Kernel(program, name, arguments) for name, arguments in declarations.items()]
