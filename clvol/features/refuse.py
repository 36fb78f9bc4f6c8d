"""What a scene may ask for together."""

from __future__ import annotations

from clvol.errors import SceneError
from clvol.features.analysis import effects
from clvol.features.vocabulary import FILTERS, METHODS
from clvol.scene.resolve import ResolvedScene

_PLAIN = {"emission-absorption"}
# Filters that the reference integrates exactly.
_BY_REFERENCE = {*_PLAIN, "nearest filter", "cubic filter"}


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
        _refuse_others(resolved, "integration.method", "multiresolution", "raycast", _PLAIN)
        for key, wanted in (("filter", ("linear",)), ("quadrature", ("steps",)),
                            ("classification", ("post", "preintegrated"))):  # fmt: skip
            got = getattr(integration, key)
            if got not in wanted:
                where, expected = f"{origin}: integration.{key}", " or ".join(map(repr, wanted))
                raise SceneError(where, f"got {got!r} with the method 'multiresolution'", expected)
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
