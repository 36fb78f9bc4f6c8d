"""Resolving a scene: the volume is loaded, defaults are filled in, colours are converted to linear light."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from clvol.errors import SceneError
from clvol.lazily import lazily
from clvol.readers import is_url, load_volume
from clvol.readers.colored import load_colored
from clvol.readers.options import ALL_TIMES
from clvol.readers.series import file_series, files_of, is_pattern, series_name
from clvol.scene.ambient_occlusion import AmbientOcclusion
from clvol.scene.animation import Animation
from clvol.scene.camera import Camera
from clvol.scene.channel import ResolvedChannel
from clvol.scene.classification import ChosenClassification, with_classification
from clvol.scene.clip import Clip
from clvol.scene.codes import code_of, function_in_codes, in_stored_values
from clvol.scene.coherence import Coherence
from clvol.scene.compression import Compression
from clvol.scene.default_unit import default_opacity_unit
from clvol.scene.depth_cue import DepthCue
from clvol.scene.display import Display
from clvol.scene.environment import Environment
from clvol.scene.field import ResolvedField
from clvol.scene.generated import generated_function
from clvol.scene.glow import Glow, with_glow
from clvol.scene.gradient import GradientSettings
from clvol.scene.image import ImageSettings
from clvol.scene.integration import Integration
from clvol.scene.isosurface import Isosurface
from clvol.scene.light import Light
from clvol.scene.material import Material
from clvol.scene.multiresolution import Multiresolution
from clvol.scene.noise import Noise
from clvol.scene.opacity_factor import OpacityFactor
from clvol.scene.overlay import Overlay
from clvol.scene.pyramid import Pyramid
from clvol.scene.refraction import RefractiveIndex
from clvol.scene.shadow import Shadow
from clvol.scene.slicing import Slicing
from clvol.scene.step_times import StepTimes
from clvol.scene.table import shown
from clvol.scene.transfer_function import TransferFunctionSettings
from clvol.scene.transfer_layer import TransferLayer, in_rows
from clvol.scene.volume import VolumeSettings
from clvol.store.zarr_store import check_finished
from clvol.transfer import TransferFunction
from clvol.transfer.color_names import in_linear_light
from clvol.volume.axis import ValueAxis
from clvol.volume.grid import Grid
from clvol.volume.lazy import FilledVolume, LazyVolume
from clvol.volume.memory import check_memory
from clvol.volume.series import StepVolume, VolumeSeries
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.scene.scene import Scene
    from clvol.volume import procedural
else:
    procedural = lazily("clvol.volume.procedural")

LARGEST_STEP_COUNT = 2**24  # a float32 counts no further


@dataclass(frozen=True, eq=False)
class ResolvedScene:
    """Everything that rendering needs: all colours are linear light, and all files have been found.

    ``source`` is the requested scene as the text of a scene file. ``origin`` names the scene file (or "scene") in
    error messages of the form "ORIGIN: TABLE.KEY".

    If the requested volume has a slope and an offset, ``volume`` has neither, and everything that the scene states in
    values is converted to stored numbers. ``axis`` maps stored numbers to values, for messages;
    ``in_stored_values`` converts what is set later.
    """

    volume: Volume
    camera: Camera
    image: ImageSettings
    transfer_function: TransferFunction
    background: np.ndarray
    integration: Integration
    lights: tuple[Light, ...]
    isosurfaces: tuple[Isosurface, ...]
    clips: tuple[Clip, ...]
    material: Material
    multiresolution: Multiresolution
    pyramid: Pyramid
    slicing: Slicing
    source: str | None
    origin: str = "scene"
    gradient: GradientSettings = GradientSettings()
    environment: Environment | None = None
    shadow: Shadow | None = None
    ambient_occlusion: AmbientOcclusion | None = None
    gradient_opacity: OpacityFactor | None = None
    directional_opacity: OpacityFactor | None = None
    transfer_layers: tuple[TransferLayer, ...] = ()
    glow: Glow | None = None  # the light of associated colours; ``transfer_function`` is then black
    fields: tuple[ResolvedField, ...] = ()
    noise: tuple[Noise, ...] = ()  # of values and coordinates
    attenuation_noise: tuple[Noise, ...] = ()  # of scattered light
    fur: tuple[Noise, ...] = ()
    depth_cue: DepthCue | None = None
    animation: Animation = Animation()
    channels: tuple[ResolvedChannel, ...] = ()  # whose pictures are blended; ``volume`` is that of the first
    refraction: RefractiveIndex | None = None
    mixed_channels: int = 0  # channels that are one medium: the volume and the first densities of ``fields``
    voxel_range: tuple[float, float] | None = None  # where ``volume`` holds codes instead of voxels
    axis: ValueAxis = ValueAxis()
    compression: Compression = Compression()
    coherence: Coherence = Coherence()
    chosen_classification: ChosenClassification | None = None  # where the scene requests "auto"
    chosen: dict[str, Any] | None = None  # what was chosen from the volume, since the scene does not state it
    display: Display = Display()
    overlay: Overlay = Overlay()
    folder: Path | None = None  # that file names of ``source`` are relative to
    steps: StepTimes | None = None  # where ``volume`` is a step of a series

    def at(self, time: float) -> ResolvedScene:
        """The scene at ``time`` in seconds; of a series, with the step of that time."""
        volume = self.volume
        if self.steps is not None and isinstance(volume, StepVolume):
            volume = volume.at(self.steps.at(time))
        return replace(self, volume=volume, animation=self.animation.model_copy(update={"time": time}))

    @property
    def volumes(self) -> tuple[Volume, ...]:
        """All volumes of the scene, each once: its own, those of channels, and those of fields."""
        named = [self.volume, *(each.volume for each in self.channels), *(each.volume for each in self.fields)]
        for field in self.fields:
            named += field.colors_of_voxels.channels if field.colors_of_voxels is not None else ()
        return tuple({id(volume): volume for volume in named}.values())

    @property
    def all_noise(self) -> tuple[Noise, ...]:
        """The noise of all targets."""
        return (*self.noise, *self.attenuation_noise, *self.fur)

    @property
    def displayed_function(self) -> TransferFunction:
        """The transfer function with the colours that it is stated with, also where they are associated."""
        function = self.transfer_function
        if self.glow is None:
            return function
        brightest = max(float(self.glow.light.max()), 1e-300)
        colors = np.clip(self.glow.light / brightest, 0.0, 1.0)
        return TransferFunction(function.values, function.opacities, colors, function.opacity_unit)

    @property
    def data_range(self) -> tuple[float, float]:
        """The lowest and highest finite voxel: the range that relative settings refer to."""
        return self.voxel_range or self.volume.value_range

    def in_stored_values(self, function: TransferFunction) -> TransferFunction:
        """``function``, stated in values, as a function of what ``volume`` holds."""
        if self.axis.is_plain:
            return function
        return function_in_codes(function, code_of(self.axis, self.volume.dtype))

    def with_function(self, function: TransferFunction) -> ResolvedScene:
        """The scene with another transfer function, stated in values, whose colours are associated where those of its
        own are."""
        function, glow = self.in_stored_values(function), None
        if self.glow is not None:
            function, glow = with_glow(function, self.glow.factor)
        return replace(self, transfer_function=function, glow=glow)


def resolve(scene: Scene, memory_cap: int | None = None) -> ResolvedScene:
    """See ``Scene.resolve``."""
    _check_no_labels(scene)
    scene = scene.completed(memory_cap)
    volume = scene.load_volume(memory_cap)
    camera = (scene.camera or Camera()).complete(volume.grid, scene.image, scene.origin, volume.frame)
    _check_step_count(scene, volume.grid)

    given = scene.transfer_function
    channels: tuple[ResolvedChannel, ...] = ()
    if scene.channel:
        assert isinstance(given, TransferFunctionSettings) and given.opacity_unit is not None
        is_linear = given.color_space == "linear"
        channels = _channels(scene, given.opacity_unit, is_linear, memory_cap)
        function = channels[0].function
    elif isinstance(given, TransferFunction):
        function, is_linear = given, True
    else:
        settings = given or TransferFunctionSettings()
        function = settings.function(
            volume.value_range, default_opacity_unit(volume.grid), scene.folder, scene.origin
        )
        is_linear = settings.color_space == "linear"
    generated: tuple[TransferLayer, ...] = ()
    if isinstance(given, TransferFunctionSettings) and given.generator is not None:
        function, generated = generated_function(scene, given, scene.first_picture(memory_cap).sample)
    glow = None
    if isinstance(given, TransferFunctionSettings) and given.associated:
        function, glow = with_glow(function, given.emission)

    def decoded(color: ArrayLike) -> np.ndarray:
        return in_linear_light(color, is_linear)

    background = decoded(scene.image.background)
    background.setflags(write=False)
    unit = function.opacity_unit
    fields = [
        settings.resolved(field, unit, decoded, scene.folder)
        for settings, field in zip(scene.field, scene.load_fields(memory_cap))
    ]
    if volume.colors is not None and not scene.channel:
        fields.insert(0, ResolvedField(volume, "color", colors_of_voxels=volume.colors))
    mixes = scene.integration.blend == "mix"
    if mixes:
        fields[:0] = [ResolvedField(each.volume, "density", function=each.function) for each in channels[1:]]
    environment, cue = scene.environment, scene.depth_cue
    if environment is not None:
        environment = environment.found_in(scene.folder, scene.origin, memory_cap)
    if cue is not None:
        cue = cue.complete(camera, volume.grid).model_copy(update={"color": decoded(cue.color)})
    resolved = ResolvedScene(
        volume=volume,
        camera=camera,
        image=scene.image,
        transfer_function=function,
        background=background,
        integration=scene.integration,
        lights=tuple(light.found_in(scene.folder, scene.origin, k) for k, light in enumerate(scene.light)),
        isosurfaces=tuple(_surface(surface, decoded) for surface in scene.isosurface),
        clips=tuple(clip.found_in(scene.folder, scene.origin, k) for k, clip in enumerate(scene.clip)),
        material=scene.material,
        multiresolution=scene.multiresolution,
        pyramid=scene.pyramid,
        slicing=scene.slicing,
        coherence=scene.coherence,
        source=scene.to_toml(),
        origin=scene.origin,
        gradient=scene.gradient,
        environment=environment,
        shadow=scene.shadow,
        ambient_occlusion=scene.ambient_occlusion and scene.ambient_occlusion.complete(volume.grid),
        gradient_opacity=None if scene.gradient_opacity is None else scene.gradient_opacity.factor(),
        directional_opacity=None if scene.directional_opacity is None else scene.directional_opacity.factor(),
        transfer_layers=generated or _layers(scene, fields, unit, decoded),
        glow=glow,
        refraction=None if scene.refraction is None else scene.refraction.resolved(),
        fields=tuple(fields),
        channels=() if mixes or len(channels) == 1 else channels,
        mixed_channels=len(channels) if mixes else 0,
        noise=tuple(term for term in scene.noise if term.target in ("value", "coordinate")),
        attenuation_noise=tuple(term for term in scene.noise if term.target == "attenuation"),
        fur=tuple(term for term in scene.noise if term.target == "fur"),
        depth_cue=cue,
        animation=scene.animation,
        compression=scene.compression,
        chosen=scene.chosen,
        display=scene.display,
        overlay=scene.overlay,
        folder=scene.folder,
        steps=scene.step_times(memory_cap),
    )
    return with_classification(in_stored_values(resolved))


def _channels(
    scene: Scene, opacity_unit: float, is_linear: bool, memory_cap: int | None
) -> tuple[ResolvedChannel, ...]:
    """The channels of a completed scene, stated in values."""

    def decoded(color: ArrayLike) -> np.ndarray:
        return in_linear_light(color, is_linear)

    return tuple(
        ResolvedChannel(volume, settings.function(opacity_unit, decoded), settings.name(number))
        for number, (settings, volume) in enumerate(zip(scene.channel, scene.load_channels(memory_cap)))
    )


def _layers(
    scene: Scene, fields: list[ResolvedField], unit: float, decoded: Callable[[ArrayLike], np.ndarray]
) -> tuple[TransferLayer, ...]:
    layers = tuple(layer.layer(unit, decoded) for layer in scene.transfer_layer)
    bases = [field.base for field in fields if field.role == "value"]
    where = f"{scene.origin}: transfer_layer"
    wrong = next((layer.values for layer in layers if len(layer.values) != len(bases)), None)
    if wrong is not None or (bases and not layers):
        what = f"{len(wrong or ())} values beside {len(bases)} fields of role 'value'"
        raise SceneError(where, what, "values = [one for each field of role 'value'], at most two")
    return in_rows(layers, bases, where) if bases else layers


def _surface(surface: Isosurface, decoded: Callable[[ArrayLike], np.ndarray]) -> Isosurface:
    back = surface.color if surface.back_color is None else surface.back_color
    return surface.model_copy(update={"color": decoded(surface.color), "back_color": decoded(back)})


def load_scene_volume(
    settings: VolumeSettings | Volume | VolumeSeries, folder: Path, origin: str, memory_cap: int | None
) -> Volume | VolumeSeries:
    """The volume of a scene, or the series of its steps. A file name is relative to ``folder``."""
    if isinstance(settings, (Volume, VolumeSeries)):
        return settings
    if settings.field is not None and settings.size is not None:
        check_memory(f"{origin}: volume.size", math.prod(settings.size), memory_cap)
        volume = procedural.scene_field(settings.field, settings.size, settings.spacing or (1.0, 1.0, 1.0))
        volume.axis = ValueAxis(settings.slope, settings.offset)
        return volume
    if settings.file is None:
        raise SceneError(f"{origin}: volume.file", "missing", "a volume file or a DICOM folder")
    if is_series(settings, folder):
        if settings.color is not None:
            what = f"got {settings.color!r} for a volume that changes over time"
            raise SceneError(f"{origin}: volume.color", what, "colours of one time")
        return _load_series(settings, folder, origin, memory_cap)
    for key in ("step", "steps_per_second", "value_range"):
        if (value := getattr(settings, key)) is not None:
            expected = "a series of steps: a pattern or a list of files, or volume.time = \"all\""
            raise SceneError(f"{origin}: volume.{key}", f"got {shown(value)} for one volume", expected)
    path: str | Path = settings.file if is_url(settings.file) else folder / settings.file
    is_scene_file = str(path) != origin
    if isinstance(path, Path) and is_scene_file and not os.path.exists(path):
        check_finished(path)
        got = f"got {settings.file!r}, no such file"
        raise SceneError(f"{origin}: volume.file", got, "a volume file or a DICOM folder")
    if settings.color is not None:
        return load_colored(path, settings.color, **_read_options(settings, memory_cap))
    volume = load_volume(path, **_read_options(settings, memory_cap))
    if settings.nan != "transparent" and volume.nan_count:
        volume = _with_nan_as(volume, settings.nan)
    return volume


def is_series(settings: VolumeSettings, folder: Path) -> bool:
    """Whether the file that ``settings`` name is a series of steps."""
    file = settings.file
    return isinstance(file, tuple) or settings.time == ALL_TIMES or (file is not None and is_pattern(file, folder))


def _read_options(settings: VolumeSettings, memory_cap: int | None) -> dict[str, Any]:
    keys = "dims", "dtype", "spacing", "channel", "time", "series", "header_bytes", "byte_order", "slope", "offset"
    return {**{key: getattr(settings, key) for key in keys}, "memory_cap": memory_cap}


def _load_series(settings: VolumeSettings, folder: Path, origin: str, memory_cap: int | None) -> VolumeSeries:
    where = f"{origin}: volume.file"
    named = settings.file if isinstance(settings.file, tuple) else (str(settings.file),)
    files = files_of(named, folder, where)
    if settings.time == ALL_TIMES:
        if len(files) > 1:
            what = f"got {ALL_TIMES!r} with {len(files)} files"
            raise SceneError(f"{origin}: volume.time", what, "one file, or the index of one time in each")
        if not is_url(files[0]) and not os.path.exists(files[0]):
            raise SceneError(where, f"got {settings.file!r}, no such file", "a volume file with an axis of times")
    finish = None
    if settings.nan != "transparent":
        finish = f"nan {settings.nan!r}", partial(_filled, value=settings.nan)
    return file_series(
        files, _read_options(settings, memory_cap), name=series_name(files), finish=finish,
        value_range=settings.value_range,
    )  # fmt: skip


def _filled(volume: Volume, value: float) -> Volume:
    return _with_nan_as(volume, value) if volume.nan_count else volume


def _with_nan_as(volume: Volume, value: float) -> Volume:
    value = float(volume.axis.stored(value))
    if isinstance(volume, LazyVolume) and "data" not in vars(volume):
        return FilledVolume(volume, value)
    data = np.array(volume.data)
    for layer in data:
        np.copyto(layer, value, where=np.isnan(layer))
    grid = volume.grid
    filled = Volume(
        data,
        spacing=grid.spacing,
        origin=grid.origin,
        direction=grid.direction,
        name=volume.name,
        frame=volume.frame,
        path=volume.path,
        format=volume.format,
        unit=volume.unit,
        slope=volume.slope,
        offset=volume.offset,
    )
    filled.files = volume.files
    return filled


def _check_no_labels(scene: Scene) -> None:
    """SceneError for a lossy codec of voxels that a field of the scene takes for labels."""
    codec, volume = scene.compression.codec, scene.volume
    if not scene.compression.is_lossy:
        return
    for number, field in enumerate(scene.field):
        same = field.file is volume
        if isinstance(volume, VolumeSettings) and isinstance(field.file, str):
            own = {"channel": volume.channel, "time": volume.time, "series": volume.series}
            same = field.file == volume.file and field.choices == own
        if same and field.role == "label":
            where = f"{scene.origin}: compression.codec"
            what = f"got {codec!r} for voxels that field.{number} takes for labels, which have to be exact"
            raise SceneError(where, what, "'none' or 'labels'")


def _check_step_count(scene: Scene, grid: Grid) -> None:
    if not scene.integration.takes_steps:
        return
    lower, upper = grid.index_bounds()
    edges = (np.asarray(upper) - np.asarray(lower)) * np.asarray(grid.spacing) / grid.smallest_edge
    longest = math.hypot(*edges)
    step = scene.integration.step
    if longest / step > LARGEST_STEP_COUNT:
        expected = f"at least {longest / LARGEST_STEP_COUNT:.3g} for this volume"
        raise SceneError(f"{scene.origin}: integration.step", f"got {step!r}", expected)
