"""One analysis of a scene: which effects it calls for, and the scene without all others.

Both come from the same passes, so they agree. An analysis is kept as long as its scene.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

from clvol.features import (
    clipping,
    depth_cue,
    emission,
    fields,
    filters,
    gradients,
    lighting,
    noise,
    opacity,
    shadows,
    surfaces,
)
from clvol.features.effect import Effect
from clvol.features.findings import Findings
from clvol.scene.resolve import ResolvedScene

NAMES = (
    "emission-absorption",
    "projection",
    "nearest filter",
    "cubic filter",
    "catmull-rom filter",
    "prefilter",
    "lighting",
    "specular",
    "environment",
    "environment background",
    "shadows",
    "scattering",
    "isosurfaces",
    "refraction",
    "gradients",
    "sobel gradients",
    "precomputed gradients",
    "gradient opacity",
    "directional opacity",
    "two-dimensional transfer function",
    "label field",
    "density field",
    "mask field",
    "noise",
    "colour cycling",
    "clipping",
    "depth cueing",
)
# Each looks at the scene that the ones before it left.
_PASSES = (
    filters, emission, fields, noise, clipping, surfaces, opacity, lighting, shadows, depth_cue,
    gradients,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Analysis:
    effects: tuple[Effect, ...]
    # None: the scene itself, which has nothing without consequence
    reduced: ResolvedScene | None
    for_frames: ResolvedScene | None  # the same at any time of its animation


_known: WeakKeyDictionary = WeakKeyDictionary()  # ResolvedScene: Analysis


def analysis_of(scene: ResolvedScene) -> Analysis:
    if scene not in _known:
        found = Findings(scene)
        for part in _PASSES:
            part.analyse(found)
        effects = tuple(found.effects[name] for name in NAMES)
        changed = _differs(found.scene, scene)
        small = found.scene if changed else None
        later = small
        if found.cycles_later:
            later = replace(found.scene, animation=scene.animation)
            later = later if _differs(later, scene) else None
        _known[scene] = Analysis(effects, small, later)
    return _known[scene]


def effects(resolved: ResolvedScene) -> list[Effect]:
    """Every effect that clvol knows of, with the reason why this scene needs it or not."""
    return list(analysis_of(resolved).effects)


def called_for(resolved: ResolvedScene) -> list[str]:
    """Names of the effects that are called for."""
    return [effect.name for effect in effects(resolved) if effect.called_for]


def reduced(resolved: ResolvedScene) -> ResolvedScene:
    """``resolved`` without all that has no consequence: the same picture, exactly.

    Kernels are chosen, and samples taken, for the reduced scene alone. Where nothing is lit it has
    the material ``NEUTRAL``. It is ``resolved`` itself where there is nothing to leave out. What it
    says about a depth cue holds for its camera (and animation) alone.
    """
    analysis = analysis_of(resolved)
    return resolved if analysis.reduced is None else analysis.reduced


def reduced_for_frames(resolved: ResolvedScene) -> ResolvedScene:
    """As ``reduced``, but with colours that cycle and have come round: they have a consequence in
    the next frame, which shall be rendered by the same kernels."""
    analysis = analysis_of(resolved)
    return resolved if analysis.for_frames is None else analysis.for_frames


def _differs(one: ResolvedScene, other: ResolvedScene) -> bool:
    names = vars(one)
    return any(getattr(one, name) is not getattr(other, name) for name in names)
