"""Integrators, the ways of rendering scenes, behind two protocols.

An :class:`Integrator` knows, without a device, which scenes it renders, what it compiles for them and how much
memory they take. It makes a :class:`Prepared` scene, which is resident on one device and renders frames.

To add an integrator, make a folder beside this file with an ``integrator.py`` that ends in an object ``INTEGRATOR``,
add its name to ``registry.py``, and add the same name to ``integration.method`` of the scene
(clvol/scene/integration.py).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, runtime_checkable

import numpy as np

from clvol.device.view import EVERY_PIXEL, Pixels
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
    ``clvol.Frame``; ``samples``: samples of the volume; ``rays``: rays that were cast; ``counters``: those of its
    effects; ``notes``: anything else that belongs in its stats, as plain JSON types."""

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

    @property
    def visible_cells(self) -> tuple[np.ndarray, int] | None:
        """Where anything can be visible: bool [z, y, x], cells of 2^n lattice units, and n; None where that is not
        known."""
        ...

    def for_scene(self, resolved: ResolvedScene) -> Prepared:
        """The same for ``resolved``, which may differ only in camera, image, animation, step and early termination.
        Shares everything that does not depend on these; compiles nothing."""
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
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData:
        """One picture of ``width`` by ``height`` pixels, or only its pixels on ``lattice``, or those that it lists.
        RenderError if the device fails."""
        ...


@runtime_checkable
class ChangesStep(Protocol):
    """A ``Prepared`` that can turn into that of another step of its series."""

    def for_step(self, resolved: ResolvedScene) -> Any | None:
        """The same for ``resolved``, which differs in the step alone. It takes over programs, tables and buffers, the
        volume's too: this one must not be used any more. None, with nothing changed, where that is not possible."""
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
        """One picture, refined until ``seconds`` have passed since the call. RenderError if the device fails."""
        ...


# Counters of pictures with ``KeptDepths``, which no picture has besides: cl/coherence.h.
SHARED_COHERENCE = ("coherence reused", "coherence holes", "coherence late", "coherence audited")


@dataclass(frozen=True, eq=False)
class KeptDepths:
    """Where rays of a shared picture first contribute, float32 [height, width] as in cl/coherence.h: ``now``, which the
    devices write, and ``before``, of the picture ``number_before``, after which they start; None: at the hull."""

    now: np.ndarray
    before: np.ndarray | None
    number: int
    number_before: int


@dataclass(frozen=True, eq=False)
class PictureArrays:
    """Where the devices that share a picture write it: ``rgba`` float32 [height, width, 4], ``depth`` float32
    [height, width] or None, and ``kept``, if it takes starts from the one before."""

    rgba: np.ndarray
    depth: np.ndarray | None
    kept: KeptDepths | None = None


@dataclass(frozen=True, eq=False)
class PartOfPicture:
    """What rendering some tiles took: ``costs`` float64 [tiles], comparable between devices, and counts as in
    ``FrameData``."""

    costs: np.ndarray
    samples: int
    rays: int
    counters: dict[str, int]


class TiledPictureParts(Protocol):
    """A picture on one of the devices that share it. Its tiles can be rendered in any order, stage after stage: a
    stage begins once the one before is complete on all devices. ``notes``: as in ``FrameData``. ``coherent``: whether
    it takes ``PictureArrays.kept``; then ``notes["coherence"]`` has the "reason" why rays start at the hull, or None,
    and the scene's "audit"."""

    notes: dict[str, Any]
    coherent: bool

    @property
    def tile(self) -> tuple[int, int]:
        """Width and height in pixels of a tile."""

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """Width and height in pixels of the stages' pictures; that of the last is the picture's."""

    @property
    def stages(self) -> list[int]:
        """Numbers of tiles of the stages."""

    def expected_costs(self, stage: int) -> np.ndarray:
        """float64 [tiles] > 0: relative costs."""
        ...

    def begin(self, stage: int, arrays: list[PictureArrays]) -> None:
        """Begins a stage. ``arrays``: of all stages."""
        ...

    def render(self, stage: int, tiles: np.ndarray) -> PartOfPicture:
        """Renders ``tiles`` (numbers); returns when they are done. RenderError if the device fails."""
        ...

    def end(self, stage: int, tiles: np.ndarray) -> None:
        """Brings ``tiles``, rendered here, into the stage's arrays."""
        ...


@runtime_checkable
class RendersParts(Protocol):
    """A ``Prepared`` whose pictures can be shared by devices."""

    def warm_up_parts(self, width: int, height: int, depth: bool = True) -> None:
        """Compiles everything that parts of a picture of this size need."""

    def parts(
        self, camera: Camera, width: int, height: int, depth: bool = True, lattice: Pixels = EVERY_PIXEL
    ) -> TiledPictureParts | None:
        """A picture, or its pixels on ``lattice``, to be rendered in parts; None if there is nothing to divide."""
        ...


