"""The tables of a scene, each with its model, and what they must not say together."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, WrapValidator, model_validator

from clvol.scene.ambient_occlusion import AmbientOcclusion
from clvol.scene.animation import Animation
from clvol.scene.camera import Camera
from clvol.scene.channel import LARGEST_CHANNELS, ChannelSettings
from clvol.scene.clip import Clip
from clvol.scene.coherence import Coherence
from clvol.scene.compression import Compression
from clvol.scene.depth_cue import DepthCue
from clvol.scene.display import Display
from clvol.scene.environment import Environment
from clvol.scene.field import LARGEST_COUNT, FieldSettings
from clvol.scene.gradient import GradientSettings
from clvol.scene.image import ImageSettings
from clvol.scene.integration import Integration
from clvol.scene.isosurface import Isosurface
from clvol.scene.light import Light
from clvol.scene.material import Material
from clvol.scene.multiresolution import Multiresolution
from clvol.scene.noise import LARGEST_COUNT as LARGEST_NOISES
from clvol.scene.noise import Noise
from clvol.scene.opacity_factor import DirectionalOpacity, GradientOpacity
from clvol.scene.overlay import Overlay
from clvol.scene.pyramid import Pyramid
from clvol.scene.refraction import Refraction
from clvol.scene.shadow import Shadow
from clvol.scene.slicing import Slicing
from clvol.scene.table import AsTuple, Table, wrong
from clvol.scene.transfer_function import TransferFunctionSettings
from clvol.scene.transfer_layer import LARGEST_LAYERS, TransferLayerSettings
from clvol.scene.volume import VolumeSettings
from clvol.transfer import TransferFunction
from clvol.volume.adopted import is_array_like
from clvol.volume.series import VolumeSeries
from clvol.volume.volume import Volume

_TABLE = "a table"
_TABLES = "a list of tables"
FROM_FILE = {"from": "file"}  # validation context: only what a scene file may hold


def _version(value: Any) -> int:
    if type(value) is not int or value != 1:
        raise ValueError("not version 1")
    return value


def _volume(value: Any, check: Callable[[Any], Any], info: ValidationInfo) -> Any:
    if isinstance(value, (Volume, VolumeSeries)):
        return value
    if info.context is not FROM_FILE:
        if isinstance(value, (str, os.PathLike)) or (isinstance(value, (list, tuple)) and _are_paths(value)):
            return check({"file": value})
        if is_array_like(value):
            expected = "a Volume: clvol.Volume(array, spacing=(x, y, z))"
            raise wrong("", value if isinstance(value, np.ndarray) else type(value), expected)
    return check(value)


def _are_paths(values: Sequence[Any]) -> bool:
    return bool(values) and all(isinstance(each, (str, os.PathLike)) for each in values)


def _transfer_function(value: Any, check: Callable[[Any], Any]) -> Any:
    return value if isinstance(value, TransferFunction) else check(value)


class SceneTables(Table):
    """What a scene file may hold, checked: the keys of ``Scene``."""

    version: Annotated[int, BeforeValidator(_version)] = Field(1, title="Version of the scene format.", description="1")
    volume: Annotated[VolumeSettings, WrapValidator(_volume)] = Field(
        title="The voxels to render: a file, or a computed field.",
        description="a table with the key file, or field and size",
    )
    channel: Annotated[tuple[ChannelSettings, ...], AsTuple] = Field(
        (),
        title="Channels of the volume's file, each with its own colour and range; integration.blend combines them.",
        description=_TABLES,
    )
    camera: Camera | None = Field(
        None,
        title="The view; without this table, the whole volume in perspective.",
        description=_TABLE,
    )
    image: ImageSettings = Field(
        ImageSettings(),
        title="Size of the picture, and what is behind the volume.",
        description=_TABLE,
    )
    transfer_function: Annotated[
        TransferFunctionSettings | None, WrapValidator(_transfer_function)
    ] = Field(
        None,
        title="Colour and opacity by value; without this table, chosen from the volume, with lights and a view.",
        description=_TABLE,
    )
    integration: Integration = Field(
        Integration(),
        title="How the light along a ray is summed, and how exactly.",
        description=_TABLE,
    )
    material: Material = Field(
        Material(),
        title="How lit samples and surfaces reflect (Blinn-Phong); read only where something is lit.",
        description=_TABLE,
    )
    light: Annotated[tuple[Light, ...], AsTuple] = Field(
        (),
        title="Lights; without any, nothing is shaded and no gradients are computed.",
        description=_TABLES,
    )
    isosurface: Annotated[tuple[Isosurface, ...], AsTuple] = Field(
        (),
        title="Surfaces where the volume has a value.",
        description=_TABLES,
    )
    clip: Annotated[tuple[Clip, ...], AsTuple] = Field(
        (),
        title="Planes, boxes and spheres that cut the volume; what all of them keep is shown.",
        description=_TABLES,
    )
    compression: Compression = Field(
        Compression(),
        title="The voxels as codes of a vector-quantising codec; by default they stay as they are.",
        description=_TABLE,
    )
    multiresolution: Multiresolution = Field(
        Multiresolution(),
        title="Settings of the method 'multiresolution': blocks within a memory budget.",
        description=_TABLE,
    )
    pyramid: Pyramid = Field(
        Pyramid(),
        title="Settings of the method 'pyramid': adaptive sampling.",
        description=_TABLE,
    )
    slicing: Slicing = Field(
        Slicing(),
        title="Settings of the method 'slicing': slices drawn one over the other.",
        description=_TABLE,
    )
    coherence: Coherence = Field(
        Coherence(),
        title="What rays that are close to each other share.",
        description=_TABLE,
    )
    gradient: GradientSettings = Field(
        GradientSettings(),
        title="How gradients are computed where something needs them.",
        description=_TABLE,
    )
    environment: Environment | None = Field(
        None,
        title="Light from all around, from a picture of it.",
        description=_TABLE,
    )
    shadow: Shadow | None = Field(None, title="Shadows, and forward scattering.", description=_TABLE)
    ambient_occlusion: AmbientOcclusion | None = Field(
        None,
        title="Less light where matter encloses a place.",
        description=_TABLE,
    )
    gradient_opacity: GradientOpacity | None = Field(
        None,
        title="Factor on the extinction by gradient magnitude.",
        description=_TABLE,
    )
    directional_opacity: DirectionalOpacity | None = Field(
        None,
        title="Factor on the extinction by the derivative along the ray.",
        description=_TABLE,
    )
    refraction: Refraction | None = Field(
        None,
        title="An index of refraction by value, by whose gradient rays bend.",
        description=_TABLE,
    )
    transfer_layer: Annotated[tuple[TransferLayerSettings, ...], AsTuple] = Field(
        (),
        title="Further layers of a two-dimensional transfer function, by gradient magnitude.",
        description=_TABLES,
    )
    field: Annotated[tuple[FieldSettings, ...], AsTuple] = Field(
        (),
        title="Further volumes, each on its own grid: labels, a second medium, or a mask. At most three.",
        description=_TABLES,
    )
    noise: Annotated[tuple[Noise, ...], AsTuple] = Field(
        (),
        title="Tiling noise that perturbs values, positions or scattered light, or makes fur. At most four.",
        description=_TABLES,
    )
    depth_cue: DepthCue | None = Field(None, title="Fading with distance from the eye.", description=_TABLE)
    animation: Animation = Field(Animation(), title="What changes from one frame to the next.", description=_TABLE)
    display: Display = Field(
        Display(),
        title="How light becomes colours in .png, .jpg, .tif and videos; .exr and .npy hold the light.",
        description=_TABLE,
    )
    overlay: Overlay = Field(
        Overlay(),
        title="What is drawn over .png, .jpg, .tif and videos, never into .exr and .npy.",
        description=_TABLE,
    )

    @model_validator(mode="after")
    def _not_contradictory(self) -> SceneTables:
        filter = self.integration.filter
        if self.integration.prefilter and filter != "cubic":
            expected = f"false with the filter {filter!r}, or the filter 'cubic'"
            raise wrong("integration.prefilter", True, expected)
        magnitudes = [0.0, *(each.magnitude for each in self.transfer_layer if each.magnitude is not None)]
        for i in range(1, len(magnitudes)):
            if not magnitudes[i - 1] < magnitudes[i]:
                expected = f"ascending magnitudes, here more than {magnitudes[i - 1]}"
                raise wrong(f"transfer_layer.{i - 1}.magnitude", magnitudes[i], expected)
        counts = {
            "transfer_layer": LARGEST_LAYERS, "field": LARGEST_COUNT, "noise": LARGEST_NOISES
        }  # fmt: skip
        counts["channel"] = LARGEST_CHANNELS
        for name, most in counts.items():
            count = len(getattr(self, name))
            if count > most:
                raise wrong(name, count, f"at most {most} of them")
        if self.channel:
            self._check_channels()
        return self

    def _check_channels(self) -> None:
        """Raises the error of a validator for what contradicts [[channel]]."""
        function = self.transfer_function
        if isinstance(function, TransferFunction):
            raise wrong("transfer_function", function, "the points of each [[channel]] instead")
        for key in ("points", "preset", "colormap", "file"):
            if function is not None and getattr(function, key) is not None:
                raise wrong(f"transfer_function.{key}", key, f"{key} beside no [[channel]]: channels have their own")
        if isinstance(self.volume, VolumeSettings) and self.volume.channel is not None:
            raise wrong("volume.channel", self.volume.channel, "either volume.channel or [[channel]], not both")
