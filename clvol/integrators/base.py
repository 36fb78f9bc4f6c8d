"""What an integrator is: a way of rendering scenes, behind two declared protocols.

An :class:`Integrator` knows, without a device, which scenes it renders, what it compiles for them and how much
memory they take. It makes a :class:`Prepared` scene, which is resident on one device and renders frames.

To add an integrator: a folder beside this file with an ``integrator.py``, one line in ``registry.py``, and its name
in ``integration.method`` of the scene (clvol/scene/integration.py).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from clvol.device.view import EVERY_PIXEL, PixelLattice
from clvol.scene.camera import Camera
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume

if TYPE_CHECKING:
    from clvol.opencl.context import DeviceContext
    from clvol.scene import Scene

Progress = Callable[[int, int], None]  # (done, total)


@dataclass
class FrameData:
    """A rendered picture. ``rgba`` float32 [height, width, 4] and ``depth`` float32 [height, width] as in
    ``clvol.Frame``; ``samples`` of the volume and ``rays`` that it took; ``counters`` of its effects; ``notes``:
    whatever else belongs into its stats, as plain JSON types."""

    rgba: np.ndarray
    depth: np.ndarray | None
    samples: int
    rays: int
    counters: dict[str, int] = field(default_factory=dict)
    notes: dict[str, Any] = field(default_factory=dict, kw_only=True)


class Prepared(Protocol):
    """A scene that is resident on a device. It does not change: another scene has another one (``for_scene``)."""

    @property
    def resolved(self) -> ResolvedScene:
        """The scene, simplified."""

    @property
    def renders_all_pixels(self) -> bool:
        """Whether a lattice of pixels costs as much as the whole picture."""

    @property
    def held(self) -> Sequence[object]:
        """What it shares with others and cannot do without (``Shared.keep``)."""

    @property
    def visible_share(self) -> float:
        """The share of the volume's cells in which anything can be seen."""
        ...

    def for_scene(self, resolved: ResolvedScene) -> Prepared:
        """The same for ``resolved``, which may differ in camera, image, animation, step and early termination
        alone. Shares what these leave as it is; compiles nothing."""
        ...

    def warm_up(self, width: int, height: int, depth: bool = True) -> None:
        """Compiles everything that a frame of this size needs."""

    def render(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        lattice: PixelLattice = EVERY_PIXEL,
    ) -> FrameData:
        """One picture of ``width`` by ``height`` pixels, or of its pixels on ``lattice`` alone. RenderError where
        the device fails."""
        ...


@runtime_checkable
class RefinesInTime(Protocol):
    """A ``Prepared`` that can also refine a picture for a given time (``Integrator.refines_in_time``)."""

    def warm_up_for_time(self, depth: bool = True) -> None:
        """Compiles everything that such a picture needs."""

    def render_for_time(
        self,
        camera: Camera,
        width: int,
        height: int,
        progress: Progress | None = None,
        depth: bool = True,
        *,
        seconds: float,
    ) -> FrameData:
        """One picture, refined until ``seconds`` have passed since the call. RenderError where the device fails."""
        ...


T = TypeVar("T")


class Shared:
    """What prepared scenes of one device share: volumes, blocks that are resident, kept by value.

    ``dropped`` is called with whatever is no longer kept.
    """

    def __init__(self, context: DeviceContext, dropped: Callable[[object], None] | None = None) -> None:
        self.context = context
        self._dropped = dropped
        self._kept: dict[str, dict[Hashable, Any]] = {}

    def keep(self, kind: str, key: Hashable, make: Callable[[], T], most: int | None = None) -> T:
        """What was kept as ``kind`` under ``key``, or else made now. The ``most`` last made of a kind are kept;
        None: all. What goes is closed, if it has a ``close``."""
        kept = self._kept.setdefault(kind, {})
        if key not in kept:
            while most is not None and len(kept) >= most:
                self._drop(kind, next(iter(kept)))
            kept[key] = make()
        return kept[key]

    def close(self) -> None:
        for kind, kept in self._kept.items():
            for key in list(kept):
                self._drop(kind, key)

    def _drop(self, kind: str, key: Hashable) -> None:
        value = self._kept[kind].pop(key)
        close = getattr(value, "close", None)
        if close is not None:
            close()
        if self._dropped is not None:
            self._dropped(value)


class Integrator(Protocol):
    """A way of rendering scenes. Objects of this kind have no state."""

    name: str  # ``integration.method`` of a scene
    reads_blocks: bool  # volumes may be larger than memory: they are read block by block
    tuned_as: str  # the integrator whose settings are searched for a scene that names this one

    def check(self, resolved: ResolvedScene) -> None:
        """SceneError for what the scene calls for and this integrator does not render."""
        ...

    def refines_in_time(self, scene: Scene | ResolvedScene) -> bool:
        """Whether pictures of the scene can be refined for a given time (``Renderer.render(seconds=...)``)."""
        ...

    def device_bytes(self, volume: Volume, scene: Scene | ResolvedScene) -> int:
        """Bytes on the device for the volume, with the picture and what rendering it takes."""
        ...

    def memory_advice(self, scene: Scene | ResolvedScene) -> tuple[str, str]:
        """Words for how much of that is whose choice: what ``clvol info`` says before the sum, and what an error says
        where it is too much; "" for nothing."""
        ...

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        """The files of cl/ that are compiled for the scene, each with its switches (-D)."""
        ...

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        """Patterns of further files of cl/ on which the picture depends, and sources that are not in cl/."""
        ...

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        """Settings that another prepared scene is needed for, beside what counts for all integrators."""
        ...

    def simplified(self, resolved: ResolvedScene, shared: Shared) -> ResolvedScene:
        """The scene without what has no consequence, its voxels as they are rendered."""
        ...

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        """``resolved``, simplified, made resident. ``progress``: of blocks that are read. ``wait`` False: a thread
        reads them, and frames show what is there until all has come; None: as was said last."""
        ...

    def ask_again(self, prepared: Any, progress: Progress | None, wait: bool | None) -> None:
        """``prepared`` is wanted once more: as for ``prepare``, for one that was kept."""
        ...
