"""The folder of the OpenCL C sources, in a wheel, an editable install or a checkout."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from clvol.errors import RenderError


@lru_cache(maxsize=1)
def kernel_folder() -> Path:
    """The folder that holds the ``*.cl`` and ``*.h`` files, to be given to the compiler as ``-I``.

    A wheel carries it as ``clvol/cl``; a checkout (also an editable install of it) as ``cl``
    beside ``clvol``. Raises :class:`clvol.errors.RenderError` when neither is there.
    """
    package = Path(__file__).resolve().parent.parent
    for folder in (package / "cl", package.parent / "cl"):
        if (folder / "probe.cl").is_file():
            return folder
    raise RenderError(str(package), "the OpenCL kernels are missing", "a complete installation")
