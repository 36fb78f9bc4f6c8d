"""Files whose channels are colours: every channel is read, and one value of each voxel is made of them."""

from __future__ import annotations

import os
from typing import Any

from clvol.errors import SeveralChannels, VolumeError
from clvol.readers import load_volume
from clvol.volume.colored import ColorValue, colored_volume
from clvol.volume.volume import Volume


def load_colored(path: str | os.PathLike, value: ColorValue, **options: Any) -> Volume:
    """The volume of the ``value`` of colours in a file, with its ``colors``: channels 0, 1 and 2 are red, green and
    blue, channel 3 is alpha if there are four. ``options``: as for ``load_volume``. Raises VolumeError."""
    where = os.fspath(path)
    options = {**options, "channel": None}
    try:
        load_volume(path, **options)
    except SeveralChannels as several:
        numbers = several.numbers
    else:
        raise VolumeError(where, "one value per voxel", "red, green and blue channels, for volume.color")
    if len(numbers) not in (3, 4):
        raise VolumeError(where, f"{len(numbers)} channels", "red, green and blue, and perhaps alpha, for volume.color")
    channels = [load_volume(path, **{**options, "channel": number}) for number in numbers]
    return colored_volume(channels, value, Volume, where)
