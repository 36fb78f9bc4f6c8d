"""Fills in what [[channel]] tables leave out, from the voxels of each channel and from what its file says."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clvol.choice.first_picture import FirstPicture
from clvol.choice.look import Point, balanced_unit
from clvol.errors import ClvolWarning
from clvol.scene.camera import Camera
from clvol.scene.channel import LARGEST_CHANNELS, ChannelSettings, default_color
from clvol.scene.default_unit import default_opacity_unit
from clvol.scene.first_picture import rounded
from clvol.scene.transfer_function import TransferFunctionSettings

if TYPE_CHECKING:
    from clvol.errors import SeveralChannels
    from clvol.scene.scene import Scene

_MEAN_OPACITY = 0.45  # of rays through one channel
_MOST = 0.95  # opacity of a channel over one opacity unit
_TOP = 99.8  # percentile of what stands out from the background that is shown at full brightness


def completed(scene: Scene, memory_cap: int | None = None) -> Scene:
    """``scene`` with a [[channel]] for each channel of its file where it has none, and with the colour, range and
    opacity of each that leaves them out; with an opacity unit and, where the scene states no camera, a view of the
    first channel. The scene itself if nothing is left out. Raises SceneError, VolumeError.

    A range is that of the file (omero), or from the background to nearly the brightest that stands out from it. The
    opacity is such that rays through what a channel shows are of about the same opacity in all channels.
    """
    given = scene.transfer_function
    settings = scene.channel or _of_file(scene.several_channels)
    if all(each.is_complete for each in settings) and getattr(given, "opacity_unit", None) is not None:
        return scene
    several = scene.several_channels
    filled = scene if scene.channel else scene.model_copy(update={"channel": settings})
    volumes = filled.load_channels(memory_cap)
    unit = getattr(given, "opacity_unit", None) or default_opacity_unit(volumes[0].grid)
    projects = scene.integration.compositing != "over"
    complete, facts = [], []
    pictures = [FirstPicture(volume) for volume in volumes]
    for number, (each, picture) in enumerate(zip(settings, pictures)):
        made = _complete(each, number, len(settings), picture, unit, projects, several)
        complete.append(made)
        facts.append(_facts(made, several, number))
    table = (given or TransferFunctionSettings()).model_copy(update={"opacity_unit": unit})
    update: dict[str, Any] = {"channel": tuple(complete), "transfer_function": table}
    why = "as the scene states"
    if scene.camera is None or scene.camera.position is None:
        views = [picture.view(_points(each)) for each, picture in zip(complete, pictures)]
        view = replace(views[0], points=np.concatenate([each.points for each in views]))
        asked = scene.camera or Camera()
        camera = asked.complete(volumes[0].grid, scene.image, scene.origin, volumes[0].frame, view)
        update["camera"], why = rounded(camera, asked), view.why
    result = filled.model_copy(update=update)
    result._chosen = {
        "kind": "channels",
        "why": f"{len(complete)} channels of the file" if several else f"{len(complete)} channels",
        "channels": facts,
        "opacity_unit": unit,
        "view": why,
        "tables": sorted(update),
        "in_words": f"chosen: {len(complete)} channels ({'; '.join(_in_words(each) for each in facts)}), view {why}",
    }
    return result


def _of_file(several: SeveralChannels | None) -> tuple[ChannelSettings, ...]:
    if several is None:
        return ()
    numbers = several.numbers
    if len(numbers) > LARGEST_CHANNELS:
        what = f"has {len(numbers)} channels, of which the first {LARGEST_CHANNELS} are shown"
        warnings.warn(ClvolWarning(several.where, what, "state the [[channel]]s that are wanted"), stacklevel=2)
    return tuple(ChannelSettings(channel=number) for number in numbers[:LARGEST_CHANNELS])


def _complete(
    settings: ChannelSettings, number: int, count: int, picture: FirstPicture, unit: float, projects: bool,
    several: SeveralChannels | None,
) -> ChannelSettings:  # fmt: skip
    """``settings`` with everything stated."""
    if settings.is_complete:
        return settings
    update: dict[str, Any] = {}
    if settings.color is None:
        said = None if several is None else several.colors[number]
        update["color"] = said or default_color(number, count)
    low, high = settings.range or _range(picture, None if several is None else several.ranges[number])
    update["range"] = (low, high)
    if settings.opacity is None:
        update["opacity"] = 1.0 if projects else _opacity(picture, (low, high), unit)
    return settings.model_copy(update=update)


def _range(picture: FirstPicture, said: tuple[float, float] | None) -> tuple[float, float]:
    """The values of opacity 0 and of full opacity."""
    if said is not None:
        return said
    volume = picture.volume
    low, high = (float(end) for end in volume.axis.span(volume.value_range))
    found = picture.statistics
    if found is not None:
        values = found.sample.values[np.isfinite(found.sample.values)]
        base = found.value(max(2.0 * found.noise_signal, 0.25 * found.edge)) if found.sign > 0 else low
        above = values[values > base]
        top = float(np.percentile(above, _TOP)) if above.size else high
        if base < top:
            low, high = base, top
    if not low < high:
        low, high = low - 0.5, low + 0.5
    digits = 3 - math.floor(math.log10(high - low))  # four significant digits of the range
    rounded_low, rounded_high = round(low, digits), round(high, digits)
    return (rounded_low, rounded_high) if rounded_low < rounded_high else (low, high)


def _opacity(picture: FirstPicture, ends: tuple[float, float], unit: float) -> float:
    """The opacity at the upper end with which rays through what the channel shows have the mean opacity
    ``_MEAN_OPACITY``."""
    statistics = picture.statistics
    if statistics is None:
        return 0.5
    white = (1.0, 1.0, 1.0)
    balanced = balanced_unit(statistics, [(ends[0], 0.0, white), (ends[1], 0.5, white)], _MEAN_OPACITY)
    return round(float(np.clip(-np.expm1(np.log(0.5) * unit / balanced), 0.001, _MOST)), 4)


def _points(settings: ChannelSettings) -> list[Point]:
    """What a complete channel shows."""
    if settings.points is not None:
        return [(point.value, point.opacity, point.color) for point in settings.points]
    assert settings.range is not None
    return [(settings.range[0], 0.0, (1.0, 1.0, 1.0)), (settings.range[1], 1.0, (1.0, 1.0, 1.0))]


def _facts(settings: ChannelSettings, several: SeveralChannels | None, number: int) -> dict[str, Any]:
    name = several.names[number] if several is not None else None
    facts: dict[str, Any] = {"channel": settings.name(number) if name is None else name}
    if settings.points is None:
        facts |= {"color": list(settings.color or ()), "range": list(settings.range or ()), "opacity": settings.opacity}
    return facts


def _in_words(facts: dict[str, Any]) -> str:
    if "range" not in facts:
        return str(facts["channel"])
    red, green, blue = (round(255 * part) for part in facts["color"])
    low, high = facts["range"]
    return f"{facts['channel']} #{red:02x}{green:02x}{blue:02x} {low:.6g} to {high:.6g}"


