"""What a Renderer changes of its scene between frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from clvol.errors import UsageError
from clvol.scene.environment import Environment
from clvol.scene.resolve import ResolvedScene


def with_environment(resolved: ResolvedScene, environment: Environment | Mapping[str, Any] | None) -> ResolvedScene:
    """``resolved`` with another [environment], whose file is found in the scene's folder. UsageError for what is none,
    and for a scene of channels; SceneError for wrong keys and for a file that is not there."""
    if resolved.channels:
        raise UsageError("set_environment", "called for a scene of channels", "set_scene")
    if isinstance(environment, Mapping):
        environment = Environment(**environment)
    if environment is not None and not isinstance(environment, Environment):
        expected = "a clvol.Environment, a dict of its keys, or None"
        raise UsageError("set_environment", f"got a {type(environment).__name__}", expected)
    if environment is not None:
        environment = environment.found_in(resolved.folder or Path(), resolved.origin)
    return replace(resolved, environment=environment)
