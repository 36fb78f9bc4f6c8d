"""Scenes that are prepared on several devices, which share their pictures; for whole searches of settings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from clvol.device.view import EVERY_PIXEL, Pixels
from clvol.errors import DeviceError, RenderError, VolumeError
from clvol.integrators.base import FrameData, Prepared, Progress
from clvol.opencl.context import DeviceContext
from clvol.render.device_group import DeviceGroup
from clvol.render.member import LocalMember
from clvol.render.notices import Notices
from clvol.render.prepared_cache import PreparedCache
from clvol.render.renderer import open_contexts
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene


class Engines(Protocol):
    """Where a search has its scenes prepared: on one device, or on several."""

    @property
    def contexts(self) -> list[DeviceContext]: ...

    @property
    def names(self) -> list[str]: ...

    @property
    def compile_seconds(self) -> float: ...

    def prepare(
        self, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared: ...

    def compression(self, resolved: ResolvedScene, blocks: Mapping[str, Any] | None = None) -> dict[str, Any]: ...

    def close(self) -> None: ...


def open_engines(devices: Sequence[Any] | None) -> Engines:
    """Prepared scenes on the devices that are requested, the default one if there are none. DeviceError for one that
    does not work."""
    contexts = open_contexts(devices)
    return PreparedCache(contexts[0]) if len(contexts) == 1 else SharedEngines(contexts)


def close_engines(engines: Engines, notices: Notices | None = None) -> None:
    """Frees the memory of all devices; ``notices`` warns of those that have failed."""
    contexts = engines.contexts
    engines.close()
    if isinstance(engines, SharedEngines):
        if notices is not None:
            engines.tell(notices)
        return
    for context in contexts:
        context.release()


class SharedEngines:
    """As ``PreparedCache``, for several devices. One that fails is left out."""

    def __init__(self, contexts: Sequence[DeviceContext]) -> None:
        self._members = [LocalMember(context) for context in contexts]
        self.group = DeviceGroup(self._members)

    @property
    def contexts(self) -> list[DeviceContext]:
        """Those of the devices that work, the fastest first."""
        return [member.context for member in sorted(self._members, key=lambda m: -m.speed) if member.works]

    @property
    def names(self) -> list[str]:
        """Of the devices that work."""
        return [member.name for member in self._members if member.lost is None]

    @property
    def compile_seconds(self) -> float:
        return sum(member.context.compile_seconds for member in self._members)

    def prepare(
        self, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> SharedPrepared:
        """As ``PreparedCache.prepare``."""
        prepared: dict[int, Prepared] = {}
        self.group.wait_for_one()
        for number, member in enumerate(self._members):
            if member.works:
                try:
                    prepared[number] = member.cache.prepare(resolved, progress, wait)
                except (RenderError, DeviceError, VolumeError) as error:
                    self.group.lose(member, error)
        return SharedPrepared(self, prepared)

    def compression(self, resolved: ResolvedScene, blocks: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """As ``PreparedCache.compression``."""
        return self.group.alive[0].compression(resolved, blocks)

    def tell(self, notices: Notices) -> None:
        """Warns of devices that have failed."""
        notices.of_devices({m.name: m.lost for m in self._members if m.lost is not None}, self.names)

    def close(self) -> None:
        self.group.close()
        for member in self._members:
            member.close()


class SharedPrepared:
    """A scene that several devices have prepared (a ``Prepared``)."""

    def __init__(self, engines: SharedEngines, prepared: dict[int, Prepared]) -> None:
        self._engines, self._prepared = engines, prepared
        self._costs: dict[tuple[int, int], np.ndarray] = {}  # of the tiles of its pictures

    def _use(self) -> DeviceGroup:
        """The group, with this scene as the one that is rendered."""
        group = self._engines.group
        for number, member in enumerate(group.members):
            member.prepared = self._prepared.get(number)
        group.remember_in(self._costs)
        return group

    @property
    def _first(self) -> Prepared:
        return next(iter(self._prepared.values()))

    @property
    def resolved(self) -> ResolvedScene:
        return self._first.resolved

    @property
    def renders_all_pixels(self) -> bool:
        return self._first.renders_all_pixels

    @property
    def held(self) -> Sequence[object]:
        return [part for prepared in self._prepared.values() for part in prepared.held]

    @property
    def visible_share(self) -> float:
        return self._first.visible_share

    @property
    def visible_cells(self) -> tuple[np.ndarray, int] | None:
        return self._first.visible_cells

    def for_scene(self, resolved: ResolvedScene) -> SharedPrepared:
        return SharedPrepared(self._engines, {k: each.for_scene(resolved) for k, each in self._prepared.items()})

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        group = self._use()
        group.warm_up(width, height, depth)

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: Pixels = EVERY_PIXEL,
        share: bool = False,
    ) -> FrameData:
        """As ``Prepared.render``; ``share`` as in ``DeviceGroup.render``. Otherwise a lattice of pixels is rendered by
        the fastest device alone: there is little to share, and its time tells settings apart only if it is always the
        same device's."""
        return self._use().render(camera, width, height, progress, depth, lattice, share)
