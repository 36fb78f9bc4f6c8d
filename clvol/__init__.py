"""clvol: a volume renderer that says how wrong its pictures are.

==================================  ==========================================================
``Volume``, ``load_volume``         voxels on a grid: from an array, or from a file
``VolumeSeries``                    a volume that changes over time: a step for each time
``Scene``, ``load_scene``           what to render: from tables, or from a scene file
``Renderer``, ``Frame``             renders a scene any number of times; a picture with its stats
``render``                          a picture in one call: of a scene, a volume, an array or a file
``render_to_error``                 renders with the cheapest settings that stay below an error
``render_in_time``                  renders as accurately as a time per frame allows
``TransferFunction``                colour and opacity by value
``Camera``, ``Light``, ...          the tables of a scene; ``clvol scene --keys`` lists their keys
``errors``                          the exceptions, all ``errors.ClvolError``
==================================  ==========================================================

Nothing heavy is imported until it is used: no OpenCL call happens at import.
"""

from __future__ import annotations

from importlib import import_module

__version__ = "0.1.0"

_LAZY = {
    "Volume": "clvol.volume",
    "VolumeSeries": "clvol.volume",
    "load_volume": "clvol.readers",
    "Scene": "clvol.scene",
    "load_scene": "clvol.scene",
    "Camera": "clvol.scene",
    "TransferFunction": "clvol.transfer",
    "Renderer": "clvol.render",
    "Frame": "clvol.render",
    "render": "clvol.render",
    "render_to_error": "clvol.accuracy.error_target",
    "render_in_time": "clvol.accuracy.time_target",
    "errors": "clvol.errors",
}
# The models of a scene's tables, and of the entries of their lists.
_TABLES = (
    "AmbientOcclusion", "Animation", "ChannelSettings", "Clip", "Coherence", "Compression", "ControlPoint", "DepthCue",
    "DirectionalOpacity", "DirectionalOpacityPoint", "Display", "Environment", "FieldLabel", "FieldSettings",
    "GradientOpacity", "GradientOpacityPoint", "GradientSettings", "ImageSettings", "Integration", "Isosurface",
    "Light", "Material", "Multiresolution", "Noise", "Overlay", "Pyramid", "Refraction",
    "RefractionPoint", "Shadow", "Slicing",
    "TransferFunctionSettings", "TransferLayerSettings", "VolumeSettings",
)  # fmt: skip
_LAZY |= dict.fromkeys(_TABLES, "clvol.scene")
__all__ = sorted(_LAZY)


def __getattr__(name: str):
    try:
        module = import_module(_LAZY[name])
    except KeyError:
        raise AttributeError(f"module 'clvol' has no attribute {name!r}") from None
    value = module if name in ("errors", "render") else getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
