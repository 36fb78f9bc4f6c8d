"""What a scene calls for, in words, and what therefore gets compiled."""

from __future__ import annotations

import hashlib
from typing import Any

from clvol.device.environment_file import load_radiance
from clvol.device.gradients import storing_switches
from clvol.device.light_volume import METHODS
from clvol.device.prefilter import prefiltered
from clvol.device.quantise import quantised
from clvol.features.analysis import effects, reduced, reduced_for_frames
from clvol.features.refuse import refuse_unknown
from clvol.features.scene_warnings import camera_warning, scene_warnings
from clvol.features.vocabulary import GRADIENTS
from clvol.integrators.multiresolution.caster import block_switches
from clvol.integrators.pyramid.blocks import block_pyramid_switches
from clvol.integrators.pyramid.caster import pyramid_switches
from clvol.integrators.pyramid.oracles import oracle_named
from clvol.integrators.raycast.caster import raycast_switches
from clvol.opencl.context import compile_options
from clvol.opencl.kernels_path import kernel_folder
from clvol.scene.environment import Environment
from clvol.scene.resolve import ResolvedScene


def explain(resolved: ResolvedScene) -> dict[str, Any]:
    """As ``clvol explain --json``: effects with reasons, what identifies the compiled kernel, and "warnings",
    of what can hardly be meant. SceneError for what a Renderer would refuse, such as environments that cannot be read.
    """
    refuse_unknown(resolved)
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
    """Identifies exactly what gets compiled for this scene: sources and switches.

    On a device with room for what is precomputed. The voxels count as they are rendered:
    coefficients of a prefilter are found for it.
    """
    digest = hashlib.sha256()
    if resolved.integration.method == "reference":
        resolved = reduced(resolved)
        digest.update(f"{resolved.volume.dtype.name} {resolved.integration.filter}".encode())
        files = ["reference*"]
    else:
        programs = scene_programs(resolved, lanes)
        for file, switches in programs.items():
            digest.update(" ".join((file, *compile_options(switches))).encode())
        digest.update(_custom_source(resolved))
        files = [*programs, *_MAKING_MAPS.get(resolved.integration.method, ()), "*.h"]
    for pattern in files:
        for path in sorted(kernel_folder().glob(pattern)):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


# What finds maps that a picture depends on, beside the programs that render it.
_MAKING_MAPS = {"pyramid": ("oracle_cells.cl", "oracle_visible.cl"), "multiresolution": ("block_cells.cl",)}


def _custom_source(resolved: ResolvedScene) -> bytes:
    """What an oracle of the caller's own adds."""
    if resolved.integration.method != "pyramid":
        return b""

    folder = oracle_named(resolved.pyramid.oracle).folder
    return b"" if folder is None else (folder / "oracle_custom.h").read_bytes()


def scene_programs(resolved: ResolvedScene, lanes: int = 16) -> dict[str, dict[str, int]]:
    """The files of cl/ that the ray caster compiles for this scene (beside those that all scenes
    share, for tables and empty space), each with its switches."""
    if resolved.integration.method == "multiresolution":
        return _block_programs(reduced_for_frames(resolved), lanes)
    resolved = reduced_for_frames(prefiltered(quantised(reduced_for_frames(resolved))))
    if resolved.integration.method == "pyramid":
        return {"pyramid.cl": pyramid_switches(resolved, lanes)}
    switches = raycast_switches(resolved, lanes=lanes)
    programs = {"raycast.cl": switches}
    if resolved.image.ray_spacing > 1:
        programs["fill_between_rays.cl"] = switches
    if switches.get("SHADOWS") == METHODS["volume"]:
        programs["light_volume.cl"] = switches
    if switches.get("GRADIENT") == GRADIENTS["precomputed"]:
        programs["gradients.cl"] = storing_switches(switches, resolved.gradient.operator)
    return programs


def _block_programs(resolved: ResolvedScene, lanes: int) -> dict[str, dict[str, int]]:
    """Of the method "multiresolution", where one buffer holds all samples."""
    of_samples = {"VOXEL_PAIRS": 0, "SAMPLE_BUFFERS": 1}
    if resolved.multiresolution.stepping == "pyramid":
        return {"pyramid.cl": block_pyramid_switches(resolved, lanes) | of_samples}
    switches = block_switches(resolved, lanes, True) | of_samples
    programs = {"raycast.cl": switches}
    if resolved.multiresolution.tiles:
        programs["tile_rays.cl"] = switches
    return programs
