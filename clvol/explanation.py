"""Explains which effects a scene uses and why, and which programs are compiled for it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from clvol.device.aimed_lights import load_images
from clvol.device.environment_file import load_radiance
from clvol.device.footprint import footprint_of
from clvol.device.view import PixelLattice, ray_frame
from clvol.features.analysis import effects, reduced
from clvol.features.compression import explained
from clvol.features.scene_warnings import camera_warning, scene_warnings
from clvol.integrators.channels import shown_channels
from clvol.integrators.raycast.history import unsupported
from clvol.integrators.raycast.levels import levels_of_picture
from clvol.integrators.registry import check_scene, integrator_of
from clvol.opencl.context import compile_options
from clvol.opencl.kernels_path import kernel_folder
from clvol.scene.environment import Environment
from clvol.scene.image import ImageSettings
from clvol.scene.resolve import ResolvedScene
from clvol.volume.volume import Volume
from clvol.volume.voxel_layout import padded_size


def explain(resolved: ResolvedScene) -> dict[str, Any]:
    """The output of ``clvol explain --json``.

    "effects" lists every effect with the reason why it is used or not, "compression" says what becomes of the voxels
    (None: nothing), "coherence" where rays start, "minification" which levels of the volume samples are of,
    "kernel_hash" identifies the compiled kernel, and "warnings" lists
    settings that are valid but hardly intended, "classification" is the one that is used and why, "rays" says how many
    a pixel has. Raises SceneError for a scene that a Renderer would refuse, for example because its environment cannot
    be read.
    """
    check_scene(resolved)
    _read_environment(reduced(resolved).environment)
    load_images(reduced(resolved).lights)
    how = integrator_of(resolved).how_shown(resolved)
    listed = [
        {"name": e.name, "called_for": e.called_for,
         "reason": f"{e.reason}; {how[e.name]}" if e.called_for and e.name in how else e.reason}
        for e in effects(resolved)
    ]  # fmt: skip
    image, warnings = resolved.image, scene_warnings(resolved)
    about_camera = camera_warning(resolved.camera, resolved.volume.grid, image.width, image.height)
    warnings += [] if about_camera is None else [about_camera]
    chosen = resolved.chosen_classification
    return {
        "effects": listed,
        "classification": {
            "name": resolved.integration.classification,
            "reason": "the scene requests it" if chosen is None else chosen.reason,
        },
        "rays": {"per_pixel": image.samples, "reason": _rays(image)},
        "compression": explained(resolved),
        "coherence": _coherence(resolved),
        "minification": _minification(resolved),
        "kernel_hash": kernel_hash(resolved),
        "warnings": [str(warning) for warning in warnings],
    }


def _rays(image: ImageSettings) -> str:
    """Which pixels have how many rays, and why."""
    if image.samples == 1:
        return "image.samples is 1: each pixel has the ray through its middle"
    how = f"image.samples is {image.samples}, {image.sample_pattern}, weighed by the {image.pixel_filter}"
    if not image.refines:
        return f"{how}, in all pixels"
    if image.refine == "graded":
        least = f"{image.edge_threshold:g} or more (half of them below three times that)"
        return f"{how}, and 1, where pixels differ by {least} from what lies between their neighbours; elsewhere 1"
    return f"{how}, where pixels differ by {image.edge_threshold:g} or more as displayed; elsewhere 1"


def _coherence(resolved: ResolvedScene) -> dict[str, str]:
    """The mode of [coherence] that pictures are rendered with, and why."""
    mode, programs = resolved.coherence.mode, scene_programs(_as_decoded(resolved))
    switches = programs.get("raycast.cl")
    if switches is None or switches.get("SLICES"):
        return {"mode": "off", "reason": "the method casts no packets of rays"}
    if mode == "reproject" and "reproject.cl" not in programs:
        return {"mode": "cells", "reason": f"'reproject' does not go with {unsupported(resolved, switches)}"}
    if mode == "auto":
        return {"mode": "cells", "reason": "it changes no picture, and needs none before"}
    return {"mode": mode, "reason": "the scene requests it"}


def _minification(resolved: ResolvedScene) -> dict[str, Any]:
    """The mode of integration.minification that pictures are rendered with, the finest and the coarsest level of this
    one, and why."""
    effect = next(effect for effect in effects(resolved) if effect.name == "minification")
    if not effect.called_for:
        return {"mode": "off", "levels": [0, 0], "reason": effect.reason}
    image, integration = resolved.image, resolved.integration
    lattice = PixelLattice(covers=1.0 / math.sqrt(image.samples))
    size = image.width, image.height
    first, last = levels_of_picture(resolved, resolved.camera, size, lattice)
    frame = ray_frame(resolved.camera, resolved.volume.grid, *size, lattice)
    least, most = footprint_of(frame, resolved.volume, 0.0).extremes(padded_size(resolved.volume))
    what = "a pixel" if image.samples == 1 else "a ray's share of a pixel"
    wide = f"{what} is {max(least, 0.0):.3g} to {max(most, 0.0):.3g} voxels wide"
    steps = f"steps are {integration.step:g} times the edge of voxels of level {first}"
    reason = f"{wide}, level_bias is {integration.level_bias:g}; {steps}"
    return {"mode": "levels", "levels": [first, last], "reason": reason}


def _read_environment(environment: Environment | None) -> None:
    """Raises SceneError if the environment cannot be rendered."""
    if environment is not None:
        load_radiance(
            environment.path, environment.layout, environment.intensity,
            environment.rotation_degrees,
        )  # fmt: skip


def kernel_hash(resolved: ResolvedScene, lanes: int = 16) -> str:
    """A hash of everything that is compiled for this scene: sources and switches.

    The device is assumed to have room for all precomputed data, and the voxels to be those that are rendered, after
    any prefilter; decoded ones to have the range of the original ones. ``lanes``: rays per work-item, 16 on CPUs.
    """
    if resolved.channels:
        hashes = sorted({kernel_hash(scene, lanes) for scene in shown_channels(resolved)})
        if len(hashes) == 1:
            return hashes[0]
        return hashlib.sha256(" ".join(hashes).encode()).hexdigest()[:16]
    resolved = _as_decoded(resolved)
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


def _as_decoded(resolved: ResolvedScene) -> ResolvedScene:
    """``resolved`` with voxels of the type that decoded ones have."""
    volume = resolved.volume
    if not resolved.compression.is_lossy or volume.dtype != np.float64:
        return resolved
    volume = Volume(volume.data.astype(np.float32), volume.grid.spacing, volume.grid.origin, volume.grid.direction)
    return replace(resolved, volume=volume)


def scene_programs(resolved: ResolvedScene, lanes: int = 16) -> Mapping[str, Mapping[str, int]]:
    """The files of cl/ that are compiled for this scene, each with its switches. Programs that all scenes share (the
    map of empty space) are not listed."""
    return integrator_of(resolved).programs(resolved, lanes)
