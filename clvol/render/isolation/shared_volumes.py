"""The volumes of a scene in several processes: voxels in shared memory, or mapped from their file; stores are opened
again. No voxel goes through a socket."""

from __future__ import annotations

import mmap
import os
from typing import Any

import numpy as np

from clvol.readers.zarr import StoredVolume
from clvol.render.isolation.channel import Message
from clvol.render.isolation.scene_message import decoded, encoded
from clvol.render.isolation.segments import Segment, array_in, mapped
from clvol.render.isolation.shared_series import step_facts, step_of
from clvol.store.turned import TurnedBlocks
from clvol.store.zarr_store import open_store
from clvol.volume.lazy import FilledVolume
from clvol.volume.series import StepVolume, VolumeSeries, is_other_step
from clvol.volume.volume import Volume

_COMPARED = 257  # voxels of a mapped file and of the file that has its name now


class SharedVolumes:
    """The volumes of a Renderer, each with a number, as its processes get them."""

    def __init__(self) -> None:
        self._volumes: list[Volume | None] = []  # None: a step of a series that was shown before
        self._messages: dict[int, tuple[Message, int | None]] = {}
        self._series: list[VolumeSeries] = []  # those that volumes are steps of
        self._held: dict[int, Any] = {}  # what the descriptors belong to

    def number(self, volume: Volume) -> int:
        for number, each in enumerate(self._volumes):
            if each is volume:
                return number
            if each is not None and is_other_step(each, volume):  # only the step that is shown is in shared memory
                self._volumes[number] = None
                self._messages.pop(number, None)
                self._held.pop(number, None)
        self._volumes.append(volume)
        return len(self._volumes) - 1

    def message(self, number: int, keep_blocks: bool) -> tuple[Message, int | None]:
        """What ``volume_of`` takes: a description, and the descriptor of the file with the voxels, if there is one.
        ``keep_blocks``: a store is opened again, in place of reading all its voxels."""
        if number not in self._messages:
            volume = self._volumes[number]
            assert volume is not None
            self._messages[number] = self._described(number, volume, keep_blocks)
        return self._messages[number]

    @property
    def gone(self) -> list[int]:
        """The numbers of volumes that no scene will need."""
        return [number for number, volume in enumerate(self._volumes) if volume is None]

    def close(self) -> None:
        self._messages.clear()
        self._held.clear()

    def _described(self, number: int, volume: Volume, keep_blocks: bool) -> tuple[Message, int | None]:
        facts: Message = {
            "name": volume.name, "frame": volume.frame, "path": volume.path, "format": volume.format,
            "unit": volume.unit, "grid": encoded(volume.grid), "axis": encoded(volume.axis), "labels": volume.labels,
            "files": list(volume.files),
        }  # fmt: skip
        if isinstance(volume, StepVolume):
            facts["step"] = step_facts(volume, self._series)
        inner = volume._volume if isinstance(volume, FilledVolume) else volume
        is_coded = getattr(getattr(inner, "blocks_source", None), "codes", None) is not None
        if isinstance(inner, StoredVolume) and (keep_blocks or is_coded):
            facts["store"] = str(inner.blocks_source.path)
            facts["turned"] = isinstance(inner.blocks_source, TurnedBlocks)
            facts["cap"] = inner._memory_cap
            facts["fill"] = volume._value if isinstance(volume, FilledVolume) else None
            return facts, None
        data = volume.data
        facts |= {"dtype": data.dtype.str, "shape": list(data.shape), "offset": 0, "nbytes": data.nbytes}
        file = _mapped_file(data)
        if file is not None:
            descriptor, facts["offset"] = file
            self._held[number] = _Descriptor(descriptor)
            return facts, descriptor
        segment = Segment(data.nbytes)
        segment.array(data.dtype, data.shape)[...] = data
        self._held[number] = segment
        return facts, segment.descriptor


class _Descriptor:
    def __init__(self, number: int) -> None:
        self._number = number

    def __del__(self) -> None:
        os.close(self._number)


def _mapped_file(data: np.ndarray) -> tuple[int, int] | None:
    """A new descriptor of the file from which ``data`` is mapped, and where in it ``data`` begins. None if it is not
    mapped, or if the file seems to be another one by now."""
    base: Any = data
    while isinstance(base, np.ndarray) and not (isinstance(base, np.memmap) and isinstance(base.base, mmap.mmap)):
        base = base.base
    name = getattr(base, "filename", None)
    if not isinstance(base, np.memmap) or name is None or not data.flags.c_contiguous:
        return None
    offset = int(base.offset) + data.ctypes.data - base.ctypes.data  # type: ignore[attr-defined]
    try:
        descriptor = os.open(name, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0))
    except OSError:
        return None
    try:
        again = mapped(os.dup(descriptor), data.nbytes, writable=False, offset=offset)
    except (OSError, ValueError):
        os.close(descriptor)
        return None
    step = max(1, data.size // _COMPARED)
    some = (data.reshape(-1)[::step].tobytes(), array_in(again, data.dtype, data.shape, offset).reshape(-1)[::step])
    if some[0] != some[1].tobytes():
        os.close(descriptor)
        return None
    return descriptor, offset


def volume_of(facts: Message, descriptor: int | None, series: dict[int, VolumeSeries]) -> Volume:
    """The volume that ``SharedVolumes.message`` describes. Its voxels cannot be written to here. ``series``: those
    that are known here, by number."""
    grid, axis = decoded(facts["grid"]), decoded(facts["axis"])
    if descriptor is None:
        source: Any = open_store(facts["store"])
        stored = StoredVolume(TurnedBlocks(source) if facts["turned"] else source, facts["cap"])
        stored.grid, stored.path, stored.format, stored.axis = grid, facts["path"], facts["format"], axis
        return stored if facts["fill"] is None else FilledVolume(stored, facts["fill"])
    memory = mapped(descriptor, facts["nbytes"], writable=False, offset=facts["offset"])
    voxels = array_in(memory, np.dtype(facts["dtype"]), facts["shape"], facts["offset"])
    volume = Volume(
        voxels, grid.spacing, grid.origin, grid.direction, facts["name"], frame=facts["frame"], path=facts["path"],
        format=facts["format"], unit=facts["unit"], slope=axis.slope, offset=axis.offset, labels=facts["labels"],
    )  # fmt: skip
    volume.grid, volume.files = grid, tuple(facts["files"])
    return volume if "step" not in facts else step_of(volume, facts["step"], series)
