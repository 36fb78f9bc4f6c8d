"""All integrators. To add one, see clvol/integrators/base.py; it is one line here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clvol.errors import SceneError
from clvol.features.refuse import check_effects
from clvol.integrators.base import Integrator
from clvol.integrators.multiresolution.integrator import Multiresolution
from clvol.integrators.pyramid.integrator import Pyramid
from clvol.integrators.raycast.integrator import Raycast
from clvol.integrators.reference.integrator import Reference
from clvol.scene.resolve import ResolvedScene

if TYPE_CHECKING:
    from clvol.scene import Scene

INTEGRATORS: dict[str, Integrator] = {
    each.name: each for each in (Raycast(), Multiresolution(), Pyramid(), Reference())
}


def integrator_of(scene: Scene | ResolvedScene) -> Integrator:
    """The integrator that the scene names. SceneError for an unknown name."""
    name = scene.integration.method
    if name not in INTEGRATORS:
        expected = " or ".join(map(repr, INTEGRATORS))
        raise SceneError(f"{scene.origin}: integration.method", f"got {name!r}", expected)
    return INTEGRATORS[name]


def check_scene(resolved: ResolvedScene) -> None:
    """SceneError for what the scene calls for and no kernel renders: better no picture than a wrong one."""
    integrator = integrator_of(resolved)
    check_effects(resolved)
    integrator.check(resolved)
