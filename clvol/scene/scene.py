"""The scene: all tables together, built from a file or from Python."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import PrivateAttr, ValidationError

from clvol.errors import SceneError, SeveralChannels
from clvol.lazily import lazily
from clvol.readers import is_url
from clvol.readers.series import named_files
from clvol.scene.carried import Moment
from clvol.scene.preset_file import has_technique
from clvol.scene.resolve import ResolvedScene, is_series, load_scene_volume, resolve
from clvol.scene.step_times import StepTimes, frames_of, rate_of
from clvol.scene.table import scene_error
from clvol.scene.tables import FROM_FILE, SceneTables
from clvol.scene.transfer_function import TransferFunctionSettings
from clvol.scene.volume import VolumeSettings
from clvol.scene.write import to_toml
from clvol.volume.colored import is_color
from clvol.volume.series import StepVolume, VolumeSeries
from clvol.volume.volume import Volume

if TYPE_CHECKING:
    from clvol.choice import first_picture as choice
    from clvol.scene import first_channels as channels
    from clvol.scene import first_picture as completion
else:
    choice = lazily("clvol.choice.first_picture")
    channels = lazily("clvol.scene.first_channels")
    completion = lazily("clvol.scene.first_picture")


def _first_source(scene: Scene) -> Any:
    """What is read as the scene's volume: [volume], or the first of its channels."""
    if not scene.channel or isinstance(scene.volume, VolumeSeries):
        return scene.volume
    return scene.channel[0].source(0, scene.volume, f"{scene.origin}: channel.0")


def _same_voxels(one: Any, other: Any) -> bool:
    """Whether two tables [volume] name the same voxels; of a series, perhaps other steps."""
    if one == other:
        return True
    if not (isinstance(one, VolumeSettings) and isinstance(other, VolumeSettings)):
        return False
    keys = set(VolumeSettings.model_fields) - {"step", "steps_per_second", "loop"}
    return all(getattr(one, key) == getattr(other, key) for key in keys)


