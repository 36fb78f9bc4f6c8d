"""clvol: a volume renderer that says how wrong its pictures are.

Nothing heavy is imported until it is used: no OpenCL call happens at import.
"""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"

_LAZY = {
    "Volume": "clvol.volume",
    "load_volume": "clvol.readers",
    "Scene": "clvol.scene",
    "load_scene": "clvol.scene",
    "Camera": "clvol.scene",
    "TransferFunction": "clvol.transfer",
    "Renderer": "clvol.render",
    "Frame": "clvol.render",
    "render_to_error": "clvol.accuracy.error_target",
    "render_in_time": "clvol.accuracy.time_target",
    "errors": "clvol.errors",
}
__all__ = sorted(_LAZY)


def __getattr__(name: str):
    try:
        module = import_module(_LAZY[name])
    except KeyError:
        raise AttributeError(f"module 'clvol' has no attribute {name!r}") from None
    value = module if name == "errors" else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