@runtime_checkable
class RendersOnSeveral(Protocol):
    """A ``Prepared`` that shares rays among devices itself."""

    def render_on(
        self, prepared: Sequence[Any], camera: Camera, width: int, height: int, progress: Progress | None,
        depth: bool, on_loss: Callable[[int, BaseException], None], seconds: float | None = None,
        lattice: Pixels = EVERY_PIXEL,
    ) -> FrameData | None:  # fmt: skip
        """The picture, or its pixels on ``lattice``, on the devices of ``prepared``, which have the same scene; the
        first one is this. None if there is nothing to share. ``on_loss(device, error)`` is called for one that fails;
        the error of the last one is raised. ``seconds``: as ``RefinesInTime.render_for_time``."""
        ...


T = TypeVar("T")


class Shared:
    """Data that prepared scenes of one device share, such as volumes and resident blocks, kept by value.

    ``dropped`` is called with each object that is no longer kept.
    """

    def __init__(self, context: DeviceContext, dropped: Callable[[object], None] | None = None) -> None:
        self.context = context
        self._dropped = dropped
        self._kept: dict[str, dict[Hashable, Any]] = {}

    def keep(self, kind: str, key: Hashable, make: Callable[[], T], most: int | None = None) -> T:
        """The object of ``kind`` kept under ``key``; made now if there is none. The latest ``most`` objects of a kind
        are kept; None: all. Objects that are dropped are closed, if they have a ``close``."""
        kept = self._kept.setdefault(kind, {})
        if key not in kept:
            while most is not None and len(kept) >= most:
                self._drop(kind, next(iter(kept)))
            kept[key] = make()
        return kept[key]

    def rename(self, kind: str, key: Hashable, new: Hashable) -> None:
        """Keeps under ``new`` what is kept under ``key``, if anything is: it has turned into that."""
        kept = self._kept.get(kind, {})
        if key in kept:
            kept[new] = kept.pop(key)

    def forget(self, parts: Sequence[object]) -> None:
        """Drops whatever is kept under a key that is, or contains, one of ``parts``."""
        for kind, kept in self._kept.items():
            for key in list(kept):
                of_key = key if isinstance(key, tuple) else (key,)
                if any(part is each for part in parts for each in of_key):
                    self._drop(kind, key)

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
    """A way of rendering scenes. Integrators have no state."""

    name: str  # ``integration.method`` of a scene
    reads_blocks: bool  # volumes may be larger than memory: they are read block by block
    holds_codes: bool  # ``compression.decode`` "resident": gets an ``UndecodedVolume`` and decodes blocks of it itself
    tuned_as: str  # the integrator whose settings are searched for a scene that names this one

    def check(self, resolved: ResolvedScene) -> None:
        """SceneError if the scene needs something that this integrator does not render."""
        ...

    def refines_in_time(self, scene: Scene | ResolvedScene) -> bool:
        """Whether pictures of the scene can be refined for a given time (``Renderer.render(seconds=...)``)."""
        ...

    def device_bytes(self, volume: Volume, scene: Scene | ResolvedScene) -> int:
        """Bytes on the device for the volume, the picture, and everything else that rendering needs."""
        ...

    def memory_advice(self, scene: Scene | ResolvedScene) -> tuple[str, str]:
        """Two phrases about the settings that decide how much memory is used: one that ``clvol info`` prints before the
        sum, and one that is appended to the error if the sum is too large; "" for none."""
        ...

    def how_shown(self, resolved: ResolvedScene) -> Mapping[str, str]:
        """By the names of effects, phrases on how this integrator shows them that ``clvol explain`` appends to the
        reasons."""
        ...

    def programs(self, resolved: ResolvedScene, lanes: int) -> Mapping[str, Mapping[str, int]]:
        """The files of cl/ that are compiled for the scene, each with its switches (-D)."""
        ...

    def sources(self, resolved: ResolvedScene) -> tuple[Sequence[str], bytes]:
        """Patterns of further files of cl/ on which the picture depends, and sources that are not in cl/."""
        ...

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        """Settings whose change requires another prepared scene, in addition to those common to all integrators."""
        ...

    def simplified(self, resolved: ResolvedScene, shared: Shared) -> ResolvedScene:
        """The scene without effects that have no consequence, and with the voxels that are rendered."""
        ...

    def prepare(
        self, shared: Shared, resolved: ResolvedScene, progress: Progress | None = None, wait: bool | None = None
    ) -> Prepared:
        """Makes ``resolved``, which is simplified, resident. ``progress`` reports blocks that are read. ``wait`` False:
        a thread reads them, and frames show those that are there until all have arrived; None: as in the last
        request."""
        ...

    def ask_again(self, prepared: Any, progress: Progress | None, wait: bool | None) -> None:
        """Called when ``prepared``, which was kept, is used once more; arguments as for ``prepare``."""
        ...
