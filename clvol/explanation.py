"""What a scene calls for, in words, and what therefore gets compiled."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from clvol.device.environment_file import load_radiance
from clvol.features.analysis import effects, reduced
from clvol.features.scene_warnings import camera_warning, scene_warnings
from clvol.integrators.registry import check_scene, integrator_of
from clvol.opencl.context import compile_options
from clvol.opencl.kernels_path import kernel_folder
from clvol.scene.environment import Environment
from clvol.scene.resolve import ResolvedScene


def explain(resolved: ResolvedScene) -> dict[str, Any]:
    """As ``clvol explain --json``: effects with reasons, what identifies the compiled kernel, and "warnings",
    of what can hardly be meant. SceneError for what a Renderer would refuse, such as environments that cannot be read.
    """
    check_scene(resolved)
    _read_environment(reduced(resolved).environment)
    listed = [
        {"name": e.name, "called_for": e.called_for, "reason": e.reason} for e in effects(resolved)
    ]
    image, told = resolved.image, scene_warnings(resolved)
    away = camera_warning(resolved.camera, resolved.volume.grid, image.width, image.height)
    told += [] if away is None else [away]
    return {
        "effects": listed,
        "kernel_hash": kernel_hash(resolved),
        "warnings": [str(warning) for warning in told],
    }


def _read_environment(environment: Environment | None) -> None:
    """SceneError if it cannot be rendered."""
    if environment is not None:
        load_radiance(
            environment.path, environment.layout, environment.intensity,
            environment.rotation_degrees,
        )  # fmt: skip


def kernel_hash(resolved: ResolvedScene, lanes: int = 16) -> str:
    """Identifies exactly what is compiled for this scene: sources and switches.

    On a device with room for what is precomputed. The voxels count as they are rendered: coefficients of a prefilter
    are found for it. ``lanes``: rays that a work-item marches together, 16 on CPUs.
    """
    digest = hashlib.sha256()
    programs = scene_programs(resolved, lanes)
    for file, switches in programs.items():
        digest.update(" ".join((file, *compile_options(switches))).encode())
    files, more = integrator_of(resolved).sources(resolved)
    digest.update(more)
    for pattern in (*programs, *files):
        for path in sorted(kernel_folder().glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def scene_programs(resolved: ResolvedScene, lanes: int = 16) -> Mapping[str, Mapping[str, int]]:
    """The files of cl/ that are compiled for this scene, beside those that all scenes share for empty space, each
    with its switches."""
    return integrator_of(resolved).programs(resolved, lanes)
