"""The scene as typed models: one module per table of the scene file, and what loads, resolves and writes scenes."""

from __future__ import annotations

from clvol.scene.ambient_occlusion import AmbientOcclusion
from clvol.scene.animation import Animation
from clvol.scene.camera import Camera
from clvol.scene.channel import ChannelSettings, ResolvedChannel
from clvol.scene.clip import Clip
from clvol.scene.coherence import Coherence
from clvol.scene.compression import Compression
from clvol.scene.depth_cue import DepthCue
from clvol.scene.display import Display
from clvol.scene.environment import Environment
from clvol.scene.field import FieldLabel, FieldSettings, ResolvedField
from clvol.scene.gradient import GradientSettings
from clvol.scene.image import ImageSettings
from clvol.scene.integration import Integration
from clvol.scene.isosurface import Isosurface
from clvol.scene.light import Light
from clvol.scene.load import load_scene
from clvol.scene.material import Material
from clvol.scene.multiresolution import Multiresolution
from clvol.scene.noise import Noise
from clvol.scene.opacity_factor import (
    DirectionalOpacity,
    DirectionalOpacityPoint,
    GradientOpacity,
    GradientOpacityPoint,
    OpacityFactor,
)
from clvol.scene.overlay import Overlay
from clvol.scene.pyramid import Pyramid
from clvol.scene.refraction import Refraction, RefractionPoint, RefractiveIndex
from clvol.scene.resolve import ResolvedScene
from clvol.scene.scene import Scene
from clvol.scene.shadow import Shadow
from clvol.scene.slicing import Slicing
from clvol.scene.transfer_function import ControlPoint, TransferFunctionSettings
from clvol.scene.transfer_layer import TransferLayer, TransferLayerSettings
from clvol.scene.volume import VolumeSettings

__all__ = [
    "AmbientOcclusion",
    "Animation",
    "Camera",
    "ChannelSettings",
    "Clip",
    "Coherence",
    "Compression",
    "ControlPoint",
    "DepthCue",
    "DirectionalOpacity",
    "DirectionalOpacityPoint",
    "Display",
    "Environment",
    "FieldLabel",
    "FieldSettings",
    "GradientOpacity",
    "GradientOpacityPoint",
    "GradientSettings",
    "ImageSettings",
    "Integration",
    "Isosurface",
    "Light",
    "Material",
    "Multiresolution",
    "Noise",
    "OpacityFactor",
    "Overlay",
    "Pyramid",
    "Slicing",
    "Refraction",
    "RefractionPoint",
    "RefractiveIndex",
    "ResolvedChannel",
    "ResolvedField",
    "ResolvedScene",
    "Scene",
    "Shadow",
    "TransferFunctionSettings",
    "TransferLayer",
    "TransferLayerSettings",
    "VolumeSettings",
    "load_scene",
]
