"""All integrators by name. To add one, see clvol/integrators/base.py; its name is one line here."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from clvol.errors import SceneError
from clvol.features.compression import check_compression
from clvol.features.glow import check_glow
from clvol.features.lighting import check_light_at
from clvol.features.refraction import check_refraction
from clvol.features.refuse import check_effects
from clvol.features.segments import check_segments
from clvol.integrators.base import Integrator
from clvol.integrators.channels import check_channels
from clvol.integrators.decoding import check_decoding
from clvol.scene.channel_scenes import channel_scenes
from clvol.scene.resolve import ResolvedScene

if TYPE_CHECKING:
    from clvol.scene import Scene

# Each names a folder beside this file, with an object INTEGRATOR in its integrator.py. They are imported once a scene
# names them, as commands are in clvol/cli: a plain picture needs no other integrator.
NAMES = (
    "raycast",
    "multiresolution",
    "pyramid",
    "slicing",
    "reference",
)


@cache
def integrator_named(name: str) -> Integrator:
    """The integrator of that name, one of NAMES."""
    integrator: Integrator = import_module(f"clvol.integrators.{name}.integrator").INTEGRATOR
    return integrator


def integrator_of(scene: Scene | ResolvedScene) -> Integrator:
    """The integrator that the scene names. SceneError for an unknown name."""
    name = scene.integration.method
    if name not in NAMES:
        expected = " or ".join(map(repr, NAMES))
        raise SceneError(f"{scene.origin}: integration.method", f"got {name!r}", expected)
    return integrator_named(name)


def check_scene(resolved: ResolvedScene) -> None:
    """SceneError for what the scene calls for and no kernel renders: better no picture than a wrong one."""
    check_channels(resolved)
    for scene in channel_scenes(resolved):
        _check_scene(scene)


def _check_scene(resolved: ResolvedScene) -> None:
    integrator = integrator_of(resolved)
    check_effects(resolved)
    check_glow(resolved)
    check_refraction(resolved)
    check_light_at(resolved)
    check_segments(resolved)
    check_compression(resolved)
    check_decoding(resolved, integrator)
    integrator.check(resolved)