class Scene(SceneTables):
    """What to render: a volume, and how to look at it.

    The arguments are the tables of a scene file, by keyword; ``clvol scene --keys`` lists the keys of each. A table is
    an object (``clvol.Camera(...)``) or a dict of its keys; what is left out shows the whole volume. Scenes are
    immutable: ``scene.model_copy(update={"camera": other})`` makes another, checked, that shares the volume.

    Parameters
    ----------
    version : int
        Version of the scene format: 1.
    volume : Volume, VolumeSeries, str, path or VolumeSettings
        The voxels: an array on a grid, several of them in time, a file, or a computed field. Required.
    channel : sequence of ChannelSettings
        Several values per voxel: the channels of the volume's file, or volumes, each with a colour and a range.
    camera : Camera, optional
        The view. Default: perspective, 30 degrees, the whole volume in view.
    image : ImageSettings
        Width and height in pixels, and the background.
    transfer_function : TransferFunction or TransferFunctionSettings, optional
        Colour and opacity by value. Default: chosen from the volume (``completed``), with lights, material, filter,
        background and camera where the scene has none. Beside a ``TransferFunction``, all
        colours of the scene are linear light.
    integration : Integration
        Rendering method, step, classification and filter.
    material : Material
        Reflection of lit samples and surfaces (Blinn-Phong).
    light : sequence of Light
        Lights. Without any, nothing is shaded.
    isosurface : sequence of Isosurface
        Surfaces where the volume has a value.
    clip : sequence of Clip
        Planes, boxes, spheres and closed meshes that cut the volume.
    compression : Compression
        The voxels as codes, which take less memory and are not exact.
    multiresolution : Multiresolution
        Settings of the method "multiresolution".
    pyramid : Pyramid
        Settings of the method "pyramid".
    slicing : Slicing
        Settings of the method "slicing".
    coherence : Coherence
        What rays that are close to each other share.
    gradient : GradientSettings
        How gradients are computed.
    environment : Environment, optional
        Light from all around, from a picture of it.
    shadow : Shadow, optional
        Shadows and forward scattering.
    ambient_occlusion : AmbientOcclusion, optional
        Less light where matter encloses a place.
    gradient_opacity : GradientOpacity, optional
        Factor on the extinction by gradient magnitude.
    directional_opacity : DirectionalOpacity, optional
        Factor on the extinction by the derivative along the ray.
    refraction : Refraction, optional
        An index of refraction by value, by whose gradient rays bend.
    transfer_layer : sequence of TransferLayerSettings
        Further layers of a two-dimensional transfer function.
    field : sequence of FieldSettings
        Up to three further volumes: labels, a second medium, a mask. ``file`` may be a ``Volume``.
    noise : sequence of Noise
        Up to four noises that perturb values, positions or scattered light, or make fur.
    depth_cue : DepthCue, optional
        Fading with distance from the eye.
    animation : Animation
        What changes from one frame to the next.
    display : Display
        How light becomes colours where a picture is displayed: exposure, tone curve, transparency.
    overlay : Overlay
        What is drawn over displayed pictures: scale bar, colour bar, orientation, box, title, caption.

    Raises
    ------
    SceneError
        For an unknown key, a wrong type or an impossible value: the file, the key, the value and what was expected.

    Examples
    --------
    >>> volume = clvol.Volume(array, spacing=(1, 1, 2))  # array [z, y, x]
    >>> scene = clvol.Scene(
    ...     volume=volume,
    ...     image={"width": 800, "height": 600},
    ...     light=[clvol.Light(type="headlight")],
    ...     integration=clvol.Integration(step=0.5),
    ... )
    >>> with clvol.Renderer(scene) as renderer:
    ...     renderer.render().save("picture.png")
    """

    _origin: str = PrivateAttr("scene")  # where the scene came from, in error messages
    _folder: Path = PrivateAttr(Path())  # the folder that volume.file is relative to
    _loaded: Any = PrivateAttr(None)  # the volume, once loaded from its file
    _memory_cap: int | None = PrivateAttr(None)  # bytes that each file may take, once loaded
    _first: Any = PrivateAttr(None)  # what suits the loaded volume
    _chosen: dict[str, Any] | None = PrivateAttr(None)  # what was chosen for this scene, and why
    _moment: Moment | None = PrivateAttr(None)  # what is shown of a scene that a picture carries
    _several: SeveralChannels | None = PrivateAttr(None)  # channels of the file, of which the scene selects none
    _shown_color: str | None = PrivateAttr(None)  # volume.color, for a file of colours
    _fields: dict[tuple, Any] = PrivateAttr(default_factory=dict)  # the volumes of fields, by file and choices

    @classmethod
    def from_data(cls, data: Mapping[str, Any], origin: str, folder: Path) -> Scene:
        """A scene from a parsed file called ``origin`` in messages, in ``folder``."""
        try:
            scene = cls.model_validate(data, context=FROM_FILE)
        except ValidationError as error:
            raise scene_error(error, cls, origin) from None
        scene._origin, scene._folder = origin, folder
        return scene

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Scene:
        """A copy with the keys of ``update`` replaced and checked. A loaded volume is shared."""
        copy = super().model_copy(update=update, deep=deep)
        copy._origin, copy._folder = self._origin, self._folder
        if "volume" not in (update or {}):
            copy._loaded, copy._first, copy._chosen = self._loaded, self._first, self._chosen
            copy._several, copy._shown_color = self._several, self._shown_color
        copy._fields, copy._memory_cap = self._fields, self._memory_cap
        return copy

    def share_volumes(self, other: Scene) -> None:
        """Takes over the volume and the fields that ``other`` has loaded, where this scene names the same files,
        which have not changed since."""
        if self._folder != other._folder:
            return
        if self._loaded is None and other._loaded is not None and _same_voxels(self.volume, other.volume):
            if _first_source(self) == _first_source(other):
                other._loaded.check_unchanged()
                self._loaded, self._first, self._several = other._loaded, other._first, other._several
        self._fields = {**other._fields, **self._fields}

    def load_volume(self, memory_cap: int | None = None) -> Volume:
        """The volume that the scene names, read once and kept; of a series, the step at ``animation.time``.

        ``memory_cap``: bytes that it may take in memory. Raises SceneError, VolumeError.
        """
        loaded = self._load(memory_cap)
        if not isinstance(loaded, VolumeSeries):
            return loaded
        times = self.step_times(memory_cap)
        assert times is not None
        return loaded.step(times.at(self.animation.time))

    def load_series(self, memory_cap: int | None = None) -> VolumeSeries | None:
        """The volume's series of steps in time; None for a volume that does not change. What all steps have in common
        is found when it is first used. Raises SceneError, VolumeError."""
        settings = self.volume
        if isinstance(settings, (Volume, VolumeSeries)):
            return settings if isinstance(settings, VolumeSeries) else None
        if not is_series(settings, self._folder):
            return None
        loaded = self._load(memory_cap)
        return loaded if isinstance(loaded, VolumeSeries) else None

    def step_times(self, memory_cap: int | None = None) -> StepTimes | None:
        """Which step is shown when; None for a volume that does not change. Raises SceneError, VolumeError."""
        series = self.load_series(memory_cap)
        if series is None:
            return None
        settings, animation = self.volume, self.animation
        rate = settings.steps_per_second or rate_of(len(series), animation.frames, animation.fps)
        fixed = None
        if self.step_is_fixed:
            fixed = series.index(settings.step, f"{self._origin}: volume.step")
        return StepTimes(len(series), rate, settings.loop, fixed)

    def frames_of_series(self, memory_cap: int | None = None) -> int | None:
        """How many frames an animation of the series' steps has; None for a volume that does not change, for a step
        that is shown at all times, and where the scene states the number. Raises SceneError, VolumeError."""
        if "frames" in self.animation.model_fields_set or self.step_is_fixed:
            return None
        series = self.load_series(memory_cap)
        rate = getattr(self.volume, "steps_per_second", None)
        return None if series is None else frames_of(len(series), rate, self.animation.fps)

    @property
    def step_is_fixed(self) -> bool:
        """Whether [volume] names the step of a series that is shown at all times."""
        return isinstance(self.volume, VolumeSettings) and self.volume.step is not None

    def _load(self, memory_cap: int | None) -> Volume | VolumeSeries:
        if self._loaded is None:
            self._loaded = load_scene_volume(_first_source(self), self._folder, self._origin, memory_cap)
        return self._loaded

    def load_shown(self, memory_cap: int | None = None) -> Volume:
        """As ``load_volume``; of a file with several channels, of which the scene may show all, the first one."""
        try:
            return self.load_volume(memory_cap)
        except SeveralChannels as several:
            if not self._may_show_channels and not is_color(several.names):
                raise
            if is_color(several.names):
                self._shown_color = "alpha" if len(several.names) == 4 else "luminance"
                colored = self.volume.model_copy(update={"color": self._shown_color})
                self._loaded = load_scene_volume(colored, self._folder, self._origin, memory_cap)
                return self._loaded
            first = self.volume.model_copy(update={"channel": several.numbers[0]})
            self._loaded = load_scene_volume(first, self._folder, self._origin, memory_cap)
            self._several = several
            return self._loaded

    @property
    def _may_show_channels(self) -> bool:
        """Whether all channels of a file are shown where the scene selects none: it says nothing that holds for the
        values of one channel."""
        by_value = (
            self.isosurface, self.transfer_layer, self.noise, self.gradient_opacity, self.directional_opacity,
            self.refraction,
        )  # fmt: skip
        plain = isinstance(self.volume, VolumeSettings) and self.compression.codec == "none"
        return plain and self.transfer_function is None and not any(by_value) and not self.channel

    @property
    def several_channels(self) -> SeveralChannels | None:
        """The channels of the file, if the scene shows all of them since it selects none."""
        return self._several

    def load_channels(self, memory_cap: int | None = None) -> tuple[Volume, ...]:
        """The volumes of all [[channel]]s, each read once and kept. SceneError for a series in time, VolumeError."""
        volumes: list[Volume] = []
        for number, settings in enumerate(self.channel):
            where = f"{self._origin}: channel.{number}"
            source = settings.source(number, self.volume, where)
            key = ("channel", source)
            if number == 0:
                loaded: Any = self._load(memory_cap)
            else:
                if key not in self._fields:
                    self._fields[key] = load_scene_volume(source, self._folder, self._origin, memory_cap)
                loaded = self._fields[key]
            if isinstance(loaded, VolumeSeries):
                raise SceneError(where, "in a scene whose volume changes over time", "one time (volume.time)")
            volumes.append(loaded)
        return tuple(volumes)

    def load(self, memory_cap: int | None = None) -> None:
        """Reads the volume and the fields, which are kept, and checks the environment's size.

        ``memory_cap``: bytes that each of them may take in memory. Raises SceneError, VolumeError.
        """
        self._memory_cap = memory_cap
        self.load_shown(memory_cap)
        self.load_fields(memory_cap)
        if self.environment is not None:
            self.environment.found_in(self._folder, self._origin, memory_cap)
        for number, light in enumerate(self.light):
            light.found_in(self._folder, self._origin, number)

    def load_fields(self, memory_cap: int | None = None) -> tuple[Volume, ...]:
        """The volumes of the fields, each read once and kept.

        ``memory_cap``: bytes that each may take in memory. Raises SceneError, VolumeError.
        """
        volumes = []
        with_values = {settings.file for settings in self.field if settings.role != "label"}
        for i, settings in enumerate(self.field):
            volume, where = settings.file, f"{self._origin}: field.{i}"
            if isinstance(volume, str):
                key = volume, settings.channel, settings.time, settings.series
                if key not in self._fields:
                    self._fields[key] = settings.load(
                        self._folder, where, memory_cap, labels=volume not in with_values
                    )
                volume = self._fields[key]
            volumes.append(volume)
        return tuple(volumes)

    def first_picture(self, memory_cap: int | None = None) -> choice.FirstPicture:
        """What suits the volume, which is examined once. ``memory_cap``: as for ``load_volume``."""
        if self._first is None:
            volume = self.load_volume(memory_cap)
            self._first = choice.FirstPicture(volume.widest if isinstance(volume, StepVolume) else volume)
        return self._first

    def completed(self, memory_cap: int | None = None) -> Scene:
        """The scene with a transfer function chosen from the volume, and lights, material, filter, background and
        camera that go with it, where the scene states none; the scene itself if it has a transfer function.

        ``memory_cap``: as for ``load_volume``. Raises SceneError, VolumeError.
        """
        given = self.transfer_function
        if given is None and not self.channel:
            self.load_shown(memory_cap)
        if self._shown_color is not None and getattr(self.volume, "color", None) is None:
            stated = self.model_copy(update={"volume": self.volume.model_copy(update={"color": self._shown_color})})
            stated._loaded, stated._first = self._loaded, self._first
            return stated.completed(memory_cap)
        if self.channel or self._several:
            return channels.completed(self, self._memory_cap if memory_cap is None else memory_cap)
        if given is not None and not (isinstance(given, TransferFunctionSettings) and has_technique(given.preset)):
            return self
        return completion.completed(self, self._memory_cap if memory_cap is None else memory_cap)

    @property
    def chosen(self) -> dict[str, Any] | None:
        """What ``completed`` has chosen, and why, as JSON types; None if nothing was."""
        return self._chosen

    def resolve(self, memory_cap: int | None = None) -> ResolvedScene:
        """The scene with its volume loaded, every default filled in and colours in linear light.

        ``memory_cap``: bytes that each file may take in memory; None: as for ``load``. Raises
        SceneError, VolumeError.
        """
        return resolve(self, self._memory_cap if memory_cap is None else memory_cap)

    def to_toml(self) -> str:
        """The scene as it was requested, as the text of a scene file, without any voxels."""
        return to_toml(self)

    @property
    def volume_path(self) -> Path | None:
        """The volume's file or folder; None for a volume that was passed as an array, is computed or is a URL."""
        file = getattr(self.volume, "file", None)
        return None if not isinstance(file, str) or is_url(file) else self._folder / file

    @property
    def input_paths(self) -> list[Path]:
        """The files and folders that the scene names: volume, fields and their label tables, environment, what
        lights project, clips, transfer function."""
        named = [*self.field, *self.channel, self.environment, *self.light, *self.clip, self.transfer_function]
        files = [getattr(table, "file", None) for table in named] + [field.labels_file for field in self.field]
        files += named_files(getattr(self.volume, "file", None), self._folder)
        return [self._folder / file for file in files if isinstance(file, str) and not is_url(file)]

    @property
    def moment(self) -> Moment | None:
        """The camera and the time of the picture that the scene was loaded from; None for any other scene."""
        return self._moment

    @property
    def folder(self) -> Path:
        """The folder that file names are relative to."""
        return self._folder

    @property
    def origin(self) -> str:
        """The scene file, or "scene" if it was built in Python; error messages begin with it."""
        return self._origin
