"""What integrators have in common whose volume is on the device as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from clvol.device.memory import scene_bytes
from clvol.device.voxels import as_rendered
from clvol.integrators.base import Progress, Shared
from clvol.scene.resolve import ResolvedScene
from clvol.volume import Volume

if TYPE_CHECKING:
    from clvol.scene import Scene


class WholeVolume:
    """The answers of an ``Integrator`` that reads no blocks and has no settings of its own. Such integrators inherit
    them, and state what differs."""

    reads_blocks = False
    holds_codes = False

    def refines_in_time(self, scene: Scene | ResolvedScene) -> bool:
        return False

    def device_bytes(self, volume: Volume, scene: Scene | ResolvedScene) -> int:
        return scene_bytes(volume, scene.image.width, scene.image.height)

    def memory_advice(self, scene: Scene | ResolvedScene) -> tuple[str, str]:
        return "", ""

    def how_shown(self, resolved: ResolvedScene) -> Mapping[str, str]:
        return {}

    def key(self, resolved: ResolvedScene) -> tuple[Any, ...]:
        return ()

    def simplified(self, resolved: ResolvedScene, shared: Shared) -> ResolvedScene:
        return as_rendered(resolved, shared.keep)

    def ask_again(self, prepared: Any, progress: Progress | None, wait: bool | None) -> None:
        pass
