"""What a scene may ask for together."""

from __future__ import annotations

from clvol.errors import SceneError
from clvol.features.analysis import effects, reduced_for_frames
from clvol.features.half_spaces import half_spaces
from clvol.features.vocabulary import FILTERS, METHODS, ORACLE_NAMES
from clvol.scene.resolve import ResolvedScene
from clvol.volume.lazy import FilledVolume

_PLAIN = {"emission-absorption"}
# Filters that the reference integrates exactly.
_BY_REFERENCE = {*_PLAIN, "nearest filter", "cubic filter"}

# What [integration] may say beside the method "multiresolution".
_OF_BLOCKS = {
    "filter": ("linear",),
    "quadrature": ("steps",),
    "classification": ("post", "preintegrated"),
    "voxel_precision": ("stored",),
}


# And beside the method "pyramid", whose segments are of many lengths.
_OF_PYRAMID = {
    "filter": ("linear", "cubic", "catmull-rom"),
    "quadrature": ("steps",),
    "classification": ("preintegrated",),
    "compositing": ("over",),
}
_BY_PYRAMID = {*_PLAIN, "cubic filter", "catmull-rom filter", "prefilter", "clipping", "colour cycling"}


def has_exact_integral(resolved: ResolvedScene) -> bool:
    """Whether the reference integrates the scene: emission and absorption, and its filter."""
    return all(e.name in _BY_REFERENCE for e in effects(resolved) if e.called_for)


def refuse_unknown(resolved: ResolvedScene) -> None:
    """SceneError for what the scene calls for and no kernel gives: better none than a wrong
    picture."""
    integration, origin = resolved.integration, resolved.origin
    if integration.method not in METHODS:
        expected = " or ".join(repr(name) for name in METHODS)
        raise SceneError(f"{origin}: integration.method", f"got {integration.method!r}", expected)
    if integration.filter not in FILTERS:
        expected = " or ".join(repr(name) for name in FILTERS)
        raise SceneError(f"{origin}: integration.filter", f"got {integration.filter!r}", expected)
    _refuse_classified_noise(resolved)
    if integration.method == "multiresolution":
        _refuse_beside_blocks(resolved)
    if integration.method == "pyramid":
        _refuse_beside_pyramid(resolved)
    if integration.method == "reference":
        _refuse_others(resolved, "integration.method", "reference", "raycast", _BY_REFERENCE)
    elif integration.quadrature == "cells":
        where = f"{origin}: integration.quadrature"
        if integration.filter != "linear":
            what = f"got 'cells' with the filter {integration.filter!r}"
            raise SceneError(where, what, "'steps', or the filter 'linear'")
        if integration.classification == "pre":
            expected = "'steps', or the classification 'post' or 'preintegrated'"
            raise SceneError(where, "got 'cells' with the classification 'pre'", expected)
        _refuse_others(resolved, "integration.quadrature", "cells", "steps", _PLAIN)


def _refuse_beside_blocks(resolved: ResolvedScene) -> None:
    """What the method "multiresolution" does not do. Keys come first: some of them are effects too."""
    _refuse_keys(resolved, _OF_BLOCKS)
    origin = resolved.origin
    if isinstance(resolved.volume, FilledVolume):
        where = f"{origin}: volume.nan"
        what = "got a number for a store with NaN voxels, with the method 'multiresolution'"
        expected = "'transparent', or a store made with that number, or the method 'raycast'"
        raise SceneError(where, what, expected)
    if resolved.multiresolution.stepping == "pyramid":
        _refuse_beside_pyramid_of_blocks(resolved)
    _refuse_others(resolved, "integration.method", "multiresolution", "raycast", _PLAIN)


def _refuse_sparse_rays(resolved: ResolvedScene, how: str) -> None:
    if resolved.image.ray_spacing > 1:
        what = f"got {resolved.image.ray_spacing} with the {how} 'pyramid', which finds by itself what to sample"
        raise SceneError(f"{resolved.origin}: image.ray_spacing", what, f"1, or another {how}")


def _refuse_beside_pyramid_of_blocks(resolved: ResolvedScene) -> None:
    _refuse_sparse_rays(resolved, "stepping")
    kind, tiles = resolved.integration.classification, resolved.multiresolution.tiles
    if kind != "preintegrated":
        where = f"{resolved.origin}: multiresolution.stepping"
        expected = "the classification 'preintegrated', or another stepping"
        raise SceneError(where, f"got 'pyramid' with the classification {kind!r}", expected)
    if tiles:
        where = f"{resolved.origin}: multiresolution.tiles"
        raise SceneError(where, f"got {tiles} with the stepping 'pyramid'", "0, or another stepping")


def _refuse_beside_pyramid(resolved: ResolvedScene) -> None:
    """What the method "pyramid" does not do."""
    origin, asked = resolved.origin, resolved.pyramid.oracle
    if asked not in ORACLE_NAMES:
        expected = " or ".join(map(repr, ORACLE_NAMES))
        raise SceneError(f"{origin}: pyramid.oracle", f"got {asked!r}", expected)
    _refuse_keys(resolved, _OF_PYRAMID)
    _refuse_sparse_rays(resolved, "method")
    if half_spaces(reduced_for_frames(resolved).clips) is None:
        what = "got clips that leave more than one stretch of a ray, or are of many planes, with the method 'pyramid'"
        expected = "planes and boxes that keep what is inside, 16 planes in all, or the method 'raycast'"
        raise SceneError(f"{origin}: clip", what, expected)
    _refuse_others(resolved, "integration.method", "pyramid", "raycast", _BY_PYRAMID)


def _refuse_keys(resolved: ResolvedScene, known: dict[str, tuple[str, ...]]) -> None:
    """Keys of [integration] that say what the method does not do."""
    integration = resolved.integration
    for key, wanted in known.items():
        got = getattr(integration, key)
        if got not in wanted:
            where = f"{resolved.origin}: integration.{key}"
            expected = f"{' or '.join(map(repr, wanted))}, or the method 'raycast'"
            raise SceneError(where, f"got {got!r} with the method {integration.method!r}", expected)


def _refuse_classified_noise(resolved: ResolvedScene) -> None:
    """Noise perturbs the value that voxels give, not theirs."""
    integration = resolved.integration
    if integration.classification == "pre" and integration.compositing == "over":
        if any(effect.name == "noise" and effect.called_for for effect in effects(resolved)):
            where = f"{resolved.origin}: integration.classification"
            what = "got 'pre' in a scene that calls for noise"
            raise SceneError(where, what, "'post' or 'preintegrated'")


def _refuse_others(
    resolved: ResolvedScene, key: str, got: str, instead: str, known: set[str]
) -> None:
    for effect in effects(resolved):
        if effect.called_for and effect.name not in known:
            what = f"got {got!r} in a scene that calls for {effect.name}"
            expected = f"{instead!r}, or a scene of emission and absorption alone"
            raise SceneError(f"{resolved.origin}: {key}", what, expected)
