"""What is asked for: the scene as typed models, one file a table of the scene file."""

from __future__ import annotations

from clvol.scene.camera import Camera
from clvol.scene.clip import Clip
from clvol.scene.image import ImageSettings
from clvol.scene.integration import Integration
from clvol.scene.isosurface import Isosurface
from clvol.scene.light import Light
from clvol.scene.load import load_scene
from clvol.scene.material import Material
from clvol.scene.multiresolution import Multiresolution
from clvol.scene.pyramid import Pyramid
from clvol.scene.resolve import ResolvedScene
from clvol.scene.scene import Scene
from clvol.scene.transfer_function import ControlPoint, TransferFunctionSettings
from clvol.scene.volume import VolumeSettings

__all__ = [
    "Camera",
    "Clip",
    "ControlPoint",
    "ImageSettings",
    "Integration",
    "Isosurface",
    "Light",
    "Material",
    "Multiresolution",
    "Pyramid",
    "ResolvedScene",
    "Scene",
    "TransferFunctionSettings",
    "VolumeSettings",
    "load_scene",
]
