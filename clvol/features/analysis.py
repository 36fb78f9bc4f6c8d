"""One analysis of a scene: the effects that it needs, and the scene without all others.

Both come from the same passes, so they agree. An analysis is cached for the lifetime of its scene.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

from clvol.features import (
    channels,
    clipping,
    depth_cue,
    emission,
    fields,
    filters,
    glow,
    gradients,
    half_angle,
    lighting,
    noise,
    opacity,
    shadows,
    surfaces,
)
from clvol.features.effect import Effect
from clvol.features.findings import Findings
from clvol.scene.channel_scenes import channel_scenes
from clvol.scene.resolve import ResolvedScene

NAMES = (
    "emission-absorption",
    "projection",
    "channels",
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
    "half-angle slices",
    "isosurfaces",
    "refraction",
    "gradients",
    "sobel gradients",
    "precomputed gradients",
    "gradient opacity",
    "directional opacity",
    "two-dimensional transfer function",
    "joint transfer function",
    "associated colours",
    "label field",
    "density field",
    "mask field",
    "color field",
    "noise",
    "colour cycling",
    "clipping",
    "depth cueing",
)
# Each pass analyses the scene as reduced by the passes before it.
_PASSES = (
    filters, glow, emission, fields, noise, clipping, surfaces, opacity, lighting, shadows, half_angle, depth_cue,
    gradients,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Analysis:
    effects: tuple[Effect, ...]
    # None: the scene itself, in which everything has a consequence
    reduced: ResolvedScene | None
    for_frames: ResolvedScene | None  # the same for any time of its animation


_known: WeakKeyDictionary = WeakKeyDictionary()  # ResolvedScene: Analysis


def analysis_of(scene: ResolvedScene) -> Analysis:
    if scene not in _known and scene.channels:
        found_in = [analysis_of(each).effects for each in channel_scenes(scene)]
        _known[scene] = Analysis(channels.effects_of(found_in, scene), None, None)
    if scene not in _known:
        found = Findings(scene)
        for part in _PASSES:
            part.analyse(found)
        found.note(channels.effect_of(scene))
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
    """Every effect that clvol knows, with the reason why this scene needs it or does not."""
    return list(analysis_of(resolved).effects)


def called_for(resolved: ResolvedScene) -> list[str]:
    """The names of the effects that the scene needs."""
    return [effect.name for effect in effects(resolved) if effect.called_for]


def reduced(resolved: ResolvedScene) -> ResolvedScene:
    """``resolved`` without everything that has no consequence: it gives exactly the same picture.

    Kernels are chosen and samples taken for the reduced scene. A scene in which nothing is lit has the material
    ``NEUTRAL``. The result is ``resolved`` itself if there is nothing to leave out. It holds for the scene's camera
    and animation only, since a depth cue may depend on them.
    """
    analysis = analysis_of(resolved)
    return resolved if analysis.reduced is None else analysis.reduced


def reduced_for_frames(resolved: ResolvedScene) -> ResolvedScene:
    """As ``reduced``, but colour cycling stays even if the colours are back where they began: it has a consequence in
    the next frame, which must be rendered by the same kernels.
    """
    analysis = analysis_of(resolved)
    return resolved if analysis.for_frames is None else analysis.for_frames


def _differs(one: ResolvedScene, other: ResolvedScene) -> bool:
    names = vars(one)
    return any(getattr(one, name) is not getattr(other, name) for name in names)
