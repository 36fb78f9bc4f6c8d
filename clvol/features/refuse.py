"""Combinations of settings and effects that no kernel supports, for any integrator.

The limits of a single integrator are in its ``check``.
"""

from __future__ import annotations

from clvol.errors import SceneError
from clvol.features.analysis import effects
from clvol.features.kernels import check_kernel
from clvol.features.vocabulary import FILTERS
from clvol.scene.resolve import ResolvedScene

PLAIN = frozenset({"emission-absorption"})
_OF_LEVELS = PLAIN | {
    "minification", "integral tables", "colour cycling", "channels", "lighting", "specular", "light at both ends",
    "spot lights", "image lights", "environment", "environment background", "gradients", "clipping", "depth cueing",
}  # fmt: skip
# Why levels do not go with others.
_NOT_OF_LEVELS = {
    "isosurfaces": "surfaces are found in cells of voxels",
    "shadows": "light is found in the voxels",
    "ambient occlusion": "what occludes is found in the voxels",
    "noise": "its terms have sizes of their own",
    "associated colours": "what glows is found in the voxels",
    "label field": "means of labels mean nothing", "mask field": "means of labels mean nothing",
    "density field": "fields have no levels", "color field": "fields have no levels",
    "joint transfer function": "fields have no levels",
    "precomputed gradients": "gradients are those of levels",
    "sobel gradients": "gradients of levels are central differences",
    "continuous refraction": "rays bend by the voxels",
}
_BY_SLOPE = "magnitudes of gradients depend on the level"


def check_effects(resolved: ResolvedScene) -> None:
    """SceneError for an unknown filter and for noise or fur on values that are classified before interpolation."""
    integration, origin = resolved.integration, resolved.origin
    if integration.filter not in FILTERS:
        expected = " or ".join(repr(name) for name in FILTERS)
        raise SceneError(f"{origin}: integration.filter", f"got {integration.filter!r}", expected)
    check_kernel(integration, origin)
    if integration.classification == "pre" and integration.compositing == "over":
        for effect in effects(resolved):
            if effect.name in ("noise", "fur") and effect.called_for:
                where = f"{origin}: integration.classification"
                what = f"got 'pre' in a scene that calls for {effect.name}"
                raise SceneError(where, what, "'post' or 'preintegrated'")


def refuse_keys(resolved: ResolvedScene, known: dict[str, tuple[str, ...]]) -> None:
    """SceneError for keys of [integration] whose values the integrator does not support. ``known`` are those it does.
    """
    integration = resolved.integration
    for key, wanted in known.items():
        got = getattr(integration, key)
        if got not in wanted:
            where = f"{resolved.origin}: integration.{key}"
            expected = f"{' or '.join(map(repr, wanted))}, or the method 'raycast'"
            raise SceneError(where, f"got {got!r} with the method {integration.method!r}", expected)


def refuse_effects(
    resolved: ResolvedScene, key: str, got: str, instead: str, known: set[str] | frozenset[str]
) -> None:
    """SceneError for effects that the scene needs and that are not ``known`` where ``key`` is ``got``; ``instead``
    supports them.
    """
    for effect in effects(resolved):
        if effect.called_for and effect.name not in known:
            what = f"got {got!r} in a scene that calls for {effect.name}"
            alone = "a scene without" if "lighting" in known else "a scene of emission and absorption alone"
            expected = f"{instead!r}, or {alone}"
            raise SceneError(f"{resolved.origin}: {key}", what, expected)


def refuse_quadrature(resolved: ResolvedScene) -> None:
    """SceneError for quadrature by cells in scenes where the integrand of a cell may not be simple."""
    integration = resolved.integration
    if integration.quadrature != "cells":
        return
    where = f"{resolved.origin}: integration.quadrature"
    if integration.filter != "linear":
        what = f"got 'cells' with the filter {integration.filter!r}"
        raise SceneError(where, what, "'steps', or the filter 'linear'")
    if integration.classification == "pre":
        expected = "'steps', or the classification 'post' or 'preintegrated'"
        raise SceneError(where, "got 'cells' with the classification 'pre'", expected)
    refuse_effects(resolved, "integration.quadrature", "cells", "steps", PLAIN)


def refuse_minification(resolved: ResolvedScene) -> None:
    """SceneError for levels with anything that needs the voxels themselves."""
    integration = resolved.integration
    if integration.minification != "levels":
        return
    where = f"{resolved.origin}: integration.minification"
    wrong = (
        (integration.filter != "linear", f"the filter {integration.filter!r}: levels are made for the linear one",
         "the filter 'linear'"),
        (integration.classification == "pre", "the classification 'pre': levels are means of values, not of colours",
         "another classification"),
        (integration.quadrature != "steps", f"the quadrature {integration.quadrature!r}: cells are those of voxels",
         "the quadrature 'steps'"),
        (integration.compositing != "over", f"the compositing {integration.compositing!r}: means have other extremes "
         "than voxels", "the compositing 'over'"),
    )  # fmt: skip
    for is_wrong, what, instead in wrong:
        if is_wrong:
            raise SceneError(where, f"got 'levels' with {what}", f"'off', or {instead}")
    for effect in effects(resolved):
        if effect.called_for and effect.name not in _OF_LEVELS:
            reason = _NOT_OF_LEVELS.get(effect.name, _BY_SLOPE)
            raise SceneError(where, f"got 'levels' with {effect.name}: {reason}", "'off', or a scene without")


def refuse_sparse_rays(resolved: ResolvedScene, how: str) -> None:
    """SceneError for rays through some pixels only. ``how``: the key whose value is "pyramid"."""
    if resolved.image.ray_spacing > 1:
        what = f"got {resolved.image.ray_spacing} with the {how} 'pyramid', which decides itself what to sample"
        raise SceneError(f"{resolved.origin}: image.ray_spacing", what, f"1, or another {how}")
