"""Gradients, and how they are computed where something needs them."""

from __future__ import annotations

from clvol.features.effect import joined, no, yes
from clvol.features.findings import Findings
from clvol.features.gradient_storage import UNLIMITED, chosen_storage
from clvol.features.minification import has_levels
from clvol.features.opacity import has_gradient_layers
from clvol.features.vocabulary import ANALYTIC
from clvol.scene.gradient import GradientSettings
from clvol.scene.resolve import ResolvedScene


def uses_of_gradients(scene: ResolvedScene, lit: bool) -> list[str]:
    """What needs gradients in a reduced scene."""
    uses = {
        "lighting": lit,
        "refraction": any(surface.refraction != 1 for surface in scene.isosurfaces),
        "continuous refraction": scene.refraction is not None,
        "gradient opacity": scene.gradient_opacity is not None,
        "directional opacity": scene.directional_opacity is not None,
        "fur": bool(scene.fur),
        "ambient occlusion of surfaces": scene.ambient_occlusion is not None and bool(scene.isosurfaces),
        "the two-dimensional transfer function": has_gradient_layers(scene),
    }
    return [use for use, is_there in uses.items() if is_there]


def analyse(found: Findings) -> None:
    scene = found.scene
    settings, filter = scene.gradient, scene.integration.filter
    uses = uses_of_gradients(scene, found.lit)
    sobel, precomputed = "sobel gradients", "precomputed gradients"
    kept = settings
    if not uses:
        reason = "nothing needs gradients"
        found.note(no("gradients", reason), no(sobel, reason), no(precomputed, reason))
        kept = GradientSettings()
    else:
        found.note(yes("gradients", joined(f"{use} needs them" for use in uses)))
        if filter in ANALYTIC or scene.noise:
            reason = f"the filter {filter!r} has a derivative of its own"
            if scene.noise:
                reason = "with noise, gradients are differences of the perturbed values"
            found.note(no(sobel, reason), no(precomputed, reason))
            kept = GradientSettings()
        else:
            _note_operator(found, settings)
            _note_storage(found, settings)
            if scene.integration.reads_blocks or _of_levels(scene):
                kept = settings.model_copy(update={"storage": "on-the-fly"})
    found.change(gradient=kept)


def _note_operator(found: Findings, settings: GradientSettings) -> None:
    is_sobel = settings.operator == "sobel"
    reason = f"the operator is {settings.operator!r}"
    found.note((yes if is_sobel else no)("sobel gradients", reason))


def _of_levels(scene: ResolvedScene) -> bool:
    """Whether gradients are those of levels. (Precomputed ones are refused there if they are asked for.)"""
    return has_levels(scene.integration) and scene.gradient.storage == "auto"


def _note_storage(found: Findings, settings: GradientSettings) -> None:
    volume = found.scene.volume
    if found.scene.integration.reads_blocks:
        reason = "those of blocks are differences of the values blended between them"
        found.note(no("precomputed gradients", reason))
        return
    if _of_levels(found.scene):
        found.note(no("precomputed gradients", "those of levels are differences of their values"))
        return
    chosen = chosen_storage(volume, settings.operator, settings.storage, UNLIMITED)
    is_stored = chosen == "precomputed"
    reason = f"the storage is {settings.storage!r}"
    if settings.storage == "auto":
        where = "where the device has the memory" if is_stored else "for this volume"
        reason += f", which is {chosen} {where}"
    found.note((yes if is_stored else no)("precomputed gradients", reason))
