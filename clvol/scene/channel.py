"""[[channel]]: the channels of a file, each with its own colour and window, as in fluorescence microscopy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BeforeValidator, Field, WrapValidator, model_validator

from clvol.errors import SceneError
from clvol.scene.table import COLOR, AsTuple, Color, Fraction, Number, Table, wrong
from clvol.scene.transfer_function import ControlPoint, check_points
from clvol.scene.transfer_layer import function_of
from clvol.scene.volume import Choice, VolumeSettings, is_path, path_text
from clvol.transfer import TransferFunction
from clvol.volume.axis import ValueAxis
from clvol.volume.volume import Volume

LARGEST_CHANNELS = 6
BLENDS = ("additive", "screen", "maximum")  # of pictures; "mix" makes one medium of all channels
_CURVE = 13  # points of a function with a gamma: as many as one register holds the pieces of
_KEYS = ("color", "range", "gamma", "opacity")
# Two channels are told apart best in magenta and green, more in the colours of CMY and RGB.
_COLORS = {
    1: ((1.0, 1.0, 1.0),),
    2: ((1.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
}
_MORE = ((0.0, 1.0, 1.0), (1.0, 0.0, 1.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def default_color(number: int, count: int) -> tuple[float, float, float]:
    """The sRGB colour of channel ``number`` of ``count`` where neither the scene nor the file states one."""
    return _COLORS.get(count, _MORE)[number % len(_COLORS.get(count, _MORE))]


@dataclass(frozen=True, eq=False)
class ResolvedChannel:
    """A channel with its volume: ``function`` is in the stored numbers of ``volume``, which ``axis`` maps to values."""

    volume: Volume
    function: TransferFunction
    name: str
    axis: ValueAxis = ValueAxis()


def _file(value: Any, check: Callable[[Any], Any]) -> Any:
    return value if isinstance(value, Volume) else check(value)


class ChannelSettings(Table):
    """One channel: the voxels that it is read from, and their colour and opacity.

    The first table [[channel]] shows channel 0 of the file of [volume], the second one channel 1, unless ``channel``
    or ``file`` says otherwise. Opacity rises from 0 at the lower end of ``range`` to ``opacity`` at the upper one, as
    (position in the range) ^ ``gamma``, over the opacity_unit of [transfer_function]; ``color`` is the same everywhere,
    so that brightness follows the value. ``points`` take the place of all four.

    How channels are put together is ``integration.blend``. What is left out is chosen from the voxels of the channel,
    and from what the file says of its display (OME, omero).
    """

    channel: Choice = Field(
        None,
        title="Which channel of the file; by default the first for the first table, the second for the next.",
        description="the index (from 0) or the name of a channel",
        examples=[0],
    )
    file: Annotated[
        Annotated[str, BeforeValidator(path_text), AfterValidator(is_path), Field(min_length=1)], WrapValidator(_file)
    ] | None = Field(
        None,
        title="File of the channel, where it is not that of [volume]; from Python also a clvol.Volume.",
        description="the name of a volume file, in quotes",
        examples=["nuclei.tif"],
    )
    color: Color | None = Field(
        None,
        title="Colour of the channel, in color_space; by default the file's, or magenta and green, or others.",
        description=COLOR,
        examples=[[0.0, 1.0, 0.0]],
    )
    range: Annotated[tuple[Number, Number], AsTuple] | None = Field(
        None,
        title="Values of opacity 0 and of the full opacity (contrast limits); by default chosen from the voxels.",
        description="two finite numbers [low, high], ascending",
        examples=[[120.0, 4000.0]],
    )
    gamma: Number = Field(
        1.0, gt=0, le=10,
        title="Exponent of the position in the range: below 1 faint structures are lifted.",
        description="a number greater than 0, at most 10",
    )
    opacity: Fraction | None = Field(
        None,
        title="Opacity at the upper end of the range, over one opacity_unit; by default chosen, 1 for projections.",
        description="a number from 0 to 1",
        examples=[0.4],
    )
    points: Annotated[tuple[ControlPoint, ...], AsTuple] | None = Field(
        None,
        title="Control points as in [transfer_function], in place of color, range, gamma and opacity.",
        description="a list of points { value = …, opacity = …, color = [r, g, b] }",
        examples=[[
            {"value": 0, "opacity": 0, "color": [0, 1.0, 0]},
            {"value": 200.0, "opacity": 0.5, "color": [0, 1.0, 0]},
        ]],
    )

    @classmethod
    def table_name(cls) -> str:
        return "channel"

    @model_validator(mode="after")
    def _one_function(self) -> ChannelSettings:
        if self.range is not None and not self.range[0] < self.range[1]:
            raise wrong("range", list(self.range), "two finite numbers [low, high], ascending")
        if self.points is not None:
            for key in _KEYS:
                if key in self.model_fields_set:
                    raise wrong(key, getattr(self, key), f"either points or {key}, not both")
            check_points(self.points)
        if isinstance(self.file, Volume) and self.channel is not None:
            raise wrong("channel", self.channel, "no channel beside a volume")
        return self

    @property
    def is_complete(self) -> bool:
        """Whether nothing is left to choose."""
        return self.points is not None or None not in (self.color, self.range, self.opacity)

    def source(self, number: int, volume: VolumeSettings | Volume, where: str) -> VolumeSettings | Volume:
        """What to read for channel ``number`` (from 0) of a scene with ``volume``. SceneError, beginning with
        ``where``, for an array that has no such channel."""
        if isinstance(self.file, Volume):
            return self.file
        if not isinstance(volume, VolumeSettings):
            if self.file is None and number > 0:
                raise SceneError(f"{where}.file", "missing", "a clvol.Volume for every channel but the first")
            if self.file is None:
                return volume
            return VolumeSettings(file=self.file, channel=self.channel)
        chosen = self.channel
        if chosen is None and self.file is None and volume.field is None:
            chosen = number
        update: dict[str, Any] = {} if chosen is None else {"channel": chosen}
        if self.file is not None:
            update["file"] = self.file
        return volume.model_copy(update=update) if update else volume

    def function(self, opacity_unit: float, decoded: Callable[[ArrayLike], np.ndarray]) -> TransferFunction:
        """The transfer function of a complete channel. ``decoded`` converts colours to linear light."""
        if self.points is not None:
            return function_of(self.points, opacity_unit, decoded)
        assert self.color is not None and self.range is not None and self.opacity is not None
        x = np.linspace(0.0, 1.0, 2 if self.gamma == 1 else _CURVE)
        x = x**2 if self.gamma < 1 else x  # denser where the curve is steep
        values = self.range[0] + x * (self.range[1] - self.range[0])
        color = np.broadcast_to(decoded(self.color), (x.size, 3))
        return TransferFunction(values, self.opacity * x**self.gamma, color, opacity_unit)

    def name(self, number: int) -> str:
        """As messages call it."""
        return str(number if self.channel is None else self.channel)
